"""The posterior over an object's contact parameters: a particle filter on the measured poses of the object.

Each particle is one hypothesis: parameters of `contact_model`, an error of the sensed force, the directions of the
casters, and the resulting pose and twist of the object. A sample moves every particle by the contact model under the
sensed wrench. The filter compares the particle with the measured pose at the time of the measurement, and corrects pose
and twist with an observer of fixed gain. Late poses, drop-outs, coasting and pushes without motion therefore need no
special rules, and no measurement is differentiated.

Particles are resampled when their weights become uneven. Most are shrunk towards the mean and perturbed by differences
between particles, which have the covariance of the posterior (Liu and West 2001). Some are drawn from the prior again,
so that the filter can find a load or a brake that changes during operation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float, Int, Key, Scalar, single_precision
from shmoo_mjx.dynamics import contact_model, features
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import CONTACT_FORCE, touches
from shmoo_mjx.types import DT

_DEFAULT_KEY = 580
"""Seed of an estimate without a key. It is not 0, to be independent of other random draws that use seed 0."""


@dataclass(frozen=True)
class EstimateConfig:
    """Settings of the filter; hashable."""

    particles: int = 1024
    """Number of particles. More is more accurate and slower."""
    pose_noise: tuple[float, float, float] = (0.006, 0.006, 0.012)
    """Scale of the error of a measured pose [m, m, rad], from the camera's tags. Larger makes poses count less."""
    acceleration_noise: float = 0.5
    """Scale of the contact model's error for a recorded acceleration (`learn`), in standard deviations of the labels
    [1]. Larger makes recorded samples count less."""
    discount: float = 0.2
    """Fraction of a sample's log-likelihood that counts [1]. Errors of the model and of the force persist for about
    five samples, so five samples carry the information of one. Larger makes the posterior narrow faster."""
    observer: tuple[float, float] = (0.3, 0.8)
    """Observer gains on the innovation, for the pose [1] and for the twist [1/s] of a particle. Larger follows the
    measurements more closely."""
    force_error: tuple[float, float] = (0.12, 1.5)
    """Standard deviations of two errors of the sensed force: of the logarithm of sensed over true force [1], due to
    motor constants, and of a constant offset [N], due to the weight of the arms."""
    lag: float = 0.05
    """Delay of a tracked pose beyond its age, due to the tracker's filter [s]. A value that is too small makes light
    objects appear heavy."""
    redrawn: float = 0.1
    """Fraction of the particles that resampling draws from the prior [1]. Larger follows changes of the object faster
    and widens the posterior."""
    shrinkage: float = 0.98
    """Fraction of its distance from the mean that a resampled particle keeps [1]. Perturbations by particle differences
    restore the spread, so smaller perturbs more."""


class Sighting(NamedTuple):
    """Measurements of an object at the end of a sample."""

    pose: Float[Array, "... 3"]
    """Measured pose in {W} [m, m, rad], extrapolated to the current time with `twist`."""
    twist: Float[Array, "... 3"]
    """Measured twist in {W} [m/s, m/s, rad/s]."""
    age: Scalar | Float[Array, "..."]
    """Time since the pose was measured [s]."""
    detected: Scalar | Bool[Array, "..."]
    """True if the object was detected during the sample."""
    wrench: Float[Array, "... 3"]
    """Mean wrench of the hands over the sample about the object's centre, in {W} [N, N m]."""
    size: Scalar | Float[Array, "..."]
    """Half the diagonal of the footprint [m]."""


class ObjectEstimate(NamedTuple):
    """The posterior as N weighted particles with p parameters each, in the order of `contact_model.PARAMETERS`."""

    parameters: Float[Array, "... N p"]
    """Contact parameters of each particle."""
    force: Float[Array, "... N 2"]
    """Errors of the sensed force, in standard deviations of `EstimateConfig.force_error`."""
    pose: Float[Array, "... N 3"]
    """Pose of the object in {W} [m, m, rad]."""
    twist: Float[Array, "... N 3"]
    """Twist of the object in {W} [m/s, m/s, rad/s]."""
    casters: Float[Array, "... N 4 2"]
    """Rolling directions of the casters in {O}, unit vectors in the order of `contact_model.POINTS`."""
    log_weight: Float[Array, "... N"]
    """Logarithms of the normalised weights."""
    prior: Float[Array, "... M p"]
    """Draws from the prior."""
    key: Key[Array, "..."]
    """Random key of the next sample."""
    located: Scalar | Bool[Array, "..."]
    """False before the first sample of a push, which sets pose and twist of the particles."""
    restarts: Scalar | Int[Array, "..."]
    """Number of restarts from the prior, after all particles had lost their weight."""


@single_precision
def init(config: EstimateConfig, prior: Float[Array, "M p"], key: Key[Array, ""] | None = None) -> ObjectEstimate:
    """The estimate before the first contact, which equals the prior.

    Args:
        config: settings; static.
        prior: draws from the prior (`contact_prior.draws`).
        key: random key of all later draws; equal keys give equal estimates.
    """
    prior = jnp.asarray(prior, jnp.float32)
    key = jax.random.key(_DEFAULT_KEY) if key is None else key
    first, force, casters, later = jax.random.split(key, 4)
    none = jnp.zeros((config.particles, 3))
    angles = jax.random.uniform(casters, (config.particles, 4), minval=-jnp.pi, maxval=jnp.pi)
    return ObjectEstimate(
        _from_prior(first, prior, config.particles),
        jax.random.normal(force, (config.particles, 2)),
        none,
        none,
        jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1),
        _even(config.particles),
        prior,
        later,
        jnp.zeros((), bool),
        jnp.zeros((), jnp.int32),
    )


@single_precision
def step(config: EstimateConfig, state: ObjectEstimate, sighting: Sighting) -> ObjectEstimate:
    """The posterior after one more sample. A non-finite sample changes only the random key.

    Args:
        config: settings; static.
        state: estimate of one object; vmap for more.
        sighting: measurements at the end of the sample.
    """
    sighting = Sighting(*(jnp.asarray(value) for value in sighting))
    use = jnp.all(
        jnp.array([jnp.all(jnp.isfinite(v)) for v in (sighting.pose, sighting.twist, sighting.wrench, sighting.size)])
    )
    use = use & (jnp.isfinite(sighting.age) | ~jnp.asarray(sighting.detected))
    pose_then, twist_then, age, detected, wrench, size = (
        jnp.where(use, value, jnp.ones_like(value)) for value in map(jnp.asarray, sighting)
    )
    key, resample_key = jax.random.split(state.key)
    pose = jnp.where(state.located, state.pose, pose_then)
    twist = jnp.where(state.located, state.twist, twist_then)

    directions = jnp.moveaxis(state.casters, 0, -1)
    inside = se2.rotate(twist, -pose[:, 2])
    felt = se2.rotate(true_wrench(config, state.force, wrench), -pose[:, 2])
    inside_acceleration = _acceleration(state.parameters, inside, felt, size, casters=directions)
    acceleration = se2.rotate(inside_acceleration, pose[:, 2])
    new_twist = twist + acceleration * DT
    mean_twist = inside + 0.5 * DT * inside_acceleration
    casters = jnp.moveaxis(contact_model.turned(directions, state.parameters.T, mean_twist.T, size), -1, 0)
    new_pose = pose + 0.5 * (twist + new_twist) * DT

    measured = detected & state.located
    late = age + config.lag
    then = new_pose - new_twist * late + 0.5 * acceleration * late**2
    difference = jnp.asarray(pose_then - twist_then * age - then)
    innovation = jnp.where(measured, difference.at[:, 2].set(se2.wrap(difference[:, 2])), 0.0)
    to_pose, to_twist = config.observer
    moved = state._replace(
        pose=new_pose + to_pose * innovation,
        twist=new_twist + to_twist * innovation,
        casters=casters,
        key=key,
        located=jnp.asarray(True),
    )
    likelihood = jnp.where(measured, _log_likelihood(innovation / jnp.array(config.pose_noise)), 0.0)
    new = _updated(config, moved, likelihood, resample_key)
    # An ignored sample also advances the key, so its random draws are not reused.
    return jax.tree.map(lambda a, b: jnp.where(use, a, b), new, state._replace(key=key))


@single_precision
def learn(
    config: EstimateConfig,
    state: ObjectEstimate,
    inputs: Float[Array, "13"],
    label: Float[Array, "3"],
    *,
    scale: Float[Array, "3"],
    valid: Scalar = True,
) -> ObjectEstimate:
    """The posterior after one recorded sample with known twist, wrench and acceleration.

    An invalid or non-finite sample changes only the random key.

    Args:
        config: settings; static.
        state: estimate of one object; vmap for more.
        inputs: in the order of OBJECT_INPUTS.
        label: acceleration in {O} [m/s^2, m/s^2, rad/s^2].
        scale: standard deviation of the labels in training.
        valid: False if the sample does not count.
    """
    use = jnp.all(jnp.isfinite(inputs)) & jnp.all(jnp.isfinite(label)) & jnp.asarray(valid)
    inputs, label = jnp.where(use, inputs, 1.0), jnp.where(use, label, 0.0)
    key, resample_key = jax.random.split(state.key)
    where = features.slices(features.OBJECT_INPUTS)
    count = (config.particles, 3)
    twist, wrench = (jnp.broadcast_to(inputs[where[name]], count) for name in ("object_twist", "wrench"))
    predicted = _acceleration(state.parameters, twist, wrench, inputs[where["size"]][0])
    likelihood = _log_likelihood((label - predicted) / (config.acceleration_noise * scale))
    new = _updated(config, state._replace(key=key), likelihood, resample_key)
    # An ignored sample also advances the key, so its random draws are not reused.
    return jax.tree.map(lambda a, b: jnp.where(use, a, b), new, state._replace(key=key))


@single_precision
def after_rows(
    config: EstimateConfig,
    prior: Float[Array, "M p"],
    scale: Float[Array, "3"],
    rows: tuple[Float[Array, "N 13"], Float[Array, "N 3"], Float[Array, "N"]],
    *,
    key: Key[Array, ""] | None = None,
) -> ObjectEstimate:
    """The posterior after N recorded samples (`learn`).

    Args:
        config: settings; static.
        prior: draws from the prior.
        scale: standard deviation of the labels in training.
        rows: inputs, labels and weights of the samples; samples with weight 0 do not count.
        key: random key of all draws.
    """

    def one(state: ObjectEstimate, row: tuple[Array, ...]) -> tuple[ObjectEstimate, None]:
        x, y, w = row
        return learn(config, state, x, y, scale=scale, valid=w > 0), None

    return jax.lax.scan(one, init(config, prior, key), tuple(jnp.asarray(a, jnp.float32) for a in rows))[0]


def relocated(state: ObjectEstimate) -> ObjectEstimate:
    """The same posterior at the start of another push. The next sample sets the pose and twist of the particles."""
    return state._replace(located=se2.array_module(state.pose).asarray(False))


def mean(state: ObjectEstimate) -> Float[Array, "... p"]:
    """Posterior mean of the parameters. NumPy arrays give a NumPy result."""
    xp = se2.array_module(state.parameters)
    return xp.einsum("...n,...np->...p", xp.exp(state.log_weight), state.parameters)


def quantiles(state: ObjectEstimate, values: Float[Array, "N ..."], shares: tuple[float, ...]) -> Float[Array, "q ..."]:
    """Posterior quantiles of a quantity.

    Args:
        state: estimate of one object.
        values: the quantity for each particle, such as ``contact_model.resistance(state.parameters)``.
        shares: q probabilities in [0, 1].
    """
    xp = se2.array_module(values, state.log_weight)
    weight = xp.exp(state.log_weight)
    flat = values.reshape(len(weight), -1)
    order = xp.argsort(flat, axis=0)
    below = xp.cumsum(weight[order], axis=0)
    columns = [
        xp.take_along_axis(flat, xp.take_along_axis(order, xp.argmax(below >= q * below[-1], axis=0)[None], 0), 0)[0]
        for q in shares
    ]
    return xp.stack(columns).reshape(len(shares), *values.shape[1:])


@single_precision
def draw(state: ObjectEstimate, key: Key[Array, ""], count: int) -> Float[Array, "count p"]:
    """Independent draws of the parameters from the posterior."""
    return state.parameters[jax.random.categorical(key, state.log_weight, shape=(count,))]


def _acceleration(
    parameters: Array, twist: Array, wrench: Array, size: Array, *, casters: Array | None = None
) -> Array:
    """Acceleration ``[N, 3]`` of each particle in {O} under its wrench."""
    last = jnp.zeros_like(twist)
    inputs = features.object_inputs(
        twist.T, wrench.T, last_twist=last.T, size=jnp.full(len(twist), size), last_wrench=last.T, axis=0
    )
    return contact_model.acceleration(parameters.T, inputs, casters=casters).T


def true_wrench(config: EstimateConfig, force: Float[Array, "N 2"], wrench: Float[Array, "3"]) -> Float[Array, "N 3"]:
    """The true wrench according to each particle: the sensed ``wrench``, rescaled for the particle's force errors.

    Args:
        config: settings; static.
        force: force errors of the particles, as in ObjectEstimate.
        wrench: sensed wrench [N, N m].
    """
    scale, offset = config.force_error
    size = jnp.maximum(jnp.hypot(wrench[0], wrench[1]), CONTACT_FORCE)
    share = jnp.exp(-scale * force[:, 0]) - offset * force[:, 1] / size
    return wrench * (touches(wrench) * jnp.maximum(share, 0.0))[:, None]


def _log_likelihood(errors: Array) -> Array:
    """Log-likelihood ``[N]`` of scaled errors ``[N, 3]``: Student's t with four degrees of freedom."""
    return -2.5 * jnp.sum(jnp.log1p(errors**2 / 4.0), axis=1)


def _updated(config: EstimateConfig, state: ObjectEstimate, log_likelihood: Array, key: Array) -> ObjectEstimate:
    """The particles with new weights, resampled if the effective sample size is below half of their number."""
    raw = state.log_weight + config.discount * log_likelihood
    log_weight = raw - jax.nn.logsumexp(raw)
    sound = jnp.all(jnp.isfinite(state.twist)) & jnp.all(jnp.isfinite(log_weight) | (log_weight == -jnp.inf))
    fresh_key, key = jax.random.split(key)
    fresh = init(config, state.prior, fresh_key)._replace(restarts=state.restarts + 1)
    state = jax.tree.map(lambda a, b: jnp.where(sound, a, b), state._replace(log_weight=log_weight), fresh)
    effective = 1.0 / jnp.sum(jnp.exp(2.0 * state.log_weight))
    return jax.lax.cond(effective < 0.5 * config.particles, lambda s: _resampled(config, s, key), lambda s: s, state)


def _resampled(config: EstimateConfig, state: ObjectEstimate, key: Array) -> ObjectEstimate:
    """Systematic resampling, followed by shrinkage, perturbation and new draws from the prior (Liu and West 2001)."""
    count = config.particles
    start, first, second, prior_key = jax.random.split(key, 4)
    places = (jnp.arange(count) + jax.random.uniform(start)) / count
    chosen = jnp.minimum(jnp.searchsorted(jnp.cumsum(jnp.exp(state.log_weight)), places), count - 1)
    pairs = jax.random.permutation(first, chosen), jax.random.permutation(second, chosen)
    spread = np.sqrt((1.0 - config.shrinkage**2) / 2.0)

    def spread_out(values: Array) -> Array:
        middle = jnp.exp(state.log_weight) @ values
        kept = middle + config.shrinkage * (values[chosen] - middle)
        return kept + spread * (values[pairs[0]] - values[pairs[1]])

    old = jnp.arange(count) < (1.0 - config.redrawn) * count
    return state._replace(
        parameters=jnp.where(old[:, None], spread_out(state.parameters), _from_prior(prior_key, state.prior, count)),
        force=spread_out(state.force),
        pose=state.pose[chosen],
        twist=state.twist[chosen],
        casters=state.casters[chosen],
        log_weight=_even(count),
    )


def _from_prior(key: Array, prior: Array, count: int) -> Array:
    return prior[jax.random.randint(key, (count,), 0, prior.shape[0])]


def _even(count: int) -> Array:
    return jnp.full(count, -np.log(count), jnp.float32)
