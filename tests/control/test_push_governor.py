"""The governor on the lean, and the quasi-static pusher that shares it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.control.governor import INTEGRAL_LIMIT, GovernorConfig, forward_lean, govern, static_lean
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.control.quasi_static import LEAN_LIMIT, QuasiStaticPusher
from shmoo_mjx.control.speed import SpeedProfile
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of, stand_off
from shmoo_mjx.geometry.hands import HAND_HEIGHT
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.types import DT

REST = np.zeros(2)


def moving(twist: np.ndarray, wrench: np.ndarray, pose: np.ndarray | None = None) -> ObjectObservation:
    pose = np.zeros(3) if pose is None else pose
    return ObjectObservation(pose, twist, REST, REST, np.zeros(3), np.zeros(3), wrench)


def lean_at(twist: np.ndarray, wrench: np.ndarray, limit: float, integral: float = 0.0) -> tuple[float, float]:
    return forward_lean(GovernorConfig(), moving(twist, wrench), limit, integral)


def test_a_stuck_object_gets_all_the_lean_it_resists_and_some_more() -> None:
    at_rest, _ = lean_at(np.zeros(3), np.array([40.0, 0.0, 0.0]), 0.2)
    assert at_rest == pytest.approx(40.0 * HAND_HEIGHT / shmoobot().flatness[2] + 0.25 * 0.2 + 0.1 * 0.2 * DT)
    assert at_rest > static_lean(40.0)


def test_what_feels_too_little_does_not_stay_stuck_but_is_leant_into_no_harder_than_allowed() -> None:
    integral, leans = 0.0, []
    for _ in range(60):
        lean, integral = lean_at(np.zeros(3), np.array([30.0, 0.0, 0.0]), 0.1, integral)
        leans.append(lean)
    assert leans[30] > static_lean(30.0) + 0.25 * 0.1 + 0.02
    assert integral == pytest.approx(INTEGRAL_LIMIT)
    # Nothing touched: nothing to lean into. Faster than allowed: it goes back.
    assert lean_at(np.zeros(3), np.zeros(3), 0.1, 0.02)[1] == pytest.approx(0.02)
    assert lean_at(np.array([0.3, 0.0, 0.0]), np.array([30.0, 0.0, 0.0]), 0.1, 0.02)[1] < 0.02


@settings(deadline=None)
@given(st.floats(0, 60), st.floats(0.16, 0.6))
def test_above_the_speed_allowed_the_lean_never_sustains_the_force(force: float, speed: float) -> None:
    lean, _ = lean_at(np.array([speed, 0, 0]), np.array([force, 0, 0]), 0.15)
    assert lean <= 0.3 * static_lean(force) + 1e-9


@settings(deadline=None)
@given(st.floats(-3, 3))
def test_only_the_frame_of_the_robot_counts(yaw: float) -> None:
    def lean(angle: float) -> float:
        turned = [se2.rotate(np.array(v), angle) for v in ([0.1, 0.05, 0.2], [20.0, 5.0, 1.0])]
        return forward_lean(GovernorConfig(), moving(*turned, np.array([1.0, 2.0, angle])), 0.2, 0.0)[0]

    assert lean(yaw) == pytest.approx(lean(0.0), abs=1e-9)


@settings(deadline=None)
@given(st.floats(-0.3, 0.3), st.floats(-0.1, 0.1), st.floats(0, 0.1))
def test_the_plan_keeps_its_bounds_and_its_steering(wanted: float, lean: float, room: float) -> None:
    u = govern(np.array([wanted, 0.03, -0.2]), lean - room, lean)
    assert lean - room - 1e-12 <= u[0] <= lean + 1e-12
    assert u[1] == 0.03
    assert u[2] == -0.2
    if lean - room <= wanted <= lean:
        assert u[0] == wanted


def _sighting(object_pose: np.ndarray, face: np.ndarray) -> ObjectObservation:
    robot = stand_off(object_pose, face, 0.0)
    return ObjectObservation(robot, np.zeros(3), REST, REST, object_pose, np.zeros(3), np.zeros(3))


@pytest.mark.parametrize("side", range(4))
@pytest.mark.parametrize("turn", [-0.5, 0.5])
def test_the_quasi_static_pusher_steers_towards_its_goal(side: int, turn: float) -> None:
    face = faces_of((0.35, 0.3))[side]
    pose = np.array([0.3, -0.2, 0.7])
    direction = pose[2] + face[2] + turn / 2
    goal = np.array([*(pose[:2] + np.array([np.cos(direction), np.sin(direction)])), pose[2] + turn])
    pusher = QuasiStaticPusher(SpeedProfile(limit=0.15))
    now = _sighting(pose, face)
    u, state, _ = pusher.step(pusher.init(now, face, None, None), now, goal=goal)
    # A left turn takes the right hand forward (negative gamma) and the hands to the right (negative lean along y).
    assert np.sign(u[2]) == -np.sign(turn)
    assert np.sign(u[1]) == -np.sign(turn)
    assert 0 < u[0] <= LEAN_LIMIT
    assert np.array_equal(pusher.coast(state), pose)
