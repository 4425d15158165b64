"""The robot's kinematics as the control knows them, against MuJoCo's own."""

from __future__ import annotations

from dataclasses import asdict

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.base.assets import asset
from shmoo_mjx.geometry.hands import HAND_RADIUS
from shmoo_mjx.plant.robot import readout, shmoobot

MODEL = mujoco.MjModel.from_xml_path(str(asset("models_xml/shmoobot.xml")))
ROBOT = shmoobot()
HANDS = ("left_hand", "right_hand")


def _random_state(seed: int) -> mujoco.MjData:
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(MODEL)
    data.qpos[:2] = rng.uniform(-3, 3, 2)
    yaw, lean = rng.uniform(-np.pi, np.pi), rng.uniform(-0.3, 0.3, 2)
    turn, tilt = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.array([0.0, 0.0, 1.0]), yaw)
    mujoco.mju_axisAngle2Quat(tilt, np.array([-lean[1], lean[0], 0.0]) / np.hypot(*lean), np.hypot(*lean))
    mujoco.mju_mulQuat(data.qpos[3:7], turn, tilt)
    ball = rng.normal(size=4)
    data.qpos[7:11] = ball / np.linalg.norm(ball)
    data.qpos[11:17] = rng.uniform(MODEL.jnt_range[2:8, 0], MODEL.jnt_range[2:8, 1])
    data.qvel[:] = rng.normal(size=MODEL.nv)
    mujoco.mj_forward(MODEL, data)
    return data


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31))
def test_hand_positions_and_jacobian(seed: int) -> None:
    data = _random_state(seed)
    arms = data.qpos[11:17].reshape(2, 3)
    body = data.body("torso").xmat.reshape(3, 3)
    for arm, name in enumerate(HANDS):
        in_body = body.T @ (data.site(name).xpos - data.body("torso").xpos)
        np.testing.assert_allclose(ROBOT.hand_in_body(arms)[arm], in_body, atol=1e-9)
        jacobian = np.zeros((3, MODEL.nv))
        mujoco.mj_jacSite(MODEL, data, jacobian, None, MODEL.site(name).id)
        columns = slice(9 + 3 * arm, 12 + 3 * arm)
        np.testing.assert_allclose(ROBOT.arm_jacobian(arms)[arm], body.T @ jacobian[:, columns], atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31))
def test_arm_angles_invert_the_hand_positions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Ahead of the shoulder: folded back, the same place has another yaw.
    arms = np.stack([rng.uniform(-1.2, 1.2, 2), rng.uniform(-0.6, 1.5, 2), rng.uniform(-1.5, -0.1, 2)], axis=-1)
    hands = ROBOT.hand_in_body(arms)
    np.testing.assert_allclose(ROBOT.hand_in_body(ROBOT.arm_angles(hands)), hands, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31))
def test_readout_against_mujoco(seed: int) -> None:
    data = _random_state(seed)
    seen = readout(data.qpos, data.qvel)
    torso, ball = data.body("torso"), data.body("ball")
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(MODEL, data, mujoco.mjtObj.mjOBJ_XBODY, torso.id, velocity, 0)
    axes = torso.xmat.reshape(3, 3)
    c, s = np.cos(seen.pose[2]), np.sin(seen.pose[2])
    level = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(seen.rotation, level @ axes, atol=1e-9)
    np.testing.assert_allclose(seen.pose[:2], torso.xpos[:2], atol=1e-12)
    np.testing.assert_allclose(seen.twist, [velocity[3], velocity[4], velocity[2]], atol=1e-9)
    up = level @ axes[:, 2]
    np.testing.assert_allclose(np.tan(seen.lean), up[:2] / up[2], atol=1e-9)
    np.testing.assert_allclose(seen.lean_rate, [(level @ velocity[:3])[1], -(level @ velocity[:3])[0]], atol=1e-9)
    spin = np.zeros(6)
    mujoco.mj_objectVelocity(MODEL, data, mujoco.mjtObj.mjOBJ_XBODY, ball.id, spin, 0)
    np.testing.assert_allclose(seen.drive_rate, axes.T @ (spin[:3] - velocity[:3]), atol=1e-9)


def test_com_feed_forward_is_the_true_com() -> None:
    data = _random_state(3)
    data.qpos[3:7] = [1, 0, 0, 0]
    mujoco.mj_forward(MODEL, data)
    bodies = [b for b in range(1, MODEL.nbody) if MODEL.body(b).name != "ball"]
    mass = MODEL.body_mass[bodies]
    com = mass @ data.xipos[bodies] / mass.sum() - data.body("torso").xpos
    np.testing.assert_allclose(ROBOT.com_offset(data.qpos[11:17].reshape(2, 3)), com[:2], atol=1e-9)


def test_the_numbers_are_those_of_the_file() -> None:
    """By value: one that is read from the wrong place shows here."""
    numbers = {
        "ball_radius": 0.105, "ball_mass": 2.5, "body_mass": 32.0, "body_com_height": 0.5,
        "body_inertia": (3.0, 3.0, 0.5), "torso": (0.34, 0.82), "radius": 0.18, "shoulder": (0.06, 0.17, 0.675),
        "upper_arm": 0.30, "forearm": 0.33, "arm_radius": 0.025, "hand_radius": HAND_RADIUS, "upper_arm_mass": 1.0,
        "forearm_mass": 0.6, "hand_mass": 0.2, "drive_limit": 50.0, "drive_coulomb": 1.5, "drive_viscous": 0.6,
    }  # fmt: skip
    assert {k: v for k, v in asdict(ROBOT).items() if k != "mjcf"} == numbers
    assert MODEL.body_mass[1:].sum() == pytest.approx(ROBOT.upper_mass + ROBOT.ball_mass)


def test_flatness_coefficients_against_mujoco() -> None:
    """a x'' + b phi'' = c phi holds whatever the drive does: shown by the change that 5 N m makes."""
    spec = mujoco.MjSpec.from_file(str(asset("models_xml/scene.xml")))
    spec.attach(
        mujoco.MjSpec.from_file(str(asset("models_xml/shmoobot.xml"))), prefix="r/", frame=spec.worldbody.add_frame()
    )
    model = spec.compile()
    model.dof_frictionloss[:], model.dof_damping[:] = 0.0, 0.0
    model.dof_armature[9:15] = 1e3  # arms as one piece with the body
    data = mujoco.MjData(model)
    data.qpos[11:17] = np.tile([0.0, 1.6, -2.4], 2)
    for _ in range(100):
        mujoco.mj_step(model, data)
        data.qvel[3:] = 0.0
    accelerations = []
    for torque in (0.0, 5.0):
        data.ctrl[1] = torque
        mujoco.mj_forward(model, data)
        accelerations.append((data.qacc[0], data.qacc[4]))
    base, lean = np.subtract(accelerations[1], accelerations[0])
    a, b, _ = ROBOT.flatness
    assert base / lean == pytest.approx(-b / a, rel=0.05)
