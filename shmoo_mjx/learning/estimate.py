"""The posterior over an object's contact parameters: a particle filter on where the object went.

Each particle is one hypothesis: parameters of `contact_model`, an error of the sensed force, and the pose and twist
that the object would have by now. A sample moves every particle by the contact model under the sensed wrench, compares
it with the measured pose at the time that this was seen, and corrects pose and twist by an observer of fixed gain. So
late poses, drop-outs, coasting and pushes that move nothing need no rules of their own, and nothing is
differentiated.

Particles are resampled once their weights have become uneven: most are spread by differences between particles (which
have the posterior's own covariance) and shrunk towards the mean (Liu and West 2001), and some are drawn from the prior
again, which finds a load or a brake that came on the way.
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
from shmoo_mjx.geometry.hands import touches
from shmoo_mjx.types import DT

_DEFAULT_KEY = 580
"""Seed of an estimate that is given no key: not 0, with which others begin who draw beside it."""


@dataclass(frozen=True)
class EstimateConfig:
    """Settings of the filter; hashable."""

    particles: int = 1024
    pose_noise: tuple[float, float, float] = (0.006, 0.006, 0.012)
    """Scale of a measured pose's error [m, m, rad]: that of the camera's tags."""
    acceleration_noise: float = 0.5
    """Scale of the contact model's error of a recorded acceleration (`learn`), over the labels' standard deviation."""
    discount: float = 0.2
    """Share of a sample's log-likelihood that counts [1]: errors of the model and of the force last for some five
    samples, so that as many tell as much as one would."""
    observer: tuple[float, float] = (0.5, 1.5)
    """Share of the innovation by which a particle's pose is corrected [1], and its twist [1/s]."""
    force_error: tuple[float, float] = (0.12, 1.5)
    """Standard deviations of the logarithm of the sensed force over the true one, and of a constant difference [N]:
    motor constants, and the weight of the arms."""
    force_bias: float = 1.2
    """What is added to the sensed force [N]: arms whose motors are calibrated while the robot sways sense some newtons
    too little (`sensing.touch`). More: objects seem to resist more."""
    lag: float = 0.05
    """Time by which the tracker's filter makes poses later than their age [s]. Too short: light objects seem heavy."""
    force_noise: float = 2.5
    """Standard deviation of a sample's sensed force [N]: arms that swing."""
    redrawn: float = 0.1
    """Share of the particles that resampling draws from the prior."""
    shrinkage: float = 0.98
    """Share of its distance from the mean that a resampled particle keeps; the spread is restored by differences."""


class Sighting(NamedTuple):
    """What is perceived of an object at the end of a sample."""

    pose: Float[Array, "... 3"]
    """Measured pose in {W}, carried on to now by `twist`."""
    twist: Float[Array, "... 3"]
    """In {W}."""
    age: Scalar | Float[Array, "..."]
    """Time since the pose was seen [s]."""
    detected: Scalar | Bool[Array, "..."]
    """Whether it was seen during the sample."""
    wrench: Float[Array, "... 3"]
    """Mean wrench of the hands over the sample about the object's centre, in {W} [N, N m]."""
    size: Scalar | Float[Array, "..."]
    """Half the diagonal of the footprint [m]."""


class ObjectEstimate(NamedTuple):
    """The posterior as N weighted particles; p parameters as `contact_model.PARAMETERS` lists them."""

    parameters: Float[Array, "... N p"]
    force: Float[Array, "... N 2"]
    """Errors of the sensed force, in standard deviations of `EstimateConfig.force_error`."""
    pose: Float[Array, "... N 3"]
    """In {W}."""
    twist: Float[Array, "... N 3"]
    """In {W}."""
    log_weight: Float[Array, "... N"]
    prior: Float[Array, "... M p"]
    """Draws from the prior."""
    key: Key[Array, "..."]
    located: Scalar | Bool[Array, "..."]
    """False before the first sample of a push, which places the particles."""
    restarts: Scalar | Int[Array, "..."]
    """How many times the posterior had lost all weight and began anew from the prior."""


@single_precision
def init(config: EstimateConfig, prior: Float[Array, "M p"], key: Key[Array, ""] | None = None) -> ObjectEstimate:
    """The prior: an object not yet touched.

    Args:
        config: static.
        prior: draws from it (`contact_prior.draws`).
        key: decides all later draws; equal keys give equal estimates.
    """
    prior = jnp.asarray(prior, jnp.float32)
    key = jax.random.key(_DEFAULT_KEY) if key is None else key
    first, force, later = jax.random.split(key, 3)
    none = jnp.zeros((config.particles, 3))
    return ObjectEstimate(
        _from_prior(first, prior, config.particles),
        jax.random.normal(force, (config.particles, 2)),
        none,
        none,
        _even(config.particles),
        prior,
        later,
        jnp.zeros((), bool),
        jnp.zeros((), jnp.int32),
    )


@single_precision
def step(config: EstimateConfig, state: ObjectEstimate, sighting: Sighting) -> ObjectEstimate:
    """The posterior after one more sample. One with a number that is not finite changes nothing.

    Args:
        config: static.
        state: of one object; vmap for more.
        sighting: what is perceived at the sample's end.
    """
    sighting = Sighting(*(jnp.asarray(value) for value in sighting))
    use = jnp.all(
        jnp.array([jnp.all(jnp.isfinite(v)) for v in (sighting.pose, sighting.twist, sighting.wrench, sighting.size)])
    )
    use = use & (jnp.isfinite(sighting.age) | ~jnp.asarray(sighting.detected))
    pose_then, twist_then, age, detected, wrench, size = (
        jnp.where(use, value, jnp.ones_like(value)) for value in map(jnp.asarray, sighting)
    )
    key, noise_key, resample_key = jax.random.split(state.key, 3)
    pose = jnp.where(state.located, state.pose, pose_then)
    twist = jnp.where(state.located, state.twist, twist_then)

    inside = se2.rotate(twist, -pose[:, 2])
    felt = se2.rotate(true_wrench(config, state.force, wrench, noise_key), -pose[:, 2])
    acceleration = se2.rotate(_acceleration(state.parameters, inside, felt, size), pose[:, 2])
    new_twist = twist + acceleration * DT
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
        key=key,
        located=jnp.asarray(True),
    )
    likelihood = jnp.where(measured, _log_likelihood(innovation / jnp.array(config.pose_noise)), 0.0)
    new = _updated(config, moved, likelihood, resample_key)
    # The draws of a sample that changes nothing are not made again for the next one.
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
    """The posterior after one recorded sample whose twist, wrench and acceleration are known. Not valid or not finite,
    it changes nothing.

    Args:
        config: static.
        state: of one object; vmap for more.
        inputs: as OBJECT_INPUTS lists them.
        label: acceleration in {O}.
        scale: standard deviation of the labels in training.
        valid: False where the sample doesn't count.
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
    # The draws of a sample that changes nothing are not made again for the next one.
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

    ``rows`` are their inputs, labels and weights; those with weight 0 don't count.
    """

    def one(state: ObjectEstimate, row: tuple[Array, ...]) -> tuple[ObjectEstimate, None]:
        x, y, w = row
        return learn(config, state, x, y, scale=scale, valid=w > 0), None

    return jax.lax.scan(one, init(config, prior, key), tuple(jnp.asarray(a, jnp.float32) for a in rows))[0]


def relocated(state: ObjectEstimate) -> ObjectEstimate:
    """The same posterior at the start of another push: the next sample says where the object is."""
    return state._replace(located=se2.array_module(state.pose).asarray(False))


def mean(state: ObjectEstimate) -> Float[Array, "... p"]:
    """Mean of the parameters; of NumPy arrays without JAX."""
    xp = se2.array_module(state.parameters)
    return xp.einsum("...n,...np->...p", xp.exp(state.log_weight), state.parameters)


def quantiles(state: ObjectEstimate, values: Float[Array, "N ..."], shares: tuple[float, ...]) -> Float[Array, "q ..."]:
    """Quantiles of some ``values`` of each particle, such as ``contact_model.resistance(state.parameters)``."""
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


def _acceleration(parameters: Array, twist: Array, wrench: Array, size: Array) -> Array:
    """``[N, 3]`` of each particle in {O}, under its wrench."""
    last = jnp.zeros_like(twist)
    inputs = features.object_inputs(
        twist.T, wrench.T, last_twist=last.T, size=jnp.full(len(twist), size), last_wrench=last.T, axis=0
    )
    return contact_model.acceleration(parameters.T, inputs).T


def true_wrench(
    config: EstimateConfig, force: Float[Array, "N 2"], wrench: Float[Array, "3"], key: Key[Array, ""]
) -> Float[Array, "N 3"]:
    """What the sensed ``wrench`` was if each particle's errors of the force are right: longer or shorter by them."""
    scale, offset = config.force_error
    size = jnp.hypot(wrench[0], wrench[1])
    noise = offset * force[:, 1] - config.force_bias + config.force_noise * jax.random.normal(key, force.shape[:1])
    share = jnp.exp(-scale * force[:, 0]) - noise / jnp.maximum(size, config.force_noise)
    return wrench * (touches(wrench) * jnp.maximum(share, 0.0))[:, None]


def _log_likelihood(errors: Array) -> Array:
    """``[N]`` of errors ``[N, 3]`` over their scales: Student's t with four degrees of freedom."""
    return -2.5 * jnp.sum(jnp.log1p(errors**2 / 4.0), axis=1)


def _updated(config: EstimateConfig, state: ObjectEstimate, log_likelihood: Array, key: Array) -> ObjectEstimate:
    """The particles with their new weights, resampled if half of the effective sample size is lost."""
    raw = state.log_weight + config.discount * log_likelihood
    log_weight = raw - jax.nn.logsumexp(raw)
    sound = jnp.all(jnp.isfinite(state.twist)) & jnp.all(jnp.isfinite(log_weight) | (log_weight == -jnp.inf))
    fresh_key, key = jax.random.split(key)
    fresh = init(config, state.prior, fresh_key)._replace(restarts=state.restarts + 1)
    state = jax.tree.map(lambda a, b: jnp.where(sound, a, b), state._replace(log_weight=log_weight), fresh)
    effective = 1.0 / jnp.sum(jnp.exp(2.0 * state.log_weight))
    return jax.lax.cond(effective < 0.5 * config.particles, lambda s: _resampled(config, s, key), lambda s: s, state)


def _resampled(config: EstimateConfig, state: ObjectEstimate, key: Array) -> ObjectEstimate:
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
        log_weight=_even(count),
    )


def _from_prior(key: Array, prior: Array, count: int) -> Array:
    return prior[jax.random.randint(key, (count,), 0, prior.shape[0])]


def _even(count: int) -> Array:
    return jnp.full(count, -np.log(count), jnp.float32)
