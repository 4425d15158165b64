"""Eq. 8 in its discrete form, and what learns by it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.dynamics import core
from shmoo_mjx.dynamics.core import CoreConfig
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.learning import adaptation, online
from shmoo_mjx.learning.adaptation import AdaptConfig, AdaptState
from shmoo_mjx.learning.estimate import Sighting

N = 6


def start(seed: int = 0) -> AdaptState:
    factor = jax.random.normal(jax.random.key(seed), (N, N))
    return adaptation.init(jnp.zeros(N), factor @ factor.T + 0.01 * jnp.eye(N), 0.05 * jnp.eye(3))


def run(config: AdaptConfig, state: AdaptState, phi: jax.Array, y: jax.Array, valid: jax.Array) -> AdaptState:
    def one_sample(state: AdaptState, x: tuple) -> tuple[AdaptState, None]:
        phi, y, valid = x
        return adaptation.step(config, state, phi, y, valid=valid), None

    return jax.lax.scan(one_sample, state, (phi, y, valid))[0]


def test_no_forgetting_is_batch_bayes() -> None:
    from shmoo_mjx.learning import least_squares

    config = AdaptConfig(decay=0.0, process=0.0, outlier=1e9)
    phi = jax.random.normal(jax.random.key(1), (40, 3, N))
    y = phi @ jnp.arange(1.0, N + 1) + 0.2 * jax.random.normal(jax.random.key(2), (40, 3))
    state = start()
    end = run(config, state, phi, y, jnp.ones(40, bool))
    mean, covariance = least_squares.posterior(phi, y, mean=state.mean, covariance=state.covariance, noise=state.noise)
    np.testing.assert_allclose(end.mean, mean, atol=2e-3)
    np.testing.assert_allclose(end.covariance, covariance, atol=1e-4)


def test_ten_samples_move_most_of_the_way() -> None:
    truth = jnp.linspace(-1.0, 1.0, N)
    phi = jax.random.normal(jax.random.key(3), (10, 3, N))
    end = run(AdaptConfig(), start(), phi, phi @ truth, jnp.ones(10, bool))
    assert float(jnp.linalg.norm(end.mean - truth)) < 0.2 * float(jnp.linalg.norm(truth))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e38])
def test_bad_samples_are_skipped(bad: float) -> None:
    phi, y = jnp.ones((3, N)), jnp.ones(3)
    for sample in ((phi.at[0, 0].set(bad), y), (phi, y.at[1].set(bad))):
        end = jax.jit(lambda s: adaptation.step(AdaptConfig(), start(), *s))(sample)
        assert bool(jnp.all(jnp.isfinite(end.mean))) and bool(jnp.all(jnp.isfinite(end.covariance)))
    unchanged = adaptation.step(AdaptConfig(), start(), phi, y, valid=False)
    np.testing.assert_array_equal(unchanged.mean, start().mean)
    np.testing.assert_array_equal(unchanged.covariance, start().covariance)


def test_an_outlier_counts_less() -> None:
    phi = jax.random.normal(jax.random.key(4), (30, 3, N))
    state = run(AdaptConfig(), start(), phi, phi @ jnp.ones(N), jnp.ones(30, bool))
    hit = jnp.full(3, 1e3)
    careful = adaptation.step(AdaptConfig(), state, phi[0], hit)
    trusting = adaptation.step(AdaptConfig(outlier=1e12), state, phi[0], hit)
    assert float(jnp.linalg.norm(careful.mean - 1)) < 0.1 * float(jnp.linalg.norm(trusting.mean - 1))


def test_decay_returns_to_the_prior_or_to_zero() -> None:
    state = start()._replace(mean=jnp.full(N, 5.0), prior_mean=jnp.full(N, 2.0))
    zeros = (jnp.zeros((4000, 3, N)), jnp.zeros((4000, 3)), jnp.ones(4000, bool))
    for to_prior, goal in ((True, 2.0), (False, 0.0)):
        end = run(AdaptConfig(to_prior=to_prior), state, *zeros)
        np.testing.assert_allclose(end.mean, goal, atol=0.1)
        # With process = 2 decay the prior is the stationary state of an object that tells nothing.
        np.testing.assert_allclose(end.covariance, state.prior_covariance, rtol=0.01, atol=0.01)


def test_the_sign_of_the_tracking_term() -> None:
    """x' = phi (a - a_hat): with s = x the printed plus sign is stable, the other diverges (no prediction term)."""

    def simulate(sign: float) -> float:
        state = adaptation.init(jnp.zeros(1), jnp.eye(1), 1e12 * jnp.eye(3))
        config = AdaptConfig(decay=0.0, process=0.0, tracking=True)
        phi = jnp.array([[1.0], [0.0], [0.0]])

        def one_sample(carry: tuple[AdaptState, jax.Array], _: None) -> tuple[tuple[AdaptState, jax.Array], None]:
            state, s = carry
            s = s + 0.1 * (1.0 - state.mean[0] - 0.5 * s)
            error = jnp.array([sign, 0.0, 0.0]) * s
            return (adaptation.step(config, state, phi, jnp.zeros(3), valid=True, tracking_error=error), s), None

        (state, _), _ = jax.lax.scan(one_sample, (state, jnp.zeros(())), None, length=600)
        return float(jnp.abs(state.mean[0] - 1.0))

    assert simulate(+1.0) < 0.05
    assert simulate(-1.0) > 1e3


_RUN = jax.jit(run, static_argnums=0)


@pytest.mark.slow
@settings(max_examples=4, deadline=None)
@given(
    st.integers(0, 2**31 - 1),
    st.sampled_from([1e-4, 1e-2, 1.0, 1e2, 1e4]),
    st.sampled_from([AdaptConfig(), AdaptConfig(decay=0.0, process=0.0), AdaptConfig(decay=1.0, process=0.5)]),
)
def test_covariance_stays_positive_definite(seed: int, size: float, config: AdaptConfig) -> None:
    """20,000 steps of random and of one repeated direction."""
    keys = jax.random.split(jax.random.key(seed), 4)
    length = 20_000
    phi = size * jax.random.normal(keys[0], (length, 3, N))
    phi = jnp.where(jax.random.bernoulli(keys[1], 0.5, (length, 1, 1)), phi, phi[:1])
    y = 10 * size * jax.random.normal(keys[2], (length, 3))
    y = jnp.where(jax.random.bernoulli(keys[3], 0.001, (length, 1)), jnp.nan, y)
    end = _RUN(config, start(seed % 7), phi, y, jnp.ones(length, bool))
    assert bool(jnp.all(jnp.isfinite(end.mean)))
    covariance = np.asarray(end.covariance, float)
    scale = 1 / np.sqrt(np.diag(covariance))
    assert np.all(np.linalg.eigvalsh(covariance * np.outer(scale, scale)) > 0)


def test_a_psi_without_contact_model_learns_by_eq_8() -> None:
    config = ObjectConfig(hidden=(8,), functions=3, contact_model=False)
    params = core.init(jax.random.key(0), CoreConfig(object=config))
    prior = adaptation.init(jnp.ones(9), jnp.eye(9), 0.1 * jnp.eye(3))
    seen = Sighting(jnp.zeros(3), jnp.zeros(3), jnp.asarray(0.0), jnp.asarray(True), jnp.zeros(3), jnp.asarray(0.4))
    learner = online.learner(config)
    sample = online.Transition(jnp.full(13, 0.3), jnp.array([0.4, 0.0, 0.1]), jnp.asarray(True), seen)
    end = learner.adapt(prior, params, sample)
    assert not np.allclose(end.mean, prior.mean)
    assert list(online.summary(end).values()) == pytest.approx(np.asarray(end.mean).tolist())
    np.testing.assert_array_equal(learner.params_for_rollout(end, params).coefficients.reshape(-1), end.mean)
    jax.tree.map(
        np.testing.assert_array_equal, learner.adapt(prior, params, sample._replace(valid=False)).mean, 1.0 * prior.mean
    )
