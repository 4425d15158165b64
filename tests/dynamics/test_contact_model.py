"""The four-point contact model: Newton, Coulomb, and the simulator's box."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.dynamics import contact_model
from shmoo_mjx.evaluation import replay
from shmoo_mjx.learning import contact_prior
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.types import DT

GUESS = np.array(list(contact_model.GUESS.values()))
SPREAD = contact_prior.draws(96).std(axis=0)
SIZE = 0.4


def contact(friction: tuple[float, float] | None = None, **named: float) -> jnp.ndarray:
    """Parameters as guessed but for those named, and the friction of all points along x and y."""
    values = contact_model.GUESS | named
    for axis, mu in zip("xy", friction or (), strict=False):
        values |= {f"log_friction_{axis}_{point}": float(np.log(mu)) for point in contact_model.POINTS}
    return jnp.asarray([(values | named)[name] for name in contact_model.PARAMETERS], jnp.float32)


def inputs(twist: object = (0.0, 0.0, 0.0), wrench: object = (0.0, 0.0, 0.0)) -> jnp.ndarray:
    return jnp.asarray([*np.asarray(twist), *np.asarray(wrench), 0.0, 0.0, 0.0, SIZE], jnp.float32)


acceleration = jax.jit(contact_model.acceleration)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3), st.integers(0, 1000))
def test_friction_never_drives(twist: list[float], seed: int) -> None:
    parameters = jnp.asarray(GUESS + SPREAD * np.random.default_rng(seed).normal(size=len(GUESS)), jnp.float32)
    change = 0.1 * np.asarray(acceleration(parameters, inputs(twist)))
    named = dict(zip(contact_model.PARAMETERS, np.asarray(parameters), strict=True))

    def energy(v: np.ndarray) -> float:
        x, y = SIZE * named["centre_x"], SIZE * named["centre_y"]
        gyration = SIZE * np.exp(named["log_gyration"])
        return float((v[0] - v[2] * y) ** 2 + (v[1] + v[2] * x) ** 2 + (gyration * v[2]) ** 2)

    assert energy(np.array(twist) + change) <= energy(np.array(twist)) * (1 + 1e-3) + 1e-6


def test_without_friction_it_obeys_newton() -> None:
    free = contact(log_mass=np.log(20.0), log_gyration=np.log(0.5), friction=(1e-9, 1e-9))
    found = acceleration(free, inputs(wrench=(10.0, -4.0, 1.5)))
    np.testing.assert_allclose(found, [0.5, -0.2, 1.5 / (20.0 * 0.2**2)], rtol=1e-3)


@pytest.mark.parametrize("axis", [0, 1])
def test_it_holds_up_to_coulombs_limit_and_slides_beyond(axis: int) -> None:
    # The wider the points beside the radius of gyration, the more iterations they need to agree.
    heavy = contact(log_mass=np.log(10.0), log_gyration=-0.5, friction=(0.4, 0.4))
    limit = 0.4 * 10.0 * contact_model.GRAVITY
    assert contact_model.resistance(heavy)[axis] == pytest.approx(limit, rel=1e-5)
    below, beyond = (acceleration(heavy, inputs(wrench=factor * limit * np.eye(3)[axis])) for factor in (0.6, 1.5))
    assert np.abs(below).max() < 1e-3
    np.testing.assert_allclose(beyond, 0.5 * limit / 10.0 * np.eye(3)[axis], atol=0.1)


def test_a_locked_wheel_turns_it_to_its_side() -> None:
    locked = contact(
        friction=(0.02, 0.02), log_friction_x_front_left=np.log(0.6), log_friction_y_front_left=np.log(0.6)
    )
    assert acceleration(locked, inputs(wrench=(60.0, 0.0, 0.0)))[2] > 0.5


def test_a_caster_keeps_its_direction_until_its_swivel_turns() -> None:
    swivels = {f"log_swivel_{point}": np.log(0.05) for point in contact_model.POINTS}
    cart = contact(log_mass=np.log(20.0), friction=(0.01, 0.01), **swivels)
    limit = 0.05 * 20.0 * contact_model.GRAVITY
    for ahead, across in (((0.2, 0.0, 0.0), (0.0, 1.0, 0.0)), ((0.0, 0.2, 0.0), (1.0, 0.0, 0.0))):
        below, beyond = (
            acceleration(cart, inputs(ahead, factor * limit * np.array(across))) @ np.array(across)
            for factor in (0.5, 2)
        )
        assert abs(below) < 0.03
        assert 0.35 * limit / 20.0 < beyond < limit / 20.0
        # Along its way only the rolling resistance counts.
        along = acceleration(cart, inputs(ahead, limit * np.array(ahead) / 0.2)) @ np.array(ahead) / 0.2
        assert along == pytest.approx((0.05 - 0.01) * contact_model.GRAVITY, rel=0.05)


def test_casters_let_it_turn_on() -> None:
    """Held in the axes of {O}, they would stop the turn."""
    swivels = {f"log_swivel_{point}": np.log(0.05) for point in contact_model.POINTS}
    cart = contact(log_mass=np.log(20.0), friction=(1e-4, 1e-4), **swivels)
    assert abs(acceleration(cart, inputs((0.2, 0.0, 0.2)))[2]) < 0.1


def test_a_caster_that_points_aside_holds_the_way_ahead() -> None:
    swivels = {f"log_swivel_{point}": np.log(0.05) for point in contact_model.POINTS}
    cart = contact(log_mass=np.log(20.0), friction=(1e-4, 1e-4), **swivels)
    limit = 0.05 * 20.0 * contact_model.GRAVITY
    aside, ahead = (directions(np.full(4, angle)) for angle in (np.pi / 2, 0.0))
    for force, expected in ((0.9 * limit, 0.0), (2.0 * limit, limit / 20.0)):
        there = inputs(wrench=(force, 0.0, 0.0))
        assert acceleration(cart, there, casters=aside)[0] == pytest.approx(expected, abs=0.03)
        assert acceleration(cart, there, casters=ahead)[0] == pytest.approx(force / 20.0, rel=0.02)


def test_casters_turn_as_wheels_that_do_not_slip_sideways() -> None:
    """The closed form is the limit of small steps, and the object's own turn leaves them where they point."""
    cart = jnp.asarray(contact(log_mass=np.log(20.0)))
    start = np.array([0.3, -2.0, 3.1, 1.5], np.float32)
    for twist in ((0.2, 0.0, 0.0), (0.1, -0.2, 0.0), (0.3, 0.1, 0.4)):
        once = contact_model.turned(directions(start), cart, np.array(twist, np.float32), SIZE)
        small = start.astype(float)
        for _ in range(2000):
            small = small + (rates(cart, small, twist)) * DT / 2000
        np.testing.assert_allclose(once, directions(small), atol=0.03)
    still = contact_model.turned(directions(start), cart, np.zeros(3, np.float32), SIZE)
    np.testing.assert_allclose(still, directions(start), atol=1e-5)


def directions(angles: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1).astype(np.float32)


def rates(parameters: jnp.ndarray, casters: np.ndarray, twist: tuple[float, float, float]) -> np.ndarray:
    """Rate of each caster [rad/s] in {O} from the sideways speed of its swivel."""
    named = dict(zip(contact_model.PARAMETERS, np.asarray(parameters, float), strict=True))
    vx, vy, spin = twist
    found = []
    for angle, (front, left) in zip(casters, contact_model.POINTS.values(), strict=True):
        x = (named["feet_x"] + front * np.exp(named["log_foot_x"])) * SIZE
        y = (named["feet_y"] + left * np.exp(named["log_foot_y"])) * SIZE
        sideways = -np.sin(angle) * (vx - spin * y) + np.cos(angle) * (vy + spin * x)
        found.append(sideways / contact_model._TRAIL - spin)
    return np.array(found)


def test_its_gradient_is_that_of_the_solver() -> None:
    """Its derivative has a rule of its own. The solver's forward derivative does not use it."""
    rng = np.random.default_rng(0)
    swivels = {f"log_swivel_{point}": np.log(0.05) for point in contact_model.POINTS}
    cart = contact(log_mass=np.log(20.0), friction=(0.02, 0.03), **swivels)
    turning = jnp.concatenate([inputs((0.2, -0.1, 0.3), (25.0, 8.0, 3.0)), jnp.ones(3)])
    arguments = cart, turning, jnp.asarray(directions(rng.uniform(-np.pi, np.pi, 4)))
    shifts = (-0.2, 0.0)
    solved = jax.jit(jax.jacfwd(partial(contact_model._solved, shifts), (0, 1, 2)))(*arguments)
    ours = jax.jit(jax.jacrev(lambda p, x, c: contact_model.acceleration(p, x, shifts, c), (0, 1, 2)))(*arguments)
    for one, other in zip(ours, solved, strict=True):
        assert np.abs(other).max() > 0.0
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("family", ["cart", "wheelchair"])
def test_the_swivels_of_an_object_hold_by_their_friction_and_trail(family: str) -> None:
    free = [False] * 4
    light, stiff = (draw_condition(family, 3, {"swivel_friction": value, "locked": free}) for value in (0.02, 0.3))
    swivel = [i for i, name in enumerate(contact_model.PARAMETERS) if name.startswith("log_swivel")]
    forces = [np.exp(p[swivel]) * contact_model.loads(p) for p in map(contact_prior.parameters_of, (light, stiff))]
    trail = {"cart": 0.04, "wheelchair": 0.05}[family]
    casters = 4 if family == "cart" else 2
    np.testing.assert_allclose((forces[1] - forces[0])[:casters], 0.28 / trail, rtol=0.02)
    assert (forces[1][casters:] < 0.1).all()


def test_resistance_is_what_a_straight_push_meets() -> None:
    """The load that stands off the middle weighs on the points near it."""
    rear = {f"log_friction_y_rear_{side}": float(np.log(0.6)) for side in ("left", "right")}
    chair = contact(log_mass=np.log(30.0), friction=(0.02, 0.02), centre_x=-0.1, **rear)
    half = float(np.exp(contact_model.GUESS["log_foot_x"]))
    on_rear = 0.5 * (1 + 0.1 / half)
    expected = 30.0 * contact_model.GRAVITY * np.array([0.02, 0.02 * (1 - on_rear) + 0.6 * on_rear])
    np.testing.assert_allclose(contact_model.resistance(chair), expected, rtol=1e-4)


@pytest.mark.parametrize("seed", [3, 8])
def test_it_is_the_simulators_box(seed: int) -> None:
    """Random pushes, holding, sliding and turning: the simulator with the same box leaves little unexplained."""
    box = draw_condition("box", seed, {"payload": 0.0})
    size, mass, friction = np.hypot(*box.half_extents), box.mass, box.friction
    told = jnp.asarray(contact_prior.parameters_of(box), jnp.float32)
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


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(st.floats(-5, 5), st.floats(-5, 5)), st.sampled_from([(1.0, 1.0), (0.05, 1.0), (0.8, 1.0), (1.0, 0.3)])
)
def test_a_point_holds_the_impulse_nearest_to_what_would_stop_it(trial: tuple[float, float], grips: Any) -> None:
    x, y, weight, *frictions = (jnp.asarray(a, jnp.float32) for a in (*trial, 1.0, *grips))
    held = contact_model._within_grip(x, y, weight, tuple(frictions))
    angle = np.linspace(-np.pi, np.pi, 2001)
    rim = max(grips) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    allowed = np.concatenate([s * np.clip(rim, -np.array(grips), grips) for s in np.linspace(0, 1, 101)])
    nearest = np.linalg.norm(allowed - trial, axis=1).min()
    assert np.all(np.abs(held) <= np.array(grips) + 1e-5) and np.hypot(*held) <= max(grips) + 1e-5
    assert abs(np.linalg.norm(np.array(held) - trial) - nearest) < 0.02


@pytest.mark.parametrize("payload", [5.0, 60.0])
def test_a_wheel_that_rolls_keeps_its_grip_across(payload: float) -> None:
    chair = contact_prior.parameters_of(draw_condition("wheelchair", 3, {"payload": payload, "locked": [False] * 4}))
    named, size = dict(zip(contact_model.PARAMETERS, chair.tolist(), strict=True)), 0.48
    sideways = 0.5 * float(contact_model.resistance(chair)[1])
    axle = size * (named["feet_x"] - np.exp(named["log_foot_x"]))
    twist = np.zeros(3)
    for _ in range(10):
        rows = inputs(twist, (0.2 * sideways, sideways, axle * sideways)).at[9].set(size)
        twist = twist + np.asarray(contact_model.acceleration(jnp.asarray(chair, jnp.float32), rows)) * DT
    # Pushed across at its axle it rolls along x, and does not slide.
    assert twist[0] > 0.3
    assert abs(twist[1] + twist[2] * axle) < 0.05
