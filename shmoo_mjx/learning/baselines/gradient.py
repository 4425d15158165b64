"""Meta-training by gradient descent that the learned baselines share: batches, loss, early stopping, checkpoints."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from shmoo_mjx.dynamics import mlp
from shmoo_mjx.learning import rows as batches
from shmoo_mjx.learning import training
from shmoo_mjx.learning.baselines.protocol import Context, Job, Predictor, Recordings, output_scale, share_left
from shmoo_mjx.learning.baselines.sight import Sight
from shmoo_mjx.learning.rows import Sampler

__all__ = ["Layers", "Task", "dense", "layers", "meta_train"]

Array = Any
Tree = Any

CONDITIONS, WINDOWS, FLOOR = 12, 64, 0.1
"""Conditions per update, rows per condition that the loss is taken on, and the floor of Sigma_C: those of DAIML."""


class Layers(NamedTuple):
    """The learned part of an MLP."""

    weights: tuple[Array, ...]
    biases: tuple[Array, ...]


class Task(NamedTuple):
    """One condition of an update."""

    context: Context
    inputs: Array
    """``[B, n]`` rows that the loss is taken on."""
    labels: Array
    """``[B, m]``"""
    precision: Array
    """``[m, m]`` inverse of Sigma_C in units of the label scale."""


class _State(NamedTuple):
    params: Tree
    opt: Any
    key: Array


def layers(key: Array, *widths: int) -> Layers:
    """Fresh weights."""
    net = mlp.init(key, widths)
    return Layers(net.weights, net.biases)


def dense(net: Layers, x: Array) -> Array:
    """Output of the network for normalised inputs ``x [..., n]``."""
    return mlp.apply(mlp.MLP(net.weights, net.biases, jnp.zeros(()), jnp.ones(())), x, "relu")


def meta_train(
    job: Job,
    params: Tree,
    predictor: Callable[[Tree], Predictor],
    name: str,
    sees: Sight,
    loss: Callable[[Tree, Task], Array] | None = None,
    adapt_rows: int = 100,
) -> Tree:
    """Train ``params`` until the budget is spent or the validation conditions get no better.

    Args:
        job: data, budget, seed; setting["learning_rate"] and setting["decay"] (of the weights) are read here.
        params: where it starts.
        predictor: parameters -> the predictor they make.
        name: of the method, part of the checkpoint's identity.
        sees: the training conditions' bodies, of which a task's context has one drawn at random, well or badly known.
        loss: (params, task) -> loss; by default the squared error after adapting, weighted as in Eq. 4.
        adapt_rows: most rows of a task's context.

    Returns:
        The parameters with the best validation score.
    """
    scale, rows, budget = output_scale(job.train.rows), job.train.rows, job.budget
    sampler = batches.sampler(rows, 1, FLOOR)
    optimiser = _optimiser(job)
    task_loss = loss or _squared_error(predictor, scale)

    _, bodies, held_bodies = sees.found

    def chunk(train: Recordings, bodies: Array, sampler: Sampler, state: _State) -> tuple[_State, Array]:
        def update(state: _State, _: None) -> tuple[_State, Array]:
            key, batch_key = jax.random.split(jax.random.wrap_key_data(state.key))
            tasks = _draw(train, bodies, sampler, batch_key, adapt_rows)
            total, gradient = jax.value_and_grad(lambda p: jnp.mean(jax.vmap(task_loss, (None, 0))(p, tasks)))(
                state.params
            )
            change, opt = optimiser.update(gradient, state.opt, state.params)
            return _State(optax.apply_updates(state.params, change), opt, jax.random.key_data(key)), total

        state, losses = jax.lax.scan(update, state, None, length=budget.chunk_updates)
        return state, jnp.mean(losses)

    device, held_out = jax.tree.map(jnp.asarray, (job.train, job.validation))
    run_chunk = jax.jit(chunk)
    score = jax.jit(lambda p, recorded, held: share_left(predictor(p), recorded, held, job.fit_rows, scale, FLOOR))
    key = jax.random.fold_in(jax.random.key(job.seed), 1)
    fitted = training.run(
        _State(params, optimiser.init(params), jax.random.key_data(key)),
        lambda state: run_chunk(device, bodies, sampler, state),
        extract=lambda state: state.params,
        evaluate=lambda p: score(p, held_out, held_bodies),
        chunks=budget.chunks,
        patience=budget.patience,
        identity=training.fingerprint((name, job.setting, budget, job.seed, adapt_rows), rows.inputs, rows.labels),
        directory=job.directory,
    )
    return jax.tree.map(jnp.asarray, fitted.best)


def _optimiser(job: Job) -> optax.GradientTransformation:
    total = job.budget.chunks * job.budget.chunk_updates
    rate = optax.cosine_decay_schedule(job.setting["learning_rate"], total)
    return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(rate, weight_decay=job.setting.get("decay", 0.0)))


def _squared_error(predictor: Callable[[Tree], Predictor], scale: Array) -> Callable[[Tree, Task], Array]:
    def loss(params: Tree, task: Task) -> Array:
        made = predictor(params)
        predicted = made.predict(made.adapt(task.context), task.inputs, jnp.zeros(task.inputs.shape[0]))
        error = (task.labels - predicted) / scale
        return jnp.mean(jnp.einsum("ba,ac,bc->b", error, task.precision, error)) / error.shape[-1]

    return loss


def _draw(train: Recordings, bodies: Array, sampler: Sampler, key: Array, adapt_rows: int) -> Task:
    """The batches that DAIML draws, with windows of one row."""
    key, body_key = jax.random.split(key)
    batch = batches.draw(train.rows, sampler, key, CONDITIONS, adapt_rows, WINDOWS, 1)
    x, y, w = batch.adapt
    which = jax.random.randint(body_key, batch.condition.shape, 0, bodies.shape[1])
    body = bodies[batch.condition, which]
    context = Context(x, y, w, jnp.zeros_like(w), train.properties[batch.condition], body)
    inputs, labels = batch.windows[0][:, :, 0], batch.windows[1][:, :, 0]
    return Task(context, inputs, labels, batch.precision)
