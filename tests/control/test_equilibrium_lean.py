"""Trim: found while driving, left alone in contact; a robot with a shifted centre of mass stands still, and one whose
arms' motors are weaker than it thinks learns how hard it pushes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.behavior.skills import batched
from shmoo_mjx.control import equilibrium_lean
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant.perturbation import Perturbation, adjustment, draw_body
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.types import DT, Command, Observation

HANDS = np.array([[TUCKED_REACH, 0.1, TUCKED_HEIGHT], [TUCKED_REACH, -0.1, TUCKED_HEIGHT]])


def command(lean: np.ndarray, gamma: float = 0.0) -> Command:
    return batched(Command(np.append(lean, gamma), 0.0, TUCKED_REACH, TUCKED_HEIGHT))


def seen(
    t: float, yaw: float, velocity: np.ndarray, lean: np.ndarray, rate: np.ndarray, force: float = 0.0
) -> Observation:
    """One world with one object."""
    pose, twist, wrench = [0.0, 0.0, yaw], [*velocity, 0.0], [[force, 0.0, 0.0]]
    values = (t, pose, twist, lean, rate, HANDS, np.zeros((1, 3)), np.zeros((1, 3)), wrench, 0.0, [0.0], [1.0])
    return Observation(*(np.array(v, dtype=float)[None] for v in values))


def drive(bias: np.ndarray, seed: int, force: float = 0.0, seconds: float = 12.0) -> equilibrium_lean.LeanOffset:
    """The flat system leant at random, its senses with noise."""
    rng, (a, b, c) = np.random.default_rng(seed), shmoobot().flatness
    state, flat, yaw = equilibrium_lean.init(), np.zeros(2), 0.0
    lean, wanted = bias.copy(), bias.copy()
    for i in range(round(seconds / DT)):
        if i % 8 == 0:
            wanted = bias + rng.uniform(-0.05, 0.05, 2)
        rate = (wanted - lean) / 0.3
        velocity = flat - b / a * se2.rotate(rate, yaw)
        noisy = lean - equilibrium_lean.arms_lean(HANDS) + rng.normal(0, 2e-3, 2)
        state = equilibrium_lean.step(state, seen(i * DT, yaw, velocity + rng.normal(0, 0.01, 2), noisy, rate, force))
        mean = lean + 0.5 * rate * DT - bias
        lean = lean + rate * DT
        flat = flat + DT * c / a * se2.rotate(mean, yaw)
    return state


@settings(max_examples=10, deadline=None)
@given(x=st.floats(-0.03, 0.03), y=st.floats(-0.03, 0.03), seed=st.integers(0, 100))
def test_finds_the_lean_at_which_the_robot_balances(x: float, y: float, seed: int) -> None:
    found = drive(np.array([x, y]), seed)
    assert np.abs(found.lean - [x, y]).max() < 4e-3


def test_what_is_felt_in_contact_does_not_count() -> None:
    assert not drive(np.array([0.02, 0.0]), 0, force=5.0).lean.any()


def test_never_trusts_more_than_its_limit() -> None:
    assert drive(np.array([0.2, 0.0]), 0).lean[0] == pytest.approx(equilibrium_lean.LIMIT)


def test_lean_is_counted_from_the_trim_both_ways() -> None:
    state = equilibrium_lean.init()._replace(lean=np.array([0.01, -0.02]))
    now = seen(0.0, 0.0, np.zeros(2), np.array([0.03, 0.0]), np.zeros(2))
    assert equilibrium_lean.corrected(state, now).lean[0] == pytest.approx([0.02, 0.02])
    applied = equilibrium_lean.shifted(state, command(np.array([0.05, 0.0]), 0.1))
    assert applied.u[0] == pytest.approx([0.06, -0.02, 0.1])


def test_a_robot_with_a_shifted_centre_of_mass_stands_still() -> None:
    from shmoo_mjx.behavior.drive import velocity_command
    from shmoo_mjx.plant.engine_mujoco import MujocoEngine

    body = draw_body(Perturbation(), 3)._replace(com=(0.004, -0.005, 0.0))
    drifts = []
    for learns in (False, True):
        engine = MujocoEngine([build_scene(adjust=adjustment(body))])
        world, state = engine.init(), equilibrium_lean.init()
        for i in range(120):
            now = engine.observe(world)
            if learns:
                state = equilibrium_lean.step(state, now)
            if i == 60:
                start = now.robot_pose[0, :2]
            lean = velocity_command(now, np.zeros(2))
            world, _ = engine.step(world, equilibrium_lean.shifted(state, command(lean)))
        drifts.append(float(np.linalg.norm(engine.observe(world).robot_pose[0, :2] - start)))
        engine.close()
    share = shmoobot().body_mass / shmoobot().upper_mass
    assert state.lean == pytest.approx(-share * np.array(body.com[:2]) / shmoobot().body_com_height, abs=2e-3)
    assert drifts[0] > 0.1 and drifts[1] < 0.25 * drifts[0]
