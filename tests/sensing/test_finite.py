"""A NaN in an observation is replaced before anybody computes a command from it."""

from __future__ import annotations

import numpy as np
import pytest

from shmoo_mjx.sensing import finite
from shmoo_mjx.types import Observation


def good(time: float = 1.0) -> Observation:
    return Observation(
        time=np.array([time]),
        robot_pose=np.array([[1.0, 2.0, 0.3]]),
        robot_twist=np.array([[0.1, 0.0, 0.2]]),
        lean=np.array([[0.01, 0.02]]),
        lean_rate=np.array([[0.1, 0.2]]),
        hands=np.full((1, 2, 3), 0.4),
        object_pose=np.array([[[3.0, 0.0, 0.1], [np.nan] * 3]]),
        object_twist=np.zeros((1, 2, 3)) + 0.05,
        wrench=np.array([[[10.0, 1.0, 0.5], [0.0, 0.0, 0.0]]]),
        robot_age=np.array([0.03]),
        object_age=np.array([[0.05, np.inf]]),
        detected=np.array([[True, False]]),
    )


def test_nothing_happens_to_a_sound_observation_of_known_objects() -> None:
    seen = good()
    seen = seen._replace(**{n: getattr(seen, n)[:, :1] for n in ("object_pose", "object_twist", "wrench")})
    seen = seen._replace(object_age=seen.object_age[:, :1], detected=seen.detected[:, :1])
    assert finite(seen, None) is seen


@pytest.mark.parametrize("field", ["robot_pose", "robot_twist", "lean", "lean_rate", "hands"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_the_robot_knows_of_itself(field: str, value: float) -> None:
    broken = getattr(good(), field).copy()
    broken[0, 0] = value
    for last in (None, good(0.9)):
        seen = finite(good()._replace(**{field: broken}), last)
        assert np.isfinite(getattr(seen, field)).all()
        if last is not None:
            np.testing.assert_array_equal(getattr(seen, field), getattr(good(), field))
        assert seen.robot_age[0] == (np.inf if last is None else pytest.approx(0.13))


def test_a_lost_pose_is_the_last_one_older_and_at_rest() -> None:
    broken = good().object_pose.copy()
    broken[0, 0, 1] = np.nan
    seen = finite(good()._replace(object_pose=broken), finite(good(0.9)))
    np.testing.assert_array_equal(seen.object_pose[0, 0], good().object_pose[0, 0])
    np.testing.assert_array_equal(seen.object_twist[0], 0.0)
    assert seen.object_age[0, 0] == pytest.approx(0.15) and not seen.detected.any()


def test_a_half_broken_pose_of_an_unknown_object_is_wholly_unknown() -> None:
    broken = good().object_pose.copy()
    broken[0, 0, 1] = np.nan
    seen = finite(good()._replace(object_pose=broken), None)
    assert np.isnan(seen.object_pose[0]).all() and np.isinf(seen.object_age).all() and not seen.detected.any()
    assert np.isfinite(seen.wrench).all() and not seen.wrench.any()


def test_twist_and_wrench() -> None:
    seen = finite(good()._replace(object_twist=np.full((1, 2, 3), np.nan), wrench=np.full((1, 2, 3), np.nan)))
    np.testing.assert_array_equal(seen.object_twist, 0.0)
    np.testing.assert_array_equal(seen.wrench, 0.0)
    np.testing.assert_array_equal(seen.object_pose[0, 0], good().object_pose[0, 0])
    assert not seen.detected.any()


def test_many_broken_samples_in_a_row() -> None:
    last, broken = finite(good()), good()._replace(robot_pose=np.full((1, 3), np.nan))
    for i in range(1, 4):
        last = finite(broken, last)
        assert last.robot_age[0] == pytest.approx(0.03 + 0.1 * i)
        np.testing.assert_array_equal(last.robot_pose, good().robot_pose)
