"""The replay of an object under recorded wrenches: Coulomb's law over seconds, and no error where nothing happens."""

from __future__ import annotations

import numpy as np
import pytest

from shmoo_mjx.evaluation import replay
from shmoo_mjx.plant.objects import draw_condition


def rows(force: float, size: float, count: int = 40) -> np.ndarray:
    """A box at rest, pushed along x of {O}."""
    found = np.zeros((count, 13))
    found[:, 3], found[:, 9] = force, size
    return found


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_a_box_pushed_for_three_seconds_goes_as_far_as_newton_and_coulomb_say(yaw: float) -> None:
    box = draw_condition("box", 3, {"payload": 0.0, "friction": 0.4, "mass": 8.0})
    friction = 0.4 * 8.0 * 9.81
    pose = np.tile([1.0, -2.0, yaw], (40, 1))
    run = np.arange(40, 0, -1)
    said, rolled = replay.accelerations(box.to_dict(), rows(1.5 * friction, 0.4), pose, run, starts=(2, 5))
    assert set(rolled) == {2, 5} and rolled[2].shape == (31, 3)
    np.testing.assert_allclose(said[1:, 0], 0.5 * friction / 8.0, rtol=0.1)
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    np.testing.assert_allclose(rolled[2][-1, :2] - pose[0, :2], 0.25 * friction / 8.0 * 9.0 * ahead, rtol=0.1)
    held, still = replay.accelerations(box.to_dict(), rows(0.7 * friction, 0.4), pose, run, starts=(2,))
    assert np.abs(held).max() < 0.05
    assert np.hypot(*(still[2][-1] - pose[0])[:2]) < 0.02


def test_errors_are_of_the_end_and_wrap() -> None:
    poses = np.tile([0.0, 0.0, 3.1], (60, 1))
    rolled = {0: np.tile([0.0, 0.0, -3.1], (31, 1)), 5: np.tile([0.3, 0.4, 3.1], (31, 1))}
    found = replay._ends({10: [0, 5], 30: []}, rolled, poses)
    assert found["pos_rmse_1s_m"] == pytest.approx(0.5 / 2**0.5)
    assert found["yaw_rmse_1s_deg"] == pytest.approx(np.rad2deg(2 * np.pi - 6.2) / 2**0.5)
    assert np.isnan(found["pos_rmse_3s_m"])
