"""The loop that all trainings share: what has overflowed does no harm, and a training without a result says so."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning import training
from shmoo_mjx.learning.checkpoints import Checkpoints


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
        training.run(
            jnp.zeros(2), epoch, extract=lambda state: state, evaluate=lambda state: jnp.nan, epochs=3, patience=2
        )
    found = training.run(
        jnp.zeros(2), epoch, extract=lambda state: state, evaluate=lambda state: jnp.float32(1.0), epochs=3, patience=2
    )
    assert found.score == 1.0


def test_a_state_is_whole_that_of_the_last_step_and_of_this_training(tmp_path: Path) -> None:
    like = {"a": jnp.zeros(3), "opt": (jnp.zeros((2, 2)), None)}
    with closing(Checkpoints(tmp_path / "x", "one")) as kept:
        assert kept.load(like) is None
        for step in (1, 2):
            kept.save(step, {"a": like["a"] + step, "opt": (jnp.full((2, 2), step), None)}, {"score": float(step)})
    with closing(Checkpoints(tmp_path / "x", "one")) as kept:
        found = kept.load(like)
        assert found is not None and found[1]["score"] == 2.0
        jax.tree.map(lambda a: np.testing.assert_array_equal(a, 2.0), found[0])
    with closing(Checkpoints(tmp_path / "x", "other")) as kept:
        assert kept.load(like) is None
        kept.save(1, like, {})
    with closing(Checkpoints(tmp_path / "x", "one")) as kept:
        assert kept.load(like) is None


def test_a_damaged_state_is_refused_by_its_folder(tmp_path: Path) -> None:
    like = {"a": jnp.zeros(300)}
    with closing(Checkpoints(tmp_path / "x", "one")) as kept:
        kept.save(1, like, {})
    for part in (tmp_path / "x").rglob("d/*"):
        part.write_bytes(part.read_bytes()[:-20])
    with (
        closing(Checkpoints(tmp_path / "x", "one")) as kept,
        pytest.raises(ShmooError, match=r"x: .*delete the folder"),
    ):
        kept.load(like)
