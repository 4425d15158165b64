"""DAIML: training of psi such that a few coefficients a(c) describe each object (Eq. 4 to 6).

Every update draws some conditions. For each of them a* is fitted on one batch of samples (Eq. 5, differentiable), and
its error is computed on windows of H steps elsewhere (Eq. 4). A discriminator predicts the condition from psi, and the
loss of psi rewards a high error of the discriminator (Eq. 6). Interpretations and deviations:

* Eq. 4 is an open-loop roll-out of the object: the predicted twist is fed back for H steps under the recorded wrench.
  ``open_loop=False`` uses the recorded twist instead.
* Sigma_C is the covariance of the condition's own labels, so the loss of each condition is its fraction of variance
  unexplained.
* a* is regularised towards a prior (an object before contact), whose mean and covariance are learned along with psi.
  The covariance couples the axes, so a push along x is informative about y and yaw. ``coupled=False`` gives a plain
  ridge.
* B^a is a stretch of consecutive samples of random length, as the robot observes them, not a random subset of the
  recording.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from shmoo_mjx.arrays import Array, Float, Scalar, single_precision
from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.data import store
from shmoo_mjx.dynamics import contact_model, networks, object_model
from shmoo_mjx.dynamics.object_model import ObjectConfig, ObjectParams
from shmoo_mjx.learning import least_squares, multistep, training, training_contacts
from shmoo_mjx.learning import samples as batches
from shmoo_mjx.learning.estimate import EstimateConfig
from shmoo_mjx.learning.object_fit import ObjectFit
from shmoo_mjx.learning.samples import Batch, Sampler, Samples, label_scale, samples_from_arrays, samples_from_dataset
from shmoo_mjx.learning.training_contacts import Contacts

NORM_CAP = 20.0
"""gamma: upper limit of ||a||."""
DISCRIMINATOR_SHARE = 0.5
"""Probability that an update also trains the discriminator."""
SPECTRAL_CAP = 2.5
"""Upper limit of the spectral norm of each layer of psi."""
LABEL_FLOOR = 0.1
"""Fraction of the label variance over all conditions that is added to each condition's own variance, in Sigma_C and in
the validation score. Without it, objects that hardly move would dominate the loss with their noise."""


@dataclass(frozen=True)
class DaimlConfig:
    """Settings of the training of psi."""

    object: ObjectConfig = field(default_factory=lambda: ObjectConfig())
    """Structure of psi."""
    horizon: int = 15
    """H of Eq. 4, length of a window [samples]. Larger trains for longer roll-outs."""
    open_loop: bool = True
    """Feed the prediction back over the H steps. If False, use the recorded twist (teacher forcing)."""
    loss_on_twist: bool = True
    """Compute the error of Eq. 4 on the twist after each step. If False, compute it on the acceleration of each step,
    as printed; the noise of single accelerations then hides the drift that matters for planning."""
    one_step: float = 1.0
    """Weight of the one-step error from recorded twists, added to the open-loop error. In one step psi can use the most
    recent measurement; in the open loop it only has its own predictions."""
    conditions: int = 12
    """Number of conditions per update."""
    adapt_samples: int = 100
    """Maximum length of B^a of Eq. 5, the consecutive samples per condition on which a* is fitted."""
    windows: int = 16
    """Number of windows of H steps per condition in the loss. Half of them start soon after B^a, half anywhere."""
    coupled: bool = True
    """Learn the prior covariance over all axes. If False, use a ridge of fixed strength per axis."""
    ridge: float = 0.3
    """Strength of the ridge of Eq. 5 if not coupled [samples]. Larger keeps a* closer to the prior mean."""
    alpha: float = 0.01
    """Weight of the adversarial term of Eq. 6. Zero disables the discriminator."""
    learning_rate: float = 2e-3
    """Initial learning rate of Adam."""
    epochs: int = 24
    """Maximum number of epochs. The learning rate falls to zero over them along a cosine."""
    epoch_updates: int = 150
    """Number of updates per epoch."""
    patience: int = 12
    """Number of epochs without a better validation score before the training stops."""
    fit_samples: int = 250
    """Number of first samples of a validation condition on which a* is fitted. The score uses the later samples."""
    contact_fit: EstimateConfig = EstimateConfig()
    """Settings of the contact parameter estimate, if psi has the contact model."""
    seed: int = 0
    """Seed of the initial weights and of the batches."""


class Model(NamedTuple):
    """Learned parameters of psi and of the prior. The prior is in units of normalised labels."""

    params: ObjectParams
    """Parameters of psi."""
    mean: Float[Array, "m K"]
    """Mean of the prior."""
    factor: Float[Array, "n n"]
    """Factor F of the prior covariance F F^T, n = m K."""
    log_noise: Float[Array, "m"]
    """Log of the standard deviation of one sample's residual."""


Discriminator = dict[str, dict[str, Array]]
"""Parameters of h, the network that predicts the condition from psi (Eq. 6)."""


class _State(NamedTuple):
    """State of the training between updates."""

    model: Model
    model_opt: Any
    discriminator: Discriminator
    discriminator_opt: Any
    vectors: dict[str, Array]
    key: jax.Array


@single_precision
def train_object(
    data: str | Path | store.Dataset,
    out_dir: str | Path | None = None,
    config: DaimlConfig | None = None,
    progress: Callable[[training.Progress], None] | None = None,
) -> ObjectFit:
    """Train psi on the train split of a data set, with early stopping on its validation split.

    Args:
        data: a directory written by `store`, or a result of `store.read`.
        out_dir: directory of the checkpoint. An interrupted training resumes from it.
        config: settings.
        progress: called after each epoch.

    Raises:
        ShmooError: the data set is missing or damaged or has no training or validation conditions, or the checkpoint
            is damaged.
    """
    dataset = store.of_training(data)
    train, validation = dataset.split("train"), dataset.split("validation")
    return fit_samples(
        samples_from_dataset(train), samples_from_dataset(validation), config, out_dir=out_dir, progress=progress
    )


@single_precision
def fit(
    train: Mapping[str, tuple[Float[Array, "_N n_in"], Float[Array, "_N m"]]],
    validation: Mapping[str, tuple[Float[Array, "_N n_in"], Float[Array, "_N m"]]],
    config: DaimlConfig | None = None,
    *,
    out_dir: str | Path | None = None,
    progress: Callable[[training.Progress], None] | None = None,
) -> ObjectFit:
    """Train psi on arbitrary arrays {condition: (x, y)} with DAIML.

    The meaning of the inputs is unknown. The training therefore uses teacher forcing, and psi has no contact model and
    is not equivariant.

    Args:
        train: inputs and labels of each training condition.
        validation: inputs and labels of each validation condition.
        config: settings.
        out_dir: directory of the checkpoint. An interrupted training resumes from it.
        progress: called after each epoch.

    Raises:
        ShmooError: there is no condition, or the x or y of one is not finite or has an unsuitable shape.
    """
    config = config or DaimlConfig()
    config = replace(
        config, open_loop=False, object=replace(config.object, last_wrench=True, contact_model=False, equivariant=False)
    )
    samples = samples_from_arrays(train)
    held_out = samples_from_arrays(validation, (samples.inputs.shape[-1], samples.labels.shape[-1]))
    return fit_samples(samples, held_out, config, out_dir=out_dir, progress=progress)


@single_precision
def fit_samples(
    train: Samples,
    validation: Samples,
    config: DaimlConfig | None = None,
    *,
    out_dir: str | Path | None = None,
    progress: Callable[[training.Progress], None] | None = None,
    known_contacts: Contacts | None = None,
) -> ObjectFit:
    """`train_object` on prepared samples.

    Args:
        train: training conditions.
        validation: validation conditions.
        config: settings.
        out_dir: directory of the checkpoint. An interrupted training resumes from it.
        progress: called after each epoch.
        known_contacts: contact parameters of the conditions; estimated if None.
    """
    config = config or DaimlConfig()
    device = jax.tree.map(jnp.asarray, train)
    held_out = jax.tree.map(jnp.asarray, validation)
    if known_contacts is None and config.object.contact_model:
        known_contacts = training_contacts.estimated(
            config.contact_fit, train, validation, fit_samples=config.fit_samples, out_dir=out_dir
        )
    contact_prior, contacts, held_contacts = known_contacts or training_contacts.zeros(train, validation)
    sampler = batches.sampler(train, config.horizon, LABEL_FLOOR)
    epoch, scores, prior = _compiled(replace(config, seed=0))
    fitted = training.run(
        _init(config, train, contacts),
        lambda state: epoch((device, contacts, sampler), state),
        extract=lambda state: state.model,
        evaluate=lambda model: jnp.mean(
            jnp.minimum(jnp.stack(scores(held_out, held_contacts, model)), least_squares.WORST)
        ),
        epochs=config.epochs,
        patience=config.patience,
        identity=fingerprint(
            __name__, config, *(part for data in (train, validation) for part in (data.inputs, data.labels))
        ),
        directory=out_dir,
        progress=progress,
    )
    model: Model = jax.tree.map(jnp.asarray, fitted.best)
    mean, covariance, noise = prior(device, contacts, model)
    shape = model.mean.shape
    return ObjectFit(
        model.params,
        mean.reshape(shape),
        covariance,
        noise,
        fitted.score,
        fitted.history,
        contact_prior,
        config.object,
    )


@single_precision
def contacts_seen(config: DaimlConfig, fitted: ObjectFit, samples: Samples) -> Float[Array, "C p"]:
    """Contact parameters of each condition, estimated from its first ``config.fit_samples`` samples."""
    if not config.object.contact_model:
        return jnp.zeros((samples.inputs.shape[0], len(contact_model.PARAMETERS)))
    return training_contacts.on_first_samples(
        config.contact_fit, fitted.contact_prior, fitted.params.label_scale, samples, fit_samples=config.fit_samples
    )


@lru_cache(maxsize=8)
def _compiled(config: DaimlConfig) -> tuple[Any, Any, Any]:
    """Jitted `_epoch`, `_validation_scores` and `_prior`, shared by trainings that differ only in seed and samples.

    The samples are arguments because XLA takes long to fold constants of this size.
    """
    return tuple(jax.jit(partial(function, config)) for function in (_epoch, _validation_scores, _prior))  # type: ignore[return-value]


def _validation_scores(
    config: DaimlConfig, samples: Samples, contacts: Float[Array, "C p"], model: Model
) -> tuple[Float[Array, "C"], Float[Array, "C"]]:
    """Validation scores of psi on held-out conditions: a* is fitted on the first samples and scored on the later ones.

    Returns:
        The fraction of variance unexplained per condition, first of one-step accelerations, then of the change of
        twist over H open-loop steps. Without config.open_loop the second equals the first.
    """

    def adapted(x: Array, y: Array, w: Array, contact: Array) -> multistep.Predict:
        a = _coefficients(config, model, (x, y, w), contact)
        return lambda inputs: object_model.predict(model.params, a, inputs, config.object, contact=contact)

    horizon = config.horizon if config.open_loop else 0
    scale = model.params.label_scale
    return multistep.scores(
        samples, contacts, adapted, scale=scale, fit_samples=config.fit_samples, horizon=horizon, floor=LABEL_FLOOR
    )


def _optimiser(config: DaimlConfig) -> optax.GradientTransformation:
    total = config.epochs * config.epoch_updates
    schedule = optax.cosine_decay_schedule(config.learning_rate, total)
    return optax.chain(training.bounded_gradient(), optax.adam(schedule))


def _init(config: DaimlConfig, samples: Samples, contacts: Array) -> _State:
    key = jax.random.key(config.seed)
    key, net_key, mean_key, discriminator_key, vector_key = jax.random.split(key, 5)
    n_axes = samples.labels.shape[-1]
    params = object_model.init(net_key, config.object, samples.inputs.shape[-1], n_axes)
    params = params._replace(label_scale=jnp.asarray(label_scale(samples), jnp.float32))
    network_inputs = partial(object_model.network_inputs, params.label_scale, config=config.object)
    see = jax.jit(jax.vmap(lambda x, contact: network_inputs(x, contact=contact)))
    net_inputs = see(jnp.asarray(samples.inputs), contacts[:, -1])
    net_inputs = net_inputs[jnp.asarray(samples.weights) > 0]
    reflection = object_model.reflections(config.object)[0] if config.object.equivariant else None
    params = params._replace(net=networks.with_normaliser(params.net, net_inputs, reflection))
    mean = 0.3 * jax.random.normal(mean_key, (n_axes, config.object.functions))
    n = mean.size
    model = Model(params, mean, jnp.eye(n), jnp.full(n_axes, jnp.log(0.5)))
    layers = params.net.layers
    discriminator = untrained_discriminator(discriminator_key, params.linear.shape[1], samples.inputs.shape[0])
    vector_keys = dict(zip(layers, jax.random.split(vector_key, len(layers)), strict=True))
    vectors: dict[str, Array] = {
        name: jax.random.normal(vector_keys[name], layers[name]["kernel"].shape[1:]) for name in layers
    }
    optimiser = _optimiser(config)
    return _State(
        model,
        optimiser.init(_learned(model)),
        discriminator,
        optimiser.init(discriminator),
        vectors,
        jax.random.key_data(key),
    )


def _learned(model: Model) -> tuple[Any, ...]:
    """The trainable part of the model, without the normalisers."""
    params = model.params
    return params.net.layers, params.linear, model.mean, model.factor, model.log_noise


def _with_learned(model: Model, learned: tuple[Any, ...], config: ObjectConfig) -> Model:
    layers, linear, mean, factor, log_noise = learned
    net = model.params.net._replace(layers=layers)
    params = model.params._replace(net=net, linear=linear if config.linear_terms else model.params.linear)
    if config.equivariant:
        # Before contact, an object and its mirror image are equally likely.
        signs = object_model.coefficient_signs(config)
        mean = jnp.where(signs > 0, mean, 0.0)
        factor = jnp.where(signs.reshape(-1, 1) == signs.reshape(-1), factor, 0.0)
    return Model(params, mean, factor, log_noise)


def _coefficients(config: DaimlConfig, model: Model, rows: tuple[Array, Array, Array], contact: Array) -> Array:
    """a* of Eq. 5 ``[m, K]``, fitted to ``rows``: inputs, labels and weights of samples."""
    x, y, w = rows
    params, labels = model.params, y / model.params.label_scale
    if config.coupled:
        phi = object_model.design_matrix(params, x, config.object, contact) / params.label_scale[:, None]
        noise = jnp.diag(jnp.exp(2 * model.log_noise))
        a, _ = least_squares.posterior_from_factor(
            phi, labels, mean=model.mean.reshape(-1), factor=model.factor, noise=noise, weights=w
        )
        a = a.reshape(model.mean.shape)
    else:
        psi = object_model.basis(params, x, config.object, contact)
        a = least_squares.ridge(psi, labels, model.mean, config.ridge, weights=w)
    return least_squares.cap_norm(a, NORM_CAP)


def _epoch(config: DaimlConfig, data: tuple[Samples, Array, Sampler], state: _State) -> tuple[_State, Array]:
    """One epoch of updates. ``data`` holds the samples, the contact parameters of their conditions and the sampler."""
    samples, contacts, sampler = data
    optimiser = _optimiser(config)

    def update(state: _State, _: None) -> tuple[_State, Array]:
        key, batch_key, coin_key, contact_key = jax.random.split(jax.random.wrap_key_data(state.key), 4)
        batch = batches.draw(
            samples,
            sampler,
            batch_key,
            conditions=config.conditions,
            adapt_samples=config.adapt_samples,
            windows=config.windows,
            horizon=config.horizon,
        )
        which = jax.random.randint(contact_key, batch.condition.shape, 0, contacts.shape[1])
        contact = contacts[batch.condition, which]

        def loss_of(learned: tuple[Any, ...]) -> tuple[Scalar, dict[str, Array]]:
            model = _with_learned(state.model, learned, config.object)
            return daiml_loss(model, state.discriminator, batch, contact, config=config)

        gradient, terms = jax.grad(loss_of, has_aux=True)(_learned(state.model))
        learned = _learned(state.model)
        change, model_opt = optimiser.update(gradient, state.model_opt, learned)
        learned = optax.apply_updates(learned, change)
        model = _with_learned(state.model, learned, config.object)
        net, vectors = networks.cap_spectral_norm(model.params.net, state.vectors, SPECTRAL_CAP)
        model = model._replace(params=model.params._replace(net=net))
        new = state._replace(model=model, model_opt=model_opt, vectors=vectors, key=jax.random.key_data(key))
        if config.alpha > 0:
            new = _train_discriminator(config, new, psi=terms["psi"], condition=batch.condition, key=coin_key)
        return new, terms["multi_step"]

    state, losses = jax.lax.scan(update, state, None, length=config.epoch_updates)
    return state, jnp.mean(losses)


def daiml_loss(
    model: Model, discriminator: Discriminator, batch: Batch, contacts: Float[Array, "C p"], *, config: DaimlConfig
) -> tuple[Scalar, dict[str, Float[Array, "..."]]]:
    """Eq. 6 for fixed h: the multi-step loss of Eq. 4 with a* of Eq. 5, minus ``alpha`` times the cross-entropy of h.

    Args:
        model: parameters of psi and of the prior.
        discriminator: parameters of h, which has its own updates.
        batch: samples of C conditions: those on which a* is fitted, and the windows of the loss.
        contacts: contact parameters of each condition.
        config: settings.

    Returns:
        The loss and its terms: "multi_step" ``[]`` and, if ``alpha`` is not zero, "cross_entropy" ``[]`` and "psi"
        ``[C, N, n]``, on which h is trained next.
    """
    params = model.params

    def left_over(adapt: tuple[Array, Array, Array], windows: Any, precision: Array, contact: Array) -> Scalar:
        a = _coefficients(config, model, adapt, contact)  # Eq. 5
        return multistep.loss(
            lambda x: object_model.predict(params, a, x, config.object, contact=contact),  # Eq. 3
            windows,
            precision=precision,
            scale=params.label_scale,
            feed_back=config.open_loop,
            one_step=config.one_step,
            on_twist=config.loss_on_twist,
        )

    multi_step = jnp.mean(jax.vmap(left_over)(batch.adapt, batch.windows, batch.precision, contacts))
    if config.alpha == 0:
        return multi_step, {"multi_step": multi_step}
    psi = jax.vmap(partial(_raw_basis, config, params))(batch.adapt[0], contacts)
    cross_entropy = _cross_entropy(discriminator, psi, batch.condition)
    terms = {"multi_step": multi_step, "cross_entropy": cross_entropy, "psi": psi}
    return multi_step - config.alpha * cross_entropy, terms


def _raw_basis(config: DaimlConfig, params: ObjectParams, x: Array, contact: Array) -> Array:
    """psi with all its distinct outputs in one axis ``[..., n]``."""
    psi = object_model.basis(params, x, config.object, contact)
    return psi.reshape(*psi.shape[:-2], -1) if config.object.per_axis else psi[..., 0, :]


def untrained_discriminator(key: jax.Array, n_psi: int, conditions: int) -> Discriminator:
    """Initial parameters of h, for psi with ``n_psi`` outputs."""
    params: Discriminator = _discriminator(conditions).init(key, jnp.zeros(n_psi))["params"]
    return params


def _discriminator(conditions: int) -> networks.MLP:
    return networks.MLP((64, 64, conditions), "relu")


def _cross_entropy(discriminator: Discriminator, psi: Array, condition: Array) -> Array:
    conditions = discriminator["layer2"]["bias"].shape[0]
    logits = jax.nn.log_softmax(jnp.asarray(_discriminator(conditions).apply({"params": discriminator}, psi)))
    return -jnp.mean(jnp.take_along_axis(logits, condition[:, None, None], axis=-1))


def _train_discriminator(config: DaimlConfig, state: _State, *, psi: Array, condition: Array, key: Array) -> _State:
    gradient = jax.grad(_cross_entropy)(state.discriminator, jax.lax.stop_gradient(psi), condition)
    change, opt = _optimiser(config).update(gradient, state.discriminator_opt, state.discriminator)
    trained = optax.apply_updates(state.discriminator, change)
    train = jax.random.bernoulli(key, DISCRIMINATOR_SHARE)
    choose = partial(jax.tree.map, lambda new, old: jnp.where(train, new, old))
    return state._replace(
        discriminator=choose(trained, state.discriminator), discriminator_opt=choose(opt, state.discriminator_opt)
    )


def _prior(config: DaimlConfig, samples: Samples, contacts: Array, model: Model) -> tuple[Array, Array, Array]:
    """Prior mean ``[n]``, prior covariance ``[n, n]`` and residual covariance ``[m, m]``.

    They are the learned ones if config.coupled, else they are estimated from the samples.
    """
    scale = model.params.label_scale
    if config.coupled:
        noise = jnp.diag((jnp.exp(model.log_noise) * scale) ** 2)
        covariance = model.factor @ model.factor.T
        ridge = 1e-5 * jnp.trace(covariance) / covariance.shape[0]
        return model.mean.reshape(-1), covariance + ridge * jnp.eye(covariance.shape[0]), noise
    contact = contacts[:, -1]
    phi = jax.vmap(lambda x, b: object_model.design_matrix(model.params, x, config.object, b))(samples.inputs, contact)
    n = model.mean.size
    fit_one = jax.vmap(partial(_coefficients, config, model))
    fitted = fit_one((samples.inputs, samples.labels, samples.weights), contact).reshape(-1, n)
    spread = jnp.cov(fitted.T).reshape(n, n)
    covariance = spread + 0.05 * jnp.diag(jnp.diag(spread)) + 1e-4 * jnp.eye(n)
    mean = jnp.mean(fitted, axis=0)
    noise = jnp.diag((0.5 * scale) ** 2)
    return least_squares.empirical_prior(
        phi, samples.labels, mean=mean, covariance=covariance, noise=noise, weights=samples.weights
    )
