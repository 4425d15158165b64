"""Estimates of coefficients: Eq. 5 with a ridge, its Bayesian form, and the empirical prior of training conditions."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from shmoo_mjx.arrays import Array, Float, Scalar


def ridge(
    psi: Float[Array, "N m K"],
    labels: Float[Array, "N m"],
    mean: Float[Array, "m K"],
    strength: Scalar,
    *,
    weights: Float[Array, "N"] | None = None,
) -> Float[Array, "m K"]:
    """Regularised a* of Eq. 5: argmin sum_i |y_i - psi_i a|^2 + strength |a - mean|^2, one problem per axis.

    The solution uses Cholesky factors and is differentiable.

    Args:
        psi: basis at N samples for each of m axes.
        labels: labels in the unit of psi a.
        mean: value towards which a is regularised.
        strength: strength of the ridge, in samples times psi squared. Larger keeps a closer to ``mean``.
        weights: weight of each sample; ones if None.
    """
    weights = jnp.ones(labels.shape[0]) if weights is None else weights
    weighted = psi * weights[:, None, None]
    gram = jnp.einsum("nak,nal->akl", weighted, psi) + strength * jnp.eye(psi.shape[-1])
    residual = labels - jnp.sum(psi * mean, axis=-1)
    right = jnp.einsum("nak,na->ak", weighted, residual)
    factor = jnp.linalg.cholesky(gram)
    return mean + jax.scipy.linalg.cho_solve((factor, True), right[..., None])[..., 0]


def cap_norm(a: Float[Array, "m K"], cap: float) -> Float[Array, "m K"]:
    """``a`` scaled down to a norm of at most ``cap`` (gamma of DAIML), taken over all its entries."""
    # The small constant keeps the gradient of the norm finite at a = 0.
    norm = jnp.sqrt(jnp.sum(a**2) + 1e-12)
    return a * jnp.minimum(1.0, cap / norm)


def posterior(
    phi: Float[Array, "N m n"],
    labels: Float[Array, "N m"],
    *,
    mean: Float[Array, "n"],
    covariance: Float[Array, "n n"],
    noise: Float[Array, "m m"],
    weights: Float[Array, "N"] | None = None,
) -> tuple[Float[Array, "n"], Float[Array, "n n"]]:
    """Posterior mean and covariance of a for N samples and the prior N(mean, covariance): Eq. 8 in one batch.

    Args:
        phi: design matrices, with label = phi a + noise.
        labels: labels of m axes.
        mean: mean of the prior.
        covariance: covariance of the prior.
        noise: residual covariance of one sample.
        weights: weight of each sample; ones if None.
    """
    return posterior_from_factor(
        phi, labels, mean=mean, factor=jnp.linalg.cholesky(covariance), noise=noise, weights=weights
    )


def posterior_from_factor(
    phi: Float[Array, "N m n"],
    labels: Float[Array, "N m"],
    *,
    mean: Float[Array, "n"],
    factor: Float[Array, "n n"],
    noise: Float[Array, "m m"],
    weights: Float[Array, "N"] | None = None,
) -> tuple[Float[Array, "n"], Float[Array, "n n"]]:
    """`posterior` with the prior covariance ``factor factor^T``."""
    weights = jnp.ones(labels.shape[0]) if weights is None else weights
    # In coordinates where the prior is N(0, I), the precision is at least I, so it is well conditioned in float32.
    precision = jnp.linalg.inv(noise)
    white = phi @ factor
    weighted = jnp.einsum("nai,ab->nbi", white * weights[:, None, None], precision)
    gram = jnp.eye(mean.shape[0]) + jnp.einsum("nbi,nbj->ij", weighted, white)
    right = jnp.einsum("nbi,nb->i", weighted, labels - phi @ mean)
    inner = jax.scipy.linalg.cho_factor(gram, lower=True)
    shift = jax.scipy.linalg.cho_solve(inner, right)
    spread = factor @ jax.scipy.linalg.cho_solve(inner, factor.T)
    return mean + factor @ shift, 0.5 * (spread + spread.T)


def empirical_prior(
    phi: Float[Array, "C N m n"],
    labels: Float[Array, "C N m"],
    *,
    mean: Float[Array, "n"],
    covariance: Float[Array, "n n"],
    noise: Float[Array, "m m"],
    weights: Float[Array, "C N"],
    rounds: int = 8,
) -> tuple[Float[Array, "n"], Float[Array, "n n"], Float[Array, "m m"]]:
    """Maximum-likelihood prior and noise for the training conditions, by expectation maximisation (EM).

    Each condition contributes its posterior. Plain statistics of a* over conditions would count the uncertainty of a*
    as spread of the prior or, with a strong ridge, would underestimate the spread.

    Args:
        phi: design matrices of C conditions.
        labels: labels of C conditions.
        mean: initial prior mean.
        covariance: initial prior covariance.
        noise: initial residual covariance.
        weights: weight of each sample.
        rounds: number of EM rounds.

    Returns:
        Prior mean, prior covariance and residual covariance.
    """
    n = mean.shape[0]
    floor = 1e-4 * jnp.diag(jnp.diag(covariance))

    def one_round(carry: tuple[Array, Array, Array], _: None) -> tuple[tuple[Array, Array, Array], None]:
        mean, covariance, noise = carry
        fit = jax.vmap(lambda p, y, w: posterior(p, y, mean=mean, covariance=covariance, noise=noise, weights=w))
        means, spreads = fit(phi, labels, weights)
        new_mean = jnp.mean(means, axis=0)
        centred = means - new_mean
        # Two pseudo-conditions at the current prior regularise the estimate of n^2 numbers from C conditions.
        pseudo = 2.0
        total = jnp.einsum("ci,cj->ij", centred, centred) + jnp.sum(spreads, axis=0) + pseudo * covariance
        residual = (labels - jnp.einsum("cnai,ci->cna", phi, means)) * jnp.sqrt(weights)[..., None]
        count = jnp.maximum(jnp.sum(weights), 1.0)
        new_noise = jnp.einsum("cna,cnb->ab", residual, residual) / count + 1e-8 * jnp.eye(noise.shape[0])
        return (new_mean, total / (phi.shape[0] + pseudo) + floor, new_noise), None

    assert covariance.shape == (n, n)
    return jax.lax.scan(one_round, (mean, covariance, noise), None, length=rounds)[0]


WORST = 2.0
"""Upper limit of the fraction unexplained of one validation condition, so that one diverging condition does not decide
the choice of the best epoch."""


def fraction_unexplained(
    predicted: Float[Array, "N m"],
    labels: Float[Array, "N m"],
    weights: Float[Array, "N"],
    floor: Scalar | Float[Array, "m"] = 1e-9,
) -> Scalar:
    """Fraction of the labels' variance that the predictions leave unexplained, averaged over the axes.

    0 is perfect, and 1 is as good as predicting the mean.

    Args:
        predicted: predictions of N samples.
        labels: labels of N samples.
        weights: weight of each sample.
        floor: value added to the variance of each axis, so that noise does not dominate for an object that hardly
            moves.
    """
    weights = weights[:, None]
    count = jnp.maximum(jnp.sum(weights), 1.0)
    centre = jnp.sum(weights * labels, axis=0) / count
    variance = jnp.sum(weights * (labels - centre) ** 2, axis=0)
    left = jnp.sum(weights * (labels - predicted) ** 2, axis=0)
    return jnp.mean(left / (variance + count * floor))
