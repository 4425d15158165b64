"""Identification of the four-point contact model: nonlinear least squares with a prior from training objects.

Objects that slide and objects that roll have little in common, so the prior is a mixture of Gaussians, found in the
training conditions without labels of their families. An object is fitted once from the middle of each Gaussian, and the
likeliest fit is kept. Residuals of dry friction are heavy-tailed and alike from sample to sample: large ones count by
their size, not its square, and in training the noise is set higher than the residual's.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.cluster.vq import kmeans2

from shmoo_mjx.arrays import Array, Float, Scalar, single_precision
from shmoo_mjx.dynamics import contact_model, features
from shmoo_mjx.types import DT

_BLOCK = 5
"""Online, so many samples' residuals are added up. A label is a difference of noisy twists: what a twist's noise takes
from one it gives to the one before. Singly they make what rolls seem to rub, for friction opposes the twist, noise
included, and the label has the same noise."""


@dataclass(frozen=True)
class IdentificationConfig:
    """Settings of the fit; hashable."""

    noise: float = 1.5
    """Standard deviation of a residual, over the label's standard deviation in training."""
    groups: int = 3
    """Gaussians of the prior."""
    iterations: int = 15
    """Levenberg-Marquardt steps from each start."""
    starts: int = 512
    """Random parameters tried for a training condition, of which the best `refined` are fitted."""
    refined: int = 6
    stride: int = 2
    """Every so many samples of a training condition are used."""
    rounds: int = 3
    """Times that the mixture and the training conditions' fits are refined by each other."""
    seed: int = 0


@dataclass(frozen=True)
class OnlineConfig:
    """Settings of `observe`; hashable."""

    window: int = 120
    """The last so many samples are looked at, a multiple of 5."""
    memory: float = 8.0
    """A sample's weight falls by e in this time of contact [s]: properties may change."""
    iterations: int = 2
    """Levenberg-Marquardt steps per sample."""
    noise: float = 0.5
    """Standard deviation of five samples' residuals added up, over the label's standard deviation in training. Less
    than real senses have (1.7), so that a second of pushing outweighs the prior; large ones count by their size."""

    def __post_init__(self) -> None:
        if self.window % _BLOCK:
            raise ValueError(f"window: {self.window} samples; give a multiple of {_BLOCK}.")


class ContactPrior(NamedTuple):
    """A mixture of G Gaussians over the p parameters of `contact_model.PARAMETERS`."""

    mean: Float[Array, "... G p"]
    root: Float[Array, "... G p p"]
    """root (parameters - mean) is standard normal."""
    log_weight: Float[Array, "... G"]
    """Log of the share, and of the density at the mean."""


class ContactEstimate(NamedTuple):
    """Samples of an object so far, and the parameters that each Gaussian of the prior leads to."""

    prior: ContactPrior
    scale: Float[Array, "... 3"]
    """Standard deviation of the labels in training."""
    inputs: Float[Array, "... W 13"]
    """Of the last W samples, the newest last."""
    labels: Float[Array, "... W 3"]
    weights: Float[Array, "... W"]
    found: Float[Array, "... G p"]
    cost: Float[Array, "... G"]


@single_precision
def prior_state(config: OnlineConfig, prior: ContactPrior, scale: Float[Array, "3"]) -> ContactEstimate:
    """Estimate before the first sample."""
    prior = jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), prior)
    w = config.window
    return ContactEstimate(
        prior,
        jnp.asarray(scale, jnp.float32),
        jnp.ones((w, features.width(features.OBJECT_INPUTS))),
        jnp.zeros((w, 3)),
        jnp.zeros(w),
        prior.mean,
        jnp.zeros(prior.mean.shape[0]),
    )


@single_precision
def observe(
    config: OnlineConfig,
    state: ContactEstimate,
    inputs: Float[Array, "13"],
    label: Float[Array, "3"],
    valid: Scalar = True,
) -> ContactEstimate:
    """One more sample. Not valid or not finite, it changes nothing."""
    use = jnp.all(jnp.isfinite(inputs)) & jnp.all(jnp.isfinite(label)) & jnp.asarray(valid)

    def appended(values: Array, new: Array) -> Array:
        return jnp.concatenate([values[1:], new[None]])

    x = appended(state.inputs, jnp.where(use, inputs, state.inputs[-1]))
    y = appended(state.labels, jnp.where(use, label, 0.0))
    w = appended(state.weights * np.exp(-DT / config.memory), jnp.ones(()))
    samples = _normalised(config.noise, state.scale, x, y, w)
    fit = partial(_fit, config.iterations, samples=samples, block=_BLOCK)
    found, cost = jax.vmap(fit)(state.found, state.prior.mean, state.prior.root)
    new = state._replace(inputs=x, labels=y, weights=w, found=found, cost=cost)
    return jax.tree.map(lambda a, b: jnp.where(use, a, b), new, state)


def best(state: ContactEstimate) -> Float[Array, "p"]:
    """The likeliest parameters; of NumPy arrays without JAX, whose every operation outside jit is compiled apart."""
    return state.found[(state.cost - state.prior.log_weight).argmin()]


def broad_prior() -> ContactPrior:
    """One Gaussian as wide as PARAMETERS says."""
    guess = np.array(list(contact_model.PARAMETERS.values()), np.float32)
    return ContactPrior(guess[None, :, 0], np.diag(1.0 / guess[:, 1])[None], np.zeros(1, np.float32))


@single_precision
def identify(
    config: IdentificationConfig,
    prior: ContactPrior,
    scale: Float[Array, "3"],
    inputs: Float[Array, "N 13"],
    labels: Float[Array, "N 3"],
    weights: Float[Array, "N"],
) -> Float[Array, "p"]:
    """The likeliest parameters given N samples and the prior.

    Args:
        config: static.
        prior: G Gaussians; a fit starts from the mean of each.
        scale: standard deviation of the labels in training.
        inputs: as OBJECT_INPUTS lists them.
        labels: accelerations in {O}.
        weights: 0 where a sample doesn't count.
    """
    samples = _normalised(config.noise, scale, inputs, labels, weights)
    found, cost = jax.vmap(lambda m, r: _fit(config.iterations, m, m, r, samples))(prior.mean, prior.root)
    return found[jnp.argmin(cost - prior.log_weight)]


@single_precision
def learn_prior(
    config: IdentificationConfig,
    scale: Float[Array, "3"],
    inputs: Float[Array, "C N 13"],
    labels: Float[Array, "C N 3"],
    weights: Float[Array, "C N"],
) -> tuple[ContactPrior, Float[Array, "C p"]]:
    """The mixture that the training conditions are drawn from, and their own parameters.

    Args:
        config: settings.
        scale: standard deviation of the labels.
        inputs: of C conditions.
        labels: of C conditions.
        weights: 0 where a sample doesn't count.
    """
    samples = tuple(jnp.asarray(a[:, :: config.stride]) for a in (inputs, labels, weights))
    guess = np.array(list(contact_model.PARAMETERS.values()))
    rng = np.random.default_rng(config.seed)
    starts = jnp.asarray(guess[:, 0] + 0.7 * guess[:, 1] * rng.normal(size=(config.starts, len(guess))), jnp.float32)
    scale = jnp.asarray(scale)

    @jax.jit
    def first(samples: Any) -> Array:
        return jax.lax.map(lambda r: _from_starts(config, starts, scale, *r), samples)

    @jax.jit
    def again(prior: ContactPrior, samples: Any) -> Array:
        return jax.lax.map(lambda r: identify(config, prior, scale, *r), samples)

    found = np.asarray(first(samples), float)
    group = _groups(found, guess, config)
    for _ in range(config.rounds):
        prior = _mixture(found, group, guess, config.groups)
        found = np.asarray(again(prior, samples), float)
        group = _nearest(prior, found)
    return prior, found


@single_precision
def from_stretches(
    config: IdentificationConfig,
    prior: ContactPrior,
    scale: Float[Array, "3"],
    samples: tuple[Float[Array, "C N 13"], Float[Array, "C N 3"], Float[Array, "C N"]],
    lengths: tuple[int, ...],
) -> Float[Array, "C M p"]:
    """Parameters of each condition identified on stretches of contact of given lengths, from anywhere in its recording.

    Args:
        config: settings.
        prior: from `learn_prior`.
        scale: standard deviation of the labels.
        samples: inputs, labels, weights.
        lengths: samples that count, M numbers; 0 is the object not yet touched.
    """
    count, total = samples[2].shape
    longest = min(2 * max(*lengths, 1), total)
    starts = np.random.default_rng(config.seed).integers(0, total, (count, len(lengths)))
    scale = jnp.asarray(scale)

    @partial(jax.jit, static_argnums=0)
    def all_of(length: int, starts: Array, samples: Any) -> Array:
        def one(condition: tuple[Array, Any]) -> Array:
            start, (inputs, labels, weights) = condition
            at = (start + jnp.arange(longest)) % total
            # The samples that count, in order, and no others: most stretches are short.
            at = at[jnp.argsort(weights[at] == 0, stable=True)[: max(length, 1)]]
            return identify(config, prior, scale, inputs[at], labels[at], weights[at] * (length > 0))

        return jax.lax.map(one, (starts, samples))

    on_device = jax.tree.map(jnp.asarray, samples)
    return jnp.stack([all_of(n, jnp.asarray(starts[:, i]), on_device) for i, n in enumerate(lengths)], axis=1)


def _normalised(noise: float, scale: Array, inputs: Array, labels: Array, weights: Array) -> Any:
    unit = scale * noise
    return inputs.T, labels.T / unit[:, None], weights, unit


def _fit(iterations: int, start: Array, mean: Array, root: Array, samples: Any, block: int = 1) -> tuple[Array, Array]:
    """Levenberg-Marquardt from ``start [p]``: (parameters, half the sum of squares, robust and with the prior)."""
    inputs, labels, each, unit = samples
    weights = jnp.max(each.reshape(-1, block), axis=1)  # a block's newest sample's

    def residuals(parameters: Array) -> Array:
        left = contact_model.acceleration(parameters, inputs) / unit[:, None] - labels
        return jnp.sum(jnp.where(each > 0, left, 0.0).reshape(len(unit), -1, block), axis=2)

    def cost_of(parameters: Array, left: Array) -> Array:
        robust = jnp.sum(weights * (jnp.sqrt(1.0 + left**2) - 1.0))
        return robust + 0.5 * jnp.sum((root @ (parameters - mean)) ** 2)

    # p tangents at once are cheaper than 3 N cotangents.
    slopes_of = jax.jacfwd(residuals)

    def iterate(carry: tuple[Array, Array, Array], _: None) -> tuple[tuple[Array, Array, Array], None]:
        parameters, cost, damping = carry
        left, slopes = residuals(parameters), slopes_of(parameters)
        robust = weights / jnp.sqrt(1.0 + left**2)
        information = jnp.einsum("ant,an,anu->tu", slopes, robust, slopes) + root.T @ root
        gradient = jnp.einsum("ant,an,an->t", slopes, robust, left) + root.T @ (root @ (parameters - mean))
        damped = information + damping * jnp.diag(jnp.diag(information))
        tried = parameters - jnp.linalg.solve(damped, gradient)
        new_cost = cost_of(tried, residuals(tried))
        better = jnp.isfinite(new_cost) & (new_cost < cost)
        kept = (jnp.where(better, tried, parameters), jnp.where(better, new_cost, cost))
        return (*kept, jnp.clip(jnp.where(better, damping / 4, damping * 6), 1e-4, 1e6)), None

    begin = (start, cost_of(start, residuals(start)), jnp.asarray(0.03))
    (found, cost, _), _ = jax.lax.scan(iterate, begin, None, length=iterations)
    return found, cost


def _from_starts(
    config: IdentificationConfig, starts: Array, scale: Array, inputs: Array, labels: Array, weights: Array
) -> Array:
    """The best of the fits from the most promising starts, under the broad prior."""
    prior = jax.tree.map(jnp.asarray, broad_prior())
    samples = _normalised(config.noise, scale, inputs, labels, weights)
    x, y, _, unit = samples

    def badness(parameters: Array) -> Array:
        left = contact_model.acceleration(parameters, x[:, ::2]) / unit[:, None] - y[:, ::2]
        return jnp.sum(weights[::2] * (jnp.sqrt(1.0 + left**2) - 1.0))

    promising = starts[jnp.argsort(jax.lax.map(badness, starts, batch_size=32))[: config.refined]]
    found, cost = jax.vmap(lambda s: _fit(config.iterations, s, prior.mean[0], prior.root[0], samples))(promising)
    return found[jnp.argmin(cost)]


def _groups(found: np.ndarray, guess: np.ndarray, config: IdentificationConfig) -> np.ndarray:
    """Group ``[C]`` of each condition by k-means."""
    return kmeans2((found - guess[:, 0]) / guess[:, 1], config.groups, minit="++", rng=config.seed)[1]


def _mixture(found: np.ndarray, group: np.ndarray, guess: np.ndarray, groups: int) -> ContactPrior:
    """Median and robust spread of each group that has members enough."""
    means, roots, weights = [], [], []
    floor = 0.1 * guess[:, 1]
    for g in range(groups):
        own = found[group == g]
        own = own if len(own) >= 4 else found
        mean = np.median(own, axis=0)
        # One outlier among thirty must not make the prior wide.
        spread = np.maximum(1.48 * np.median(np.abs(own - mean), axis=0), floor)
        standard = np.clip((own - mean) / spread, -2.5, 2.5)
        correlation = 0.8 * standard.T @ standard / len(own) + 0.2 * np.eye(len(mean))
        root = np.linalg.cholesky(np.linalg.inv(correlation)).T / spread
        means.append(mean)
        roots.append(root)
        weights.append(np.log(len(own) / len(found)) + np.linalg.slogdet(root)[1])
    return ContactPrior(*(np.asarray(a, np.float32) for a in (means, roots, weights)))


def _nearest(prior: ContactPrior, found: np.ndarray) -> np.ndarray:
    """The likeliest Gaussian ``[C]`` of each condition's parameters."""
    distance = np.sum(np.einsum("gij,cgj->cgi", prior.root, found[:, None] - prior.mean) ** 2, axis=-1)
    return np.argmin(0.5 * distance - prior.log_weight, axis=1)
