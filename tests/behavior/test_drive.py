"""Driving: the lean that is commanded points the right way once it takes effect."""

from __future__ import annotations

import numpy as np
import pytest

from shmoo_mjx.behavior import drive
from shmoo_mjx.control import equilibrium_lean
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.planning import flat_qp
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.flat_model import FlatModel
from shmoo_mjx.planning.paths import Path
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.sensing import REAL, SensedEngine
from shmoo_mjx.types import Command, Observation

PLANNER = flat_qp.init(FlatModel(*shmoobot().flatness))


@pytest.mark.parametrize("rate", [-0.8, 0.0, 0.8])
def test_a_robot_that_turns_leans_where_its_way_leads_when_the_lean_arrives(rate: float) -> None:
    path = Path(np.array([[0.0, 0.0], [3.0, 0.0]]), 3.0)
    seen = at_rest_turning(0.3, rate)
    _, lean = drive.follow(PLANNER, drive.init(), seen, path, clearance=open_floor)
    in_world = se2.rotate(lean, 0.3 + drive.LEAD * rate)
    assert in_world[0] > 0.005 and abs(in_world[1]) < 1e-4


def open_floor() -> DistanceField:
    return DistanceField(np.full((100, 100), 5.0), np.array([-5.0, -5.0, 0.0]), np.asarray(0.1))


def at_rest_turning(yaw: float, rate: float) -> Observation:
    pose, twist, none = np.array([[0.0, 0.0, yaw]]), np.array([[0.0, 0.0, rate]]), np.zeros((1, 2))
    hands, objects, wrench = np.zeros((1, 2, 3)), np.zeros((1, 0, 3)), np.zeros((1, 2, 3))
    robot = (pose, twist, none, none)
    ages = (np.zeros(1), np.zeros((1, 0)), np.zeros((1, 0), dtype=bool))
    return Observation(np.zeros(1), *robot, hands, objects, objects, wrench, *ages)


@pytest.mark.parametrize("seed", [3, 5, 6])
def test_with_real_senses_the_robot_comes_to_rest_at_the_end_of_its_way(seed: int) -> None:
    """Trajectories planned from what is measured, which lags behind what is commanded, wander twice as far."""
    engine = SensedEngine([build_scene([], (0.0, 0.0, 0.0), adjust=REAL.adjust(seed))], REAL, seed)
    path, state, balance = (
        Path(np.array([[0.0, 0.0], [0.6, 0.0], [0.6, 0.5]]), 1.1),
        drive.init(),
        equilibrium_lean.init(),
    )
    strayed = []
    with engine:
        world = engine.init()
        seen = engine.observe(world)
        while float(seen.time[0]) < 14.0:
            balance = equilibrium_lean.step(balance, seen)
            ahead = equilibrium_lean.predicted(equilibrium_lean.corrected(balance, seen), REAL.latency)
            state, lean = drive.follow(PLANNER, state, ahead, path, clearance=open_floor)
            command = Command(*(np.array([x]) for x in ([*lean, 0.0], 0.6, TUCKED_REACH, TUCKED_HEIGHT)))
            world, seen = engine.step(world, equilibrium_lean.shifted(balance, command))
            if float(seen.time[0]) > 8.0:
                strayed.append(np.linalg.norm(seen.robot_pose[0, :2] - path.points[-1]))
    assert max(strayed) < 0.04, f"{max(strayed):.3f} m from the end"
