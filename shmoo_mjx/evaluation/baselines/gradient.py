"""Meta-training by gradient descent for the learned baselines: batches, loss, early stopping, checkpoints."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from shmoo_mjx.arrays import Array, Float, Key, Scalar
from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.evaluation.baselines.protocol import Context, Job, Predictor, Recordings, output_scale
from shmoo_mjx.evaluation.baselines.sight import Sight
from shmoo_mjx.learning import least_squares, multistep, training
from shmoo_mjx.learning import samples as batches
from shmoo_mjx.learning.daiml import LABEL_FLOOR
from shmoo_mjx.learning.samples import Sampler, Samples

Tree = Any

CONDITIONS = 12
"""Conditions per update, as in DAIML."""
ROWS = 64
"""Samples per condition of an update on which the one-step loss is computed."""


class MetaTask(NamedTuple):
    """One condition of an update."""

    context: Context
    windows: tuple[Float[Array, "B 1 n"], Float[Array, "B 1 m"], Float[Array, "B 1 n"]]
    """Inputs and labels of the loss, and the inputs one sample later."""
    precision: Float[Array, "m m"]
    """Inverse of Sigma_C in units of the label scale."""


class _State(NamedTuple):
    params: Tree
    opt: Any
    key: jax.Array


def meta_train(
    job: Job,
    params: Tree,
    predictor: Callable[[Tree], Predictor],
    *,
    name: str,
    sees: Sight,
    adapt_samples: int = 100,
) -> Tree:
    """Train ``params`` until the budget is spent or the validation score stops improving.

    Args:
        job: data, budget and seed, with the settings "learning_rate" and "decay" (weight decay, default 0).
        params: initial parameters.
        predictor: parameters -> predictor.
        name: name of the method, part of the checkpoint's identity.
        sees: contains several estimates of the contact parameters of each training condition, from poor to good. Each
            task uses a random one of them.
        adapt_samples: maximum number of samples of a task's context.

    Returns:
        The parameters with the best validation score.
    """
    scale, samples, budget = output_scale(job.train.samples), job.train.samples, job.budget
    sampler = batches.sampler(samples, 1, LABEL_FLOOR)
    optimiser = _optimiser(job)

    def task_loss(params: Tree, task: MetaTask) -> Scalar:
        predict = _known(predictor(params), task.context)
        return multistep.loss(predict, task.windows, precision=task.precision, scale=scale, feed_back=False)

    _, contacts, held_contacts = sees.contacts

    def epoch(
        train: Recordings, contacts: Float[Array, "C M p"], sampler: Sampler, state: _State
    ) -> tuple[_State, Array]:
        def update(state: _State, _: None) -> tuple[_State, Array]:
            key, batch_key = jax.random.split(jax.random.wrap_key_data(state.key))
            tasks = _draw(train, contacts, sampler, batch_key, adapt_samples=adapt_samples)
            total, gradient = jax.value_and_grad(lambda p: jnp.mean(jax.vmap(task_loss, (None, 0))(p, tasks)))(
                state.params
            )
            change, opt = optimiser.update(gradient, state.opt, state.params)
            return _State(optax.apply_updates(state.params, change), opt, jax.random.key_data(key)), total

        state, losses = jax.lax.scan(update, state, None, length=budget.epoch_updates)
        return state, jnp.mean(losses)

    @jax.jit
    def score(params: Tree, samples: Samples, contacts: Float[Array, "C p"]) -> Float[Array, ""]:
        made = predictor(params)

        def adapted(
            x: Float[Array, "N n"], y: Float[Array, "N m"], w: Float[Array, "N"], contact: Float[Array, "p"]
        ) -> multistep.Predict:
            return _known(made, Context(x, y, w, jnp.zeros_like(w), contact))

        shares, _ = multistep.scores(
            samples, contacts, adapted, scale=scale, fit_samples=job.fit_samples, horizon=0, floor=LABEL_FLOOR
        )
        return jnp.mean(jnp.minimum(shares, least_squares.WORST))

    device, held_out = jax.tree.map(jnp.asarray, (job.train, job.validation))
    run_epoch = jax.jit(epoch)
    key = jax.random.fold_in(jax.random.key(job.seed), 1)
    fitted = training.run(
        _State(params, optimiser.init(params), jax.random.key_data(key)),
        lambda state: run_epoch(device, contacts, sampler, state),
        extract=lambda state: state.params,
        evaluate=lambda p: score(p, held_out.samples, held_contacts),
        epochs=budget.epochs,
        patience=budget.patience,
        identity=fingerprint(
            __name__, (name, job.setting, budget, job.seed, adapt_samples), samples.inputs, samples.labels
        ),
        directory=job.directory,
    )
    return jax.tree.map(jnp.asarray, fitted.best)


def _optimiser(job: Job) -> optax.GradientTransformation:
    total = job.budget.epochs * job.budget.epoch_updates
    rate = optax.cosine_decay_schedule(job.setting["learning_rate"], total)
    return optax.chain(training.bounded_gradient(), optax.adamw(rate, weight_decay=job.setting.get("decay", 0.0)))


def _known(made: Predictor, context: Context) -> multistep.Predict:
    """Prediction for the object of ``context``. The time is zero, because no method trained here uses it."""
    state = made.adapt(context)
    return lambda x: made.predict(state, x, jnp.zeros(x.shape[:-1]))


def _draw(
    train: Recordings, contacts: Float[Array, "C M p"], sampler: Sampler, key: Key[Array, ""], *, adapt_samples: int
) -> MetaTask:
    """The tasks of one update, from the batches that DAIML draws."""
    key, contact_key = jax.random.split(key)
    batch = batches.draw(
        train.samples, sampler, key, conditions=CONDITIONS, adapt_samples=adapt_samples, windows=ROWS, horizon=1
    )
    x, y, w = batch.adapt
    which = jax.random.randint(contact_key, batch.condition.shape, 0, contacts.shape[1])
    contact = contacts[batch.condition, which]
    context = Context(x, y, w, jnp.zeros_like(w), contact)
    return MetaTask(context, batch.windows, batch.precision)
