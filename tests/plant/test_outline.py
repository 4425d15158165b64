"""The robot's discs against where MuJoCo has its parts."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.outline import Outline, outline, room
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.plant.trials import command


@pytest.mark.parametrize(
    ("reach", "height", "gamma"), [(TUCKED_REACH, TUCKED_HEIGHT, 0.0), (REACH, HAND_HEIGHT, 0.0), (REACH, 0.38, 0.4)]
)
def test_discs_lie_where_the_robots_parts_are(reach: float, height: float, gamma: float) -> None:
    scene = build_scene()
    engine = MujocoEngine([scene])
    world, seen = engine.step(engine.init(), command(1, gamma=gamma, reach=reach, hand_height=height), 1.5)
    engine.close()
    data = mujoco.MjData(scene.model)
    data.qpos[:] = world.physics[0, 1 : 1 + scene.model.nq]
    mujoco.mj_kinematics(scene.model, data)
    discs = outline(reach, gamma=gamma)
    for side, hand in zip(("left", "right"), discs.hands, strict=True):
        for body, of_part in (("hand", hand[None]), ("forearm", discs.arms), ("upper_arm", discs.arms)):
            place = se2.inverse_transform_point(seen.robot_pose[0], data.body(f"robot/{side}_{body}").xpos[:2])
            assert np.linalg.norm(of_part - place, axis=-1).min() < 0.015, body
    assert np.abs(discs.torso).max() < 0.05


def test_folded_arms_need_less_room_than_arms_out_and_more_than_the_body() -> None:
    robot = shmoobot()

    def radius(discs: Outline) -> float:
        """Of the circle round the origin of {R} that holds all discs [m]."""
        parts = zip(discs, (robot.radius, robot.arm_radius, robot.hand_radius), strict=True)
        return max(float(np.linalg.norm(centres, axis=-1).max()) + r for centres, r in parts)

    assert robot.radius < radius(outline(TUCKED_REACH)) < 0.30 < radius(outline(REACH)) < 0.52


@settings(deadline=None, max_examples=30)
@given(st.floats(-2, 2), st.floats(-3, 3))
def test_room_before_a_wall_is_that_of_the_foremost_disc(x: float, yaw: float) -> None:
    pose = np.array([x, 0.5, yaw])
    found = room(lambda points: 3.0 - points[..., 0], pose, (TUCKED_REACH, REACH))
    for part, discs_of in (("torso", 0.18), ("arms", 0.025), ("hands", 0.04)):
        discs = np.concatenate([getattr(outline(r), part) for r in (TUCKED_REACH, REACH)])
        ahead = se2.transform_point(pose, discs)[:, 0].max()
        assert getattr(found, part) == pytest.approx(3.0 - ahead - discs_of)
    assert found.least == min(found)


def test_extended_hands_have_less_room_than_the_torso_has_when_facing_a_wall() -> None:
    facing, away = room(lambda points: 1.0 - points[..., 0], np.array([[0.5, 0.0, 0.0], [0.5, 0.0, np.pi]]))[2]
    assert facing == pytest.approx(1.0 - 0.5 - REACH - 0.04)
    assert away == pytest.approx(1.0 - 0.5 + REACH - 0.04)
