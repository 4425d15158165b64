"""Trial bodies obey Newton's and Coulomb's laws."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.dynamics import bodies, object_model
from shmoo_mjx.dynamics.bodies import Bodies
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.types import DT

MASS, FRICTION, SIZE = 8.0, 3.0, 0.4  # kg, m/s^2, m


def body(centre: tuple[float, float] = (0.0, 0.0)) -> Bodies:
    return Bodies(
        jnp.log(jnp.full((1, 3), 1.0 / MASS)), jnp.zeros((1, 3)), jnp.log(jnp.array([FRICTION])), jnp.array([centre])
    )


def answer(twist: tuple[float, ...], wrench: tuple[float, ...], trial: Bodies | None = None) -> np.ndarray:
    inputs = jnp.array([*twist, *wrench, 0.0, 0.0, 0.0, SIZE])
    return np.asarray(bodies.answers(trial or body(), inputs))


def test_a_push_beyond_friction_accelerates_by_the_rest() -> None:
    force = 2.5 * MASS * FRICTION
    assert answer((0, 0, 0), (force, 0, 0)) == pytest.approx([force / MASS - FRICTION, 0, 0], abs=0.02)


def test_a_push_below_friction_moves_nothing() -> None:
    assert answer((0, 0, 0), (0.9 * MASS * FRICTION, 0, 0)) == pytest.approx([0, 0, 0], abs=1e-6)


def test_a_slow_body_stops_within_the_sample_and_does_not_turn_back() -> None:
    speed = 0.5 * FRICTION * DT
    assert answer((speed, 0, 0), (0, 0, 0)) == pytest.approx([-speed / DT, 0, 0], abs=1e-4)


def test_friction_opposes_the_motion_in_any_direction() -> None:
    fast = 2.0
    for angle in np.linspace(-3, 3, 7):
        direction = np.array([np.cos(angle), np.sin(angle)])
        found = answer((*fast * direction, 0.0), (0, 0, 0))[:2]
        assert found == pytest.approx(-FRICTION * direction, abs=0.02)


def test_a_force_through_the_centre_of_mass_does_not_turn() -> None:
    trial = body((0.5, 0.0))
    force, lever = 2.0 * MASS * FRICTION, 0.5 * SIZE
    through, beside = answer((0, 0, 0), (0, force, lever * force), trial), answer((0, 0, 0), (0, force, 0.0), trial)
    assert abs(through[2]) < 1e-5 < abs(beside[2])


def test_batches_and_layouts_agree_and_gradients_are_finite() -> None:
    config = ObjectConfig(trial_bodies=5)
    params = object_model.init(jax.random.key(0), config)
    x = jax.random.normal(jax.random.key(1), (4, 7, 10)).at[..., 9].set(SIZE).at[0].set(0.0).at[0, :, 9].set(SIZE)
    whole = object_model.network_inputs(params, x)
    assert whole.shape == (4, 7, 25)
    np.testing.assert_allclose(whole[2, 3], object_model.network_inputs(params, x[2, 3]), rtol=1e-6)
    a = jax.random.normal(jax.random.key(2), (3, config.functions))
    folded = object_model.fold(params, a, config)
    forward = object_model.forward(folded, jnp.moveaxis(x, -1, 0), config)
    np.testing.assert_allclose(
        jnp.moveaxis(forward, 0, -1), object_model.predict(params, a, x, config), rtol=2e-4, atol=2e-4
    )
    gradient = jax.grad(lambda p: jnp.sum(object_model.predict(p, a, x, config) ** 2))(params)
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(gradient))


def test_the_papers_form_has_no_trial_bodies() -> None:
    config = ObjectConfig.paper()
    params = object_model.init(jax.random.key(0), config)
    assert [w.shape for w in params.net.weights] == [(10, 128), (128, 128), (128, 50), (50, 6)]
    x = jnp.ones((3, 10))
    assert object_model.network_inputs(params, x) is not None
    np.testing.assert_array_equal(object_model.network_inputs(params, x), x)
