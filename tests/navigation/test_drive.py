"""Driving: the lean that is commanded points the right way once it takes effect."""

from __future__ import annotations

import numpy as np
import pytest

from shmoo_mjx import se2
from shmoo_mjx.navigation import drive, flat_trajectory
from shmoo_mjx.navigation.clearance import ClearanceField
from shmoo_mjx.navigation.flat_trajectory import FlatModel
from shmoo_mjx.navigation.paths import Path
from shmoo_mjx.plant.robot import ROBOT
from shmoo_mjx.types import Observation

CONFIG = drive.DriveConfig()
PLANNER = flat_trajectory.init(FlatModel(*ROBOT.flatness))


@pytest.mark.parametrize("rate", [-0.8, 0.0, 0.8])
def test_a_robot_that_turns_leans_where_its_way_leads_when_the_lean_arrives(rate: float) -> None:
    path = Path(np.array([[0.0, 0.0], [3.0, 0.0]]), 3.0)
    seen = at_rest_turning(0.3, rate)
    _, lean = drive.follow(CONFIG, PLANNER, drive.init(), seen, path, open_floor)
    in_world = se2.rotate(lean, 0.3 + CONFIG.lead * rate)
    assert in_world[0] > 0.005 and abs(in_world[1]) < 1e-4


def open_floor() -> ClearanceField:
    return ClearanceField(np.full((100, 100), 5.0), np.array([-5.0, -5.0, 0.0]), np.asarray(0.1))


def at_rest_turning(yaw: float, rate: float) -> Observation:
    pose, twist, none = np.array([[0.0, 0.0, yaw]]), np.array([[0.0, 0.0, rate]]), np.zeros((1, 2))
    hands, objects, wrench = np.zeros((1, 2, 3)), np.zeros((1, 0, 3)), np.zeros((1, 2, 3))
    robot = (pose, twist, none, none)
    ages = (np.zeros(1), np.zeros((1, 0)), np.zeros((1, 0), dtype=bool))
    return Observation(np.zeros(1), *robot, hands, objects, objects, wrench, *ages)
