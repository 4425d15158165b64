"""Driving by keyboard: what keys mean, and that a drive is a data set like any other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shmoo_mjx.data import store
from shmoo_mjx.data.collect import CollectConfig, record
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.run import teleop
from shmoo_mjx.run.view import scene_named

UP, DOWN, LEFT, RIGHT, PAGE_UP, STEER_RIGHT, STOP, ENTER = 265, 264, 263, 262, 266, 46, 259, 257


def test_keys_change_wishes_step_by_step_and_within_limits() -> None:
    driver = teleop.Driver()
    for _ in range(3):
        driver = teleop.press(driver, UP)
    assert driver.forward == pytest.approx(0.15)
    for _ in range(40):
        driver = teleop.press(driver, UP)
    assert driver.forward == pytest.approx(0.5)
    assert teleop.press(driver, DOWN).forward == pytest.approx(0.45)
    assert teleop.press(driver, LEFT).yaw > 0 > teleop.press(driver, RIGHT).yaw
    assert teleop.press(driver, STEER_RIGHT).gamma > 0 and teleop.press(driver, PAGE_UP).left > 0
    assert teleop.press(driver, ord("Q")) == driver
    stopped = teleop.press(teleop.press(driver, LEFT), STOP)
    assert (stopped.forward, stopped.left, stopped.gamma) == (0.0, 0.0, 0.0) and stopped.yaw > 0
    assert teleop.press(driver, ENTER).arms_out and not teleop.press(driver, ENTER, arms_fixed=True).arms_out
    assert set(teleop.KEYS) >= {UP, DOWN, LEFT, RIGHT, PAGE_UP, STEER_RIGHT, STOP, ENTER}


def test_a_drive_pushes_the_box_and_reads_back_like_a_collected_one(tmp_path: Path) -> None:
    scene = scene_named("box", 6)
    engine, shown = MujocoEngine([scene]), []
    session = teleop.begin(engine, record=True)
    for i in range(30):
        session = teleop.tick(engine, session, [UP] * 6 if i == 0 else [], record=True, show=shown.append)
    engine.close()
    assert len(shown) == 150
    condition = scene.conditions[0]
    names = [teleop.save(tmp_path / "mine", condition, session.rows) for _ in range(2)]
    assert names == ["drive-box-6-0", "drive-box-6-1"]
    read = store.read(tmp_path / "mine")
    arrays = read.arrays[0]
    collected = next(iter(record(CollectConfig(episodes=1, seconds=1.0), [condition], 0)))
    assert set(arrays) == set(collected)
    assert all(arrays[k].ndim == v.ndim and arrays[k].shape[2:] == v.shape[2:] for k, v in collected.items())
    assert arrays["contact"].any() and arrays["object_pose"][0, -1, 0] > arrays["object_pose"][0, 0, 0] + 0.05
    # The robot came from behind: the rear face, whose inward normal is +x.
    np.testing.assert_allclose(arrays["face"][0, :3], [-condition.half_extents[0], 0.0, 0.0], atol=1e-6)
    # The recorded force is the mean over the sample: over the drive it is the box's momentum and what friction took.
    dv = arrays["object_twist"][0, -1, 0] - arrays["object_twist"][0, 0, 0]
    assert 0.1 * arrays["wrench_object"][0, :-1, 0].sum() > condition.total_mass * dv


def test_the_robot_drives_where_the_keys_say() -> None:
    engine = MujocoEngine([scene_named("robot", 0)])
    session = teleop.begin(engine)
    for i in range(30):
        session = teleop.tick(engine, session, [UP] * 6 + [LEFT] * 4 if i == 0 else [])
    assert not engine.fallen(session.world)[0]
    engine.close()
    x, y, yaw = session.obs.robot_pose[0]
    assert yaw == pytest.approx(np.deg2rad(30), abs=0.1) and x > 0.2 and y > 0.03
    assert session.rows == ()


@pytest.mark.parametrize("what", ["sofa", "missing.json", "missing.yaml"])
def test_unknown_scenes_are_named(what: str) -> None:
    with pytest.raises(ShmooError, match=what.split(".")[0]):
        scene_named(what, 0)


def test_every_kind_of_scene_is_found() -> None:
    assert scene_named("robot", 0).conditions == ()
    assert scene_named("cart", 4).conditions == (draw_condition("cart", 4),)
    demo = scene_named("demo", 0)
    assert demo.conditions and demo.wall_geoms
