"""The loop that all trainings share: what has overflowed does no harm, and a training without a result says so."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import optax
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning import training


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=4))
def test_a_gradient_is_bounded_and_keeps_its_direction(values: list[float]) -> None:
    gradient = jnp.asarray(values, jnp.float32)
    bound = training.bounded_gradient()
    found = bound.update({"w": gradient}, bound.init({"w": gradient}))[0]["w"]
    size = float(jnp.linalg.norm(gradient))
    np.testing.assert_allclose(found, gradient / max(size, 1.0), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("lost", [np.inf, -np.inf, np.nan])
def test_training_goes_on_after_a_gradient_has_overflowed(lost: float) -> None:
    optimiser = optax.chain(training.bounded_gradient(), optax.adam(0.1))
    weights = jnp.ones(3)
    state = optimiser.init(weights)
    for gradient in (jnp.array([1.0, lost, 1.0]), weights, weights):
        change, state = optimiser.update(gradient, state, weights)
        weights = optax.apply_updates(weights, change)
    assert np.isfinite(np.asarray(weights)).all() and (np.asarray(weights) < 1.0).all()


def test_a_training_without_a_finite_score_is_an_error() -> None:
    """Not the untrained model, as if it had been trained."""

    def epoch(state: Any) -> Any:
        return state, jnp.nan

    with pytest.raises(ShmooError, match="finite validation score"):
        training.run(jnp.zeros(2), epoch, lambda state: state, lambda state: jnp.nan, epochs=3, patience=2)
    found = training.run(jnp.zeros(2), epoch, lambda state: state, lambda state: jnp.float32(1.0), epochs=3, patience=2)
    assert found.score == 1.0
