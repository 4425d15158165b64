"""A ball-balancing robot with other lengths and masses, from its own MJCF: nothing knows Shmoobot's by heart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shmoo_mjx.base.assets import asset
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.joint_torque import hand_forces
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean
from shmoo_mjx.plant.outline import outline
from shmoo_mjx.plant.robot import Robot, shmoobot
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.plant.trials import command

CHANGES = {
    # A ball of 12 cm, arms 4 cm longer, half the trunk's mass at another height, one drive and shoulder apart.
    'size="0.105" mass="2.5"': 'size="0.12" mass="3.0"',
    'pos="0 0 0.105"': 'pos="0 0 0.12"',
    '<inertial pos="0 0 0.5" mass="32" diaginertia="3.0 3.0 0.5"/>': (
        '<inertial pos="0 0 0.42" mass="16" diaginertia="1.6 1.6 0.3"/>'
    ),
    'fromto="0 0 0 0.33 0 0" mass="0.6"': 'fromto="0 0 0 0.37 0 0" mass="0.9"',
    '_hand" pos="0.33 0 0"': '_hand" pos="0.37 0 0"',
    'pos="0.06 0.17 0.675"': 'pos="0.05 0.16 0.65"',
    'pos="0.06 -0.17 0.675"': 'pos="0.05 -0.16 0.65"',
}


def changed(folder: Path, changes: dict[str, str]) -> Path:
    text = asset("models_xml/shmoobot.xml").read_text(encoding="utf-8")
    for old, new in changes.items():
        assert old in text, old
        text = text.replace(old, new)
    file = folder / "robot.xml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return Robot.from_mjcf(changed(tmp_path_factory.mktemp("robot"), CHANGES))


def test_its_numbers_are_read_from_its_file(other: Robot) -> None:
    assert (other.ball_radius, other.body_mass, other.body_com_height) == (0.12, 16.0, 0.42)
    assert (other.forearm, other.forearm_mass, other.shoulder) == (0.37, 0.9, (0.05, 0.16, 0.65))
    assert other.flatness != shmoobot().flatness


def test_it_balances_drives_and_holds_its_hands_and_feels_nothing(other: Robot) -> None:
    engine = MujocoEngine([build_scene(robot=other)])
    world, seen = engine.step(engine.init(), command(1, reach=REACH, hand_height=HAND_HEIGHT), 2.0)
    assert np.abs(seen.lean[0]).max() < 0.1
    np.testing.assert_allclose(seen.hands[0].mean(axis=0), [REACH, 0.0, HAND_HEIGHT], atol=0.01)
    # By Shmoobot's masses its hands would seem to carry 2 N.
    wanted = command(1, reach=REACH, hand_height=HAND_HEIGHT)
    state, torque = engine.robot(world), engine.torque(world, wanted)[:, 3:]
    assert np.abs(hand_forces(other, state, torque)).max() < 0.5
    assert np.abs(hand_forces(shmoobot(), state, torque)).max() > 2.0
    for _ in range(50):
        moving = seen.robot_twist[:, :2]
        lean = velocity_to_lean(Gains(), moving, seen.lean_rate, np.array([[0.3, 0.0]]), robot=other)
        world, seen = engine.step(world, command(1, lean[0], reach=REACH, hand_height=HAND_HEIGHT))
    engine.close()
    assert seen.robot_twist[0, 0] == pytest.approx(0.3, abs=0.06)
    assert not engine.fallen(world).any()


def test_its_outline_is_its_own(other: Robot) -> None:
    assert not np.allclose(outline(robot=other).arms[0], outline().arms[0])


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({'name="torso_hull"': 'name="hull"'}, "torso_hull"),
        ({'pos="0.06 -0.17 0.675"': 'pos="0.06 -0.2 0.675"'}, "mirror"),
        ({'axis="0 1 0" range="-2.8 -0.05"': 'axis="0 1 0" range="-2.8 -0.05" shape="round"'}, "MJCF"),
        ({'<motor name="left_elbow"': '<motor name="elbow"'}, "motors"),
    ],
)
def test_a_file_that_is_no_such_robot_is_refused(tmp_path: Path, changes: dict[str, str], word: str) -> None:
    file = changed(tmp_path, changes)
    with pytest.raises(ShmooError, match=word) as error:
        Robot.from_mjcf(file)
    assert str(file) in str(error.value)
