"""Least squares on functions made by hand: of time (the paper's baseline), and of the inputs."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.learning import least_squares
from shmoo_mjx.learning.baselines.protocol import Context, Job, Predictor, output_scale
from shmoo_mjx.learning.baselines.sight import sight
from shmoo_mjx.types import Array

__all__ = ["Prior", "fit_prior", "linear_prior", "trigonometric"]


class Prior(NamedTuple):
    """What the training conditions say of the coefficients, axis-major, m axes of d functions."""

    mean: np.ndarray
    """``[m d]``"""
    covariance: np.ndarray
    """``[m d, m d]``"""
    noise: np.ndarray
    """``[m, m]`` covariance of a sample's residual."""


def trigonometric(job: Job) -> Predictor:
    """psi(t) = [sin t, sin 2t, sin 3t, cos t, cos 2t, cos 3t] (Sec. V-B), a ridge towards zero for each condition."""
    scale = output_scale(job.train.samples)

    def basis(time: Array) -> Array:
        angles = jnp.asarray(time)[..., None] * jnp.arange(1.0, 4.0)
        return jnp.concatenate([jnp.sin(angles), jnp.cos(angles)], axis=-1)

    def adapt(context: Context) -> Array:
        f = basis(context.time)
        psi = jnp.broadcast_to(f[:, None, :], (f.shape[0], scale.shape[0], f.shape[-1]))
        start = jnp.zeros(psi.shape[1:])
        return least_squares.ridge(psi, context.labels / scale, start, job.setting["ridge"], context.weights)

    return Predictor(jax.jit(adapt), lambda a, x, time: basis(time) @ a.T * scale)


def linear_prior(job: Job) -> Predictor:
    """The inputs and a constant, drawn towards what the training conditions say.

    setting["noise"] inflates the noise, whose samples are correlated in truth. setting["coupled"] keeps the prior's
    covariances between coefficients; otherwise only their variances.
    """
    sees, scale, samples = sight(job), output_scale(job.train.samples), job.train.samples

    def basis(x: Array, contact: Array) -> Array:
        return jnp.concatenate([sees(x, contact), jnp.ones((*x.shape[:-1], 1))], axis=-1)

    functions = jax.jit(jax.vmap(basis))(samples.inputs, sees.found[1][:, -1])
    prior = fit_prior(np.asarray(functions), samples.labels / scale, samples.weights)
    covariance = prior.covariance if job.setting["coupled"] else np.diag(np.diag(prior.covariance))
    factor = jnp.asarray(np.linalg.cholesky(covariance), jnp.float32)
    mean, noise = jnp.asarray(prior.mean, jnp.float32), jnp.asarray(prior.noise * job.setting["noise"], jnp.float32)
    axes = scale.shape[0]

    def adapt(context: Context) -> tuple[Array, Array]:
        contact = sees.contact(context)
        f = basis(context.inputs, contact)
        phi = (f[:, None, None, :] * jnp.eye(axes)[:, :, None]).reshape(f.shape[0], axes, -1)
        labels = context.labels / scale
        a, _ = least_squares.posterior_from_factor(phi, labels, mean, factor, noise, context.weights)
        return a.reshape(axes, -1), contact

    def predict(state: tuple[Array, Array], x: Array, time: Array) -> Array:
        a, contact = state
        return basis(x, contact) @ a.T * scale

    return Predictor(jax.jit(adapt), predict)


def fit_prior(functions: np.ndarray, labels: np.ndarray, weights: np.ndarray, rounds: int = 30) -> Prior:
    """The prior under which the conditions' labels are most likely, by expectation maximisation.

    The same model as `least_squares.empirical_prior`, on each condition's normal equations instead of its samples.

    Args:
        functions: ``[C, N, d]`` shared by the axes.
        labels: ``[C, N, m]``.
        weights: ``[C, N]``.
        rounds: of EM.
    """
    f, y, w = (np.asarray(v, np.float64) for v in (functions, labels, weights))
    weighted = f * w[..., None]
    gram = np.einsum("cni,cnj->cij", weighted, f)
    right = np.einsum("cni,cna->cai", weighted, y)
    square = np.einsum("cn,cna,cnb->ab", w, y, y)
    d, axes, count = f.shape[-1], y.shape[-1], max(w.sum(), 1.0)
    n = axes * d
    pooled = np.linalg.solve(gram.sum(axis=0) + np.eye(d), right.sum(axis=0).T).T
    prior = Prior(pooled.reshape(n), np.eye(n), square / count)
    for _ in range(rounds):
        precision, inverse = np.linalg.inv(prior.noise), np.linalg.inv(prior.covariance)
        spreads = np.linalg.inv(np.einsum("ab,cij->caibj", precision, gram).reshape(-1, n, n) + inverse)
        moments = np.einsum("ab,cbi->cai", precision, right).reshape(-1, n) + inverse @ prior.mean
        means = np.einsum("cij,cj->ci", spreads, moments)
        mean = means.mean(axis=0)
        # Two pseudo-conditions at the present prior keep n^2 numbers from C conditions sane.
        total = (means - mean).T @ (means - mean) + spreads.sum(axis=0) + 2.0 * prior.covariance
        a = means.reshape(-1, axes, d)
        crossed = np.einsum("cai,cbi->ab", a, right)
        noise = (square - crossed - crossed.T + np.einsum("cai,cij,cbj->ab", a, gram, a)) / count
        covariance = total / (len(means) + 2.0) + 1e-6 * np.eye(n)
        # Laws without noise exist in tests only; single precision does not bear them.
        prior = Prior(mean, covariance, 0.5 * (noise + noise.T) + 1e-4 * np.eye(axes))
    return prior
