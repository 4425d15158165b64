"""The four-point contact model: Newton, Coulomb, and the simulator's box."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.dynamics import contact_model
from shmoo_mjx.evaluation import replay
from shmoo_mjx.plant.objects import draw_condition

GUESS = np.array(list(contact_model.PARAMETERS.values()))
SIZE = 0.4


def contact(**named: float) -> jnp.ndarray:
    """Parameters as guessed but for those named."""
    values = dict(zip(contact_model.PARAMETERS, GUESS[:, 0], strict=True)) | named
    return jnp.asarray(list(values.values()), jnp.float32)


def inputs(twist: object = (0.0, 0.0, 0.0), wrench: object = (0.0, 0.0, 0.0)) -> jnp.ndarray:
    return jnp.asarray([*np.asarray(twist), *np.asarray(wrench), 0.0, 0.0, 0.0, SIZE], jnp.float32)


acceleration = jax.jit(contact_model.acceleration)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3), st.integers(0, 1000))
def test_friction_never_drives(twist: list[float], seed: int) -> None:
    parameters = jnp.asarray(
        GUESS[:, 0] + GUESS[:, 1] * np.random.default_rng(seed).normal(size=len(GUESS)), jnp.float32
    )
    change = 0.1 * np.asarray(acceleration(parameters, inputs(twist)))
    named = dict(zip(contact_model.PARAMETERS, np.asarray(parameters), strict=True))

    def energy(v: np.ndarray) -> float:
        x, y = SIZE * named["centre_x"], SIZE * named["centre_y"]
        gyration = SIZE * np.exp(named["log_gyration"])
        return float((v[0] - v[2] * y) ** 2 + (v[1] + v[2] * x) ** 2 + (gyration * v[2]) ** 2)

    assert energy(np.array(twist) + change) <= energy(np.array(twist)) * (1 + 1e-3) + 1e-6


def test_without_friction_it_obeys_newton() -> None:
    free = contact(log_mass=np.log(20.0), log_gyration=np.log(0.5), log_friction_x=-20.0, log_friction_y=-20.0)
    found = acceleration(free, inputs(wrench=(10.0, -4.0, 1.5)))
    np.testing.assert_allclose(found, [0.5, -0.2, 1.5 / (20.0 * 0.2**2)], rtol=1e-3)


@pytest.mark.parametrize("axis", [0, 1])
def test_it_holds_up_to_coulombs_limit_and_slides_beyond(axis: int) -> None:
    heavy = contact(log_mass=np.log(10.0), log_friction_x=np.log(0.4), log_friction_y=np.log(0.4))
    limit = 0.4 * 10.0 * contact_model.GRAVITY
    named = dict(zip(contact_model.PARAMETERS, np.asarray(heavy), strict=True))
    assert contact_model.resistance(named)[f"along {'xy'[axis]}"] == pytest.approx(limit, rel=1e-5)
    below, beyond = (acceleration(heavy, inputs(wrench=factor * limit * np.eye(3)[axis])) for factor in (0.6, 1.5))
    assert np.abs(below).max() < 1e-3
    np.testing.assert_allclose(beyond, 0.5 * limit / 10.0 * np.eye(3)[axis], atol=0.1)


def test_a_push_on_one_side_of_the_grip_turns_it() -> None:
    gripping = contact(grip_y=0.5, log_friction_x=np.log(0.3), log_friction_y=np.log(0.3))
    assert acceleration(gripping, inputs(wrench=(60.0, 0.0, 0.0)))[2] > 0.5


@pytest.mark.parametrize("seed", [3, 8])
def test_it_is_the_simulators_box(seed: int) -> None:
    """Random pushes, holding, sliding and turning: the simulator with the same box leaves little unexplained."""
    box = draw_condition("box", seed, {"payload": 0.0})
    length, width, _ = box.size
    size, mass, friction = np.hypot(length, width) / 2, box.mass, box.friction
    told = contact(
        log_mass=np.log(mass),
        log_gyration=np.log(np.hypot(length, width) / 12**0.5 / size),
        log_friction_x=np.log(friction),
        log_friction_y=np.log(friction),
        log_foot_x=np.log((length / 2 - 0.01) / size),
        log_foot_y=np.log((width / 2 - 0.01) / size),
    )
    rng = np.random.default_rng(seed)
    count, limit = 60, mass * friction * contact_model.GRAVITY
    rows = np.zeros((count, 13))
    rows[:, :3] = rng.normal(size=(count, 3)) * [0.2, 0.2, 0.3] * (rng.random((count, 1)) < 0.6)
    rows[:, 3:6] = rng.normal(size=(count, 3)) * limit * [0.7, 0.7, 0.15]
    rows[:, 9] = size
    truth, _ = replay.accelerations(box.to_dict(), rows, np.zeros((count, 3)), np.ones(count))
    said = jax.vmap(lambda x: contact_model.acceleration(told, x))(jnp.asarray(rows, jnp.float32))
    left = np.sum((truth - said) ** 2, axis=0) / np.sum((truth - truth.mean(axis=0)) ** 2, axis=0)
    assert left.max() < 0.1, left
