"""Terms of the push cost that bring an object to a pose and let it arrive slowly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.control.cost import aim_error
from shmoo_mjx.control.speed import SpeedProfile
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.types import SystemState


def _standing(pose: np.ndarray, face: np.ndarray) -> SystemState:
    """One roll-out of two samples in which nothing moves."""
    shape = (1, 2)
    zeros = {name: np.zeros((*shape, 3)) for name in SystemState._fields}
    values = zeros | {"object_pose": np.broadcast_to(pose, (*shape, 3)), "face": np.broadcast_to(face, (*shape, 4))}
    return SystemState(**values)


@settings(deadline=None)
@given(st.floats(-0.9, 0.9), st.floats(0.3, 2.0), st.integers(0, 3), st.floats(-3, 3))
def test_an_object_on_the_arc_to_its_goal_is_aimed_right(turn: float, length: float, side: int, yaw: float) -> None:
    face = faces_of((0.3, 0.2))[side]
    start = np.array([0.4, -0.7, yaw])
    chord = length * np.sinc(turn / 2 / np.pi)
    step = np.append(se2.rotate(np.array([chord * np.cos(turn / 2), chord * np.sin(turn / 2)]), face[2]), turn)
    goal = se2.compose(start, step)
    error = float(aim_error(goal, _standing(start, face), with_yaw=True)[0])
    assert error == pytest.approx(0.0, abs=2e-4)
    straight = float(aim_error(goal, _standing(start, face))[0])
    assert straight == pytest.approx(abs(chord * np.sin(turn / 2)), abs=2e-4)


def test_turning_the_wrong_way_costs_more_than_turning_the_right_way() -> None:
    goal, face = np.array([1.0, 0.0, 0.5]), faces_of((0.3, 0.2))[0]
    right = float(aim_error(goal, _standing(np.array([0.0, 0.0, -0.4]), face), with_yaw=True)[0])
    wrong = float(aim_error(goal, _standing(np.array([0.0, 0.0, 0.4]), face), with_yaw=True)[0])
    assert right < 0.2 < wrong


@settings(deadline=None)
@given(st.floats(0, 5), st.floats(0, 5))
def test_speed_falls_towards_the_goal_and_stays_under_its_limit(near: float, far: float) -> None:
    profile = SpeedProfile(limit=0.2, at_goal=0.07, slow_down=0.25)
    near, far = sorted((near, far))
    slow, fast = float(profile.allowed(near)), float(profile.allowed(far))
    assert 0.07 <= slow <= fast <= 0.2


def test_without_slow_down_the_limit_is_the_same_everywhere() -> None:
    assert np.allclose(SpeedProfile(limit=0.3).allowed(np.array([0.0, 0.1, 3.0])), 0.3)
