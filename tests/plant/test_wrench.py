"""Gamma: the hands' wrench on the object equals what the object's momentum says, and changes frames as it should."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH
from shmoo_mjx.plant import lowlevel
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.joint_torque import joint_torque_wrench
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.observe import planar_wrench
from shmoo_mjx.plant.robot import readout, shmoobot
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.plant.trials import command
from shmoo_mjx.types import Observation


def _push(scene: Scene, seconds: float, lean: float, *, gamma: float = 0.0, yaw: float = 0.0) -> Observation:
    """Lean against the object in front of the robot; observations ``[T, ...]`` of one world."""
    engine = MujocoEngine([scene])
    world = engine.init()
    rows = [engine.observe(world)]
    for _ in range(round(seconds / 0.1)):
        world, seen = engine.step(
            world, command(1, (lean, 0.0), gamma=gamma, yaw=yaw, reach=REACH, hand_height=HAND_HEIGHT)
        )
        rows.append(seen)
    engine.close()
    return Observation(*(np.stack(fields)[:, 0] for fields in zip(*rows, strict=True)))


def _ahead(condition: Condition, yaw: float = 0.0, gap: float = 0.08, side: float = 0.0) -> Scene:
    """The object in front of a robot at the origin that heads towards ``yaw``."""
    robot = np.array([0.0, 0.0, yaw])
    place = se2.compose(robot, np.array([REACH + 0.04 + gap + condition.half_extents[0], side, 0.0]))
    return build_scene([(condition, place)], robot)


@pytest.mark.parametrize("yaw", [0.0, 1.0])
def test_impulse_equals_momentum_change_without_friction(yaw: float) -> None:
    """A box on ice: what the hands give is what the box has, forces and moment alike."""
    condition = draw_condition("box", 3, {"mass": 20.0, "payload": 0.0, "friction": 0.05, "size": (0.6, 0.6, 0.6)})
    scene = _ahead(condition, yaw, side=0.1)
    scene.model.geom("object0/sole").friction[:] = 1e-9
    seen = _push(scene, 2.0, 0.06, yaw=yaw)
    assert np.hypot(*seen.wrench[:, 0, :2].T).max() > 10
    inertia = scene.model.body("object0/object").inertia[2]
    given = 0.1 * seen.wrench[1:, 0].sum(axis=0)
    has = np.array([20.0, 20.0, inertia]) * seen.object_twist[-1, 0]
    np.testing.assert_allclose(given[:2], has[:2], atol=0.02 * np.hypot(*has[:2]))
    assert given[2] == pytest.approx(has[2], abs=0.02 * np.hypot(*has[:2]) * 0.3)


def test_impulse_equals_momentum_change_plus_sliding_friction() -> None:
    """On a rough floor the hands also pay for friction, which is mu m g while the box slides."""
    condition = draw_condition("box", 3, {"mass": 12.0, "payload": 0.0, "friction": 0.3, "size": (0.6, 0.6, 0.6)})
    seen = _push(_ahead(condition), 3.0, 0.08)
    speed = seen.object_twist[:, 0, 0]
    sliding = np.flatnonzero(speed > 0.1)
    first, last = sliding[0], sliding[-1]
    assert last - first >= 5
    given = 0.1 * seen.wrench[first + 1 : last + 1, 0, 0].sum()
    has = 12.0 * (speed[last] - speed[first]) + 0.3 * 12.0 * 9.81 * 0.1 * (last - first)
    assert given == pytest.approx(has, rel=0.02)


def test_third_law() -> None:
    """The force that the sensor reports on the object is the opposite of the one on the hand."""
    scene = _ahead(draw_condition("box", 3, {"mass": 12.0, "friction": 0.4}), gap=0.01)
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[:] = scene.qpos0
    state, gains = lowlevel.init(np, (1,), 0.3, 0.5), lowlevel.Gains()
    wanted = command(1, (0.05, 0.0), reach=REACH, hand_height=HAND_HEIGHT)
    for _ in range(600):
        state, torque = lowlevel.control(
            shmoobot(), gains, state, readout(data.qpos[None], data.qvel[None]), command=wanted, dt=0.002
        )
        data.ctrl[:] = torque[0]
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    on_object, on_hands = np.zeros(3), np.zeros(3)
    hands = {model.geom(f"robot/{side}_hand").id for side in ("left", "right")}
    hull = model.geom("object0/hull").id
    for i, contact in enumerate(data.contact):
        if hands & set(contact.geom.tolist()) and hull in contact.geom:
            wrench = np.zeros(6)
            mujoco.mj_contactForce(model, data, i, wrench)
            force = contact.frame.reshape(3, 3).T @ wrench[:3]
            sign = 1.0 if contact.geom[1] == hull else -1.0
            on_object += sign * force
            on_hands -= sign * force
    assert on_object[0] > 5
    np.testing.assert_allclose(planar_wrench(scene, data.qpos, data.sensordata)[0, :2], on_object[:2], atol=1e-9)
    # What the hands feel drives the arms: J^T f appears among the constraint forces of the arm joints.
    jacobian = np.zeros((3, model.nv))
    generalised = np.zeros(model.nv)
    for i, contact in enumerate(data.contact):
        if hands & set(contact.geom.tolist()) and hull in contact.geom:
            wrench = np.zeros(6)
            mujoco.mj_contactForce(model, data, i, wrench)
            force = contact.frame.reshape(3, 3).T @ wrench[:3]
            hand = next(g for g in contact.geom if g in hands)
            mujoco.mj_jac(model, data, jacobian, None, contact.pos, model.geom_bodyid[hand])
            generalised += jacobian.T @ (force if contact.geom[1] == hand else -force)
    np.testing.assert_allclose(data.qfrc_constraint[9:15], generalised[9:15], atol=1e-6)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-5, 5), min_size=9, max_size=9))
def test_wrench_round_trips_between_frames(numbers: list[float]) -> None:
    robot, thing, wrench = np.array(numbers).reshape(3, 3)
    in_robot = se2.rotate(wrench, -robot[2])
    in_object = se2.rotate(wrench, -thing[2])
    back = se2.rotate(se2.rotate(in_robot, robot[2]), -thing[2])
    np.testing.assert_allclose(back, in_object, atol=1e-9)
    # Power does not depend on the frame.
    twist = np.array([0.3, -0.2, 0.5])
    assert wrench @ twist == pytest.approx(in_object @ se2.rotate(twist, -thing[2]), abs=1e-9)


@pytest.mark.parametrize("yaw", [0.0, -2.0])
def test_joint_torque_estimate_agrees_quasi_statically(yaw: float) -> None:
    """Gamma = J tau against a box too heavy to move, off centre: force and moment within 3 % of the contacts' own."""
    condition = draw_condition("box", 1, {"mass": 60.0, "payload": 0.0, "friction": 0.6, "size": (0.6, 0.6, 0.6)})
    engine = MujocoEngine([_ahead(condition, yaw, side=0.1)])
    world = engine.init()
    wanted = command(1, (0.05, 0.0), yaw=yaw, reach=REACH, hand_height=HAND_HEIGHT)
    for _ in range(40):
        world, seen = engine.step(world, wanted)
    estimate = joint_torque_wrench(
        shmoobot(), engine.robot(world), engine.torque(world, wanted)[:, 3:], seen.object_pose[:, 0]
    )
    engine.close()
    force = np.hypot(*seen.wrench[0, 0, :2])
    assert force > 15
    np.testing.assert_allclose(estimate[0], seen.wrench[0, 0], atol=0.03 * force)
