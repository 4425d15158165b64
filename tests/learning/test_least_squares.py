"""Eq. 5, its Bayesian form, and the empirical prior."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.learning import least_squares


def problem(seed: int = 0, n: int = 60) -> tuple[jax.Array, jax.Array, jax.Array]:
    keys = jax.random.split(jax.random.key(seed), 3)
    psi, a = jax.random.normal(keys[0], (n, 3, 4)), jax.random.normal(keys[1], (3, 4))
    return psi, a, jnp.sum(psi * a, axis=-1) + 0.01 * jax.random.normal(keys[2], (n, 3))


def test_ridge_finds_the_coefficients_and_the_prior() -> None:
    psi, a, y = problem()
    np.testing.assert_allclose(least_squares.ridge(psi, y, jnp.zeros((3, 4)), 1e-3), a, atol=0.02)
    mean = jnp.ones((3, 4))
    np.testing.assert_allclose(least_squares.ridge(psi, y, mean, 1e7), mean, atol=1e-3)
    dropped = least_squares.ridge(psi, y.at[0].set(1e3), jnp.zeros((3, 4)), 1e-3, weights=jnp.ones(60).at[0].set(0.0))
    np.testing.assert_allclose(dropped, a, atol=0.02)


def test_ridge_is_stationary_and_differentiable() -> None:
    psi, _, y = problem()
    mean = jnp.full((3, 4), 0.3)
    a = least_squares.ridge(psi, y, mean, 2.0)

    def cost(a: jax.Array) -> jax.Array:
        return jnp.sum((y - jnp.sum(psi * a, axis=-1)) ** 2) + 2.0 * jnp.sum((a - mean) ** 2)

    np.testing.assert_allclose(jax.grad(cost)(a), 0.0, atol=2e-3)
    gradient = jax.grad(lambda p: jnp.sum(least_squares.ridge(p, y, mean, 2.0)))(psi)
    assert bool(jnp.all(jnp.isfinite(gradient))) and float(jnp.max(jnp.abs(gradient))) > 0


def test_norm_cap() -> None:
    a = jnp.full((3, 4), 2.0)
    np.testing.assert_allclose(jnp.linalg.norm(least_squares.cap_norm(a, 1.0)), 1.0, atol=1e-5)
    np.testing.assert_allclose(least_squares.cap_norm(a, 100.0), a)
    assert bool(jnp.all(jnp.isfinite(jax.grad(lambda a: jnp.sum(least_squares.cap_norm(a, 1.0)))(0 * a))))


def test_posterior_agrees_with_ridge_for_a_plain_prior() -> None:
    psi, _, y = problem()
    phi = (psi[..., :, None, :] * jnp.eye(3)[:, :, None]).reshape(60, 3, 12)
    mean = jnp.full(12, 0.3)
    found, spread = least_squares.posterior(phi, y, mean=mean, covariance=0.5 * jnp.eye(12), noise=0.1 * jnp.eye(3))
    expected = least_squares.ridge(psi, y, mean.reshape(3, 4), 0.1 / 0.5)
    np.testing.assert_allclose(found.reshape(3, 4), expected, atol=1e-4)
    assert np.all(np.linalg.eigvalsh(spread) > 0) and float(jnp.trace(spread)) < 0.5 * 12


def test_coupled_prior_tells_an_axis_that_was_not_excited() -> None:
    """One second of pushing along x says how heavy the object is, and so what y will do."""
    covariance = jnp.array([[1.0, 0.95], [0.95, 1.0]])
    phi = jnp.zeros((20, 2, 2)).at[:, 0, 0].set(1.0)
    labels = jnp.zeros((20, 2)).at[:, 0].set(2.0)
    found, _ = least_squares.posterior(phi, labels, mean=jnp.zeros(2), covariance=covariance, noise=0.1 * jnp.eye(2))
    assert found[1] > 1.7


def test_empirical_prior_recovers_the_population() -> None:
    rng = np.random.default_rng(0)
    mean, factor = np.array([1.0, -2.0, 0.5]), np.array([[1.0, 0, 0], [0.8, 0.3, 0], [0, 0, 0.2]])
    a = mean + rng.normal(size=(200, 3)) @ factor.T
    phi = rng.normal(size=(200, 30, 2, 3))
    y = np.einsum("cnai,ci->cna", phi, a) + 0.3 * rng.normal(size=(200, 30, 2))
    guess = (jnp.zeros(3), 10 * jnp.eye(3), jnp.eye(2))
    prior = dict(zip(("mean", "covariance", "noise"), guess, strict=True))
    fit = jax.jit(partial(least_squares.empirical_prior, rounds=10), static_argnames="rounds")
    found_mean, covariance, noise = fit(jnp.asarray(phi), jnp.asarray(y), **prior, weights=jnp.ones((200, 30)))
    np.testing.assert_allclose(found_mean, mean, atol=0.25)
    np.testing.assert_allclose(covariance, factor @ factor.T, atol=0.3)
    np.testing.assert_allclose(noise, 0.09 * np.eye(2), atol=0.02)


def test_fraction_unexplained() -> None:
    y = jax.random.normal(jax.random.key(0), (500, 3)) * jnp.array([1.0, 10.0, 0.1])
    ones = jnp.ones(500)
    np.testing.assert_allclose(least_squares.fraction_unexplained(y, y, ones), 0.0, atol=1e-6)
    np.testing.assert_allclose(least_squares.fraction_unexplained(0 * y + jnp.mean(y, 0), y, ones), 1.0, atol=1e-4)
