"""What the tutorial's step 6 shows: the estimate of a box while `PushTask` pushes it, with real sensing."""

from __future__ import annotations

import numpy as np
import pytest

from shmoo_mjx.behavior.push_task import PushTask
from shmoo_mjx.control.presets import pose_push_config
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.geometry.hands import touches
from shmoo_mjx.learning import online
from shmoo_mjx.learning.contact_prior import true_values
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.planning.maps import OccupancyGrid
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.sensing import REAL, SensedEngine
from shmoo_mjx.types import DT

BOX = draw_condition("box", 3, {"mass": 6.0, "friction": 0.4})
pytestmark = pytest.mark.slow
Estimates = tuple[dict[str, np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def estimates() -> Estimates:
    """What is known of the box after each sample of the push ``[T]`` by name, and contact up to then ``[T]`` [s]."""
    room = OccupancyGrid(np.zeros((160, 160), np.int8), resolution=0.05, origin=(-4.0, -4.0, 0.0))
    pusher = PushController(load_weights(), pose_push_config())
    task = PushTask(room, [BOX.half_extents], goal=(0.5, 0.0, 0.0), pusher=pusher, kinds=["box"])
    rows, contact = [], []
    with SensedEngine([build_scene([(BOX, (0.0, 0.0, 0.0))], (-1.2, 0.0, 0.0))], REAL, poses_known=True) as robot:
        world = robot.init()
        seen = robot.observe(world)
        while not task.finished:
            world, seen = robot.step(world, task.tick(seen))
            if task.segment and task.segment.push:
                rows.append(online.summary(task.segment.push.pusher.adapt))
                contact.append(DT * bool(touches(seen.wrench[0, 0])))
    return {name: np.array([row[name] for row in rows]) for name in online.NAMES}, np.cumsum(contact)


def test_the_estimate_does_not_jump(estimates: Estimates) -> None:
    known, contact = estimates
    ratios = np.exp(np.abs(np.diff(np.log(known["mass"]))))
    # The first touch moves it most: all that was known before is the prior.
    assert ratios.max() <= 1.6
    assert ratios[contact[1:] > 0.4].max() <= 1.35


def test_friction_is_known_after_three_seconds_of_contact(estimates: Estimates) -> None:
    known, contact = estimates
    later, true = contact >= 3.0, true_values(BOX)["friction_x"]
    np.testing.assert_allclose(known["friction_x"][later], true, rtol=0.3)
    np.testing.assert_allclose(known["friction_x"][-1], true, rtol=0.15)
    assert np.mean((known["friction_x_low"][later] <= true) & (true <= known["friction_x_high"][later])) > 0.7


def test_mass_is_known_after_three_seconds_of_contact(estimates: Estimates) -> None:
    known, contact = estimates
    later = known["mass"][contact >= 3.0]
    assert np.all((later > 4.0) & (later < 9.0))
