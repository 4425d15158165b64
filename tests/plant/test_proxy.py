"""The proxy robot: each imperfection can be switched, and each does what it says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from shmoo_mjx.hands import HAND_HEIGHT, REACH
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.proxy import Imperfections, ProxyEngine, body_of, draw_body
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.plant.trials import command
from shmoo_mjx.types import Observation

NONE = Imperfections.none()
BOX = draw_condition("box", 1, {"mass": 9.0, "payload": 0.0, "friction": 0.35})
PLACE = (REACH + 0.04 + 0.05 + BOX.half_extents[0], 0.05, 0.2)


def _push(imperfections: Imperfections, seed: int = 0, samples: int = 20) -> tuple[Observation, Observation, bool]:
    """What the proxy reports and what is true, ``[T, ...]``, while it pushes a box."""
    scene = build_scene([(BOX, PLACE)], adjust=body_of(draw_body(imperfections, seed)))
    engine = ProxyEngine([scene], imperfections, seed)
    world = engine.init()
    reports, truths = [], []
    for i in range(samples):
        lean = 0.1 if i >= 6 else 0.0
        world, seen = engine.step(world, command(1, (lean, 0.0), 0.1, reach=REACH, hand_height=HAND_HEIGHT))
        reports.append(seen)
        truths.append(engine.true_observation(world))
    engine.close()
    stack = [Observation(*(np.stack(f)[:, 0] for f in zip(*rows, strict=True))) for rows in (reports, truths)]
    return stack[0], stack[1], bool(engine.fallen(world)[0])


def test_without_imperfections_it_is_the_training_plant() -> None:
    seen, _, _ = _push(NONE, samples=12)
    engine = MujocoEngine([build_scene([(BOX, PLACE)])])
    world = engine.init()
    for i in range(12):
        lean = 0.1 if i >= 6 else 0.0
        world, plain = engine.step(world, command(1, (lean, 0.0), 0.1, reach=REACH, hand_height=HAND_HEIGHT))
    engine.close()
    for name in Observation._fields:
        np.testing.assert_allclose(getattr(seen, name)[-1], getattr(plain, name)[0], atol=1e-5, err_msg=name)


def test_with_all_imperfections_it_still_pushes() -> None:
    for seed in range(2):
        _, truth, fallen = _push(Imperfections(), seed, samples=25)
        assert not fallen
        assert truth.object_pose[-1, 0, 0] > PLACE[0] + 0.1


def test_same_seed_same_run() -> None:
    first, _, _ = _push(Imperfections(), 3, 6)
    again, _, _ = _push(Imperfections(), 3, 6)
    other, _, _ = _push(Imperfections(), 4, 6)
    np.testing.assert_array_equal(first.object_pose, again.object_pose)
    assert np.abs(first.object_pose - other.object_pose).max() > 1e-4


def test_camera_noise_and_drop_outs() -> None:
    camera = dataclasses.replace(
        NONE, frame_rate=30.0, position_noise=0.005, yaw_noise=float(np.deg2rad(0.5)), drop_out=0.0, burst=0.0
    )
    seen, truth, _ = _push(camera, samples=20)
    error = (seen.object_pose - truth.object_pose)[:6, 0]  # at rest
    assert 0.0005 < error[:, :2].std() < 0.008
    blind, still_true, _ = _push(dataclasses.replace(camera, drop_out=1.0), samples=20)
    np.testing.assert_allclose(blind.object_pose[:, 0, :2], np.broadcast_to(PLACE[:2], (20, 2)), atol=1e-6)
    assert still_true.object_pose[-1, 0, 0] > PLACE[0] + 0.02


def test_velocity_comes_from_filtered_poses() -> None:
    camera = dataclasses.replace(NONE, frame_rate=30.0, filter_velocity=True)
    seen, truth, _ = _push(camera, samples=25)
    moving = slice(12, 25)
    assert np.abs(truth.object_twist[moving, 0, 0]).max() > 0.15
    error = seen.object_twist[moving, 0, 0] - truth.object_twist[moving, 0, 0]
    assert 1e-4 < np.sqrt(np.mean(error**2)) < 0.1
    robot_error = seen.robot_twist[moving, 0] - truth.robot_twist[moving, 0]
    assert 1e-4 < np.sqrt(np.mean(robot_error**2)) < 0.05


def test_force_from_joint_torque_is_near_the_contact_force() -> None:
    felt, _, _ = _push(dataclasses.replace(NONE, force_from_torque=True), samples=25)
    touched, _, _ = _push(NONE, samples=25)
    pushing = slice(15, 25)
    force = touched.wrench[pushing, 0, :2]
    error = np.hypot(*(felt.wrench[pushing, 0, :2] - force).T)
    assert np.hypot(*force.T).mean() > 10
    assert 1e-3 < error.mean() < 0.15 * np.hypot(*force.T).mean()


def test_commands_arrive_late() -> None:
    late = dataclasses.replace(NONE, delay=(0.04, 0.04))
    assert draw_body(late, 0).delay == pytest.approx(0.04)
    quick, _, _ = _push(NONE, samples=8)
    slow, _, _ = _push(late, samples=8)
    assert slow.lean[6, 0] < quick.lean[6, 0] - 1e-4


def test_motor_lag_is_a_first_order_filter() -> None:
    imperfections = dataclasses.replace(NONE, motor_lag=0.05)
    scene = build_scene(adjust=body_of(draw_body(imperfections, 0)))
    assert scene.model.na == 9
    np.testing.assert_allclose(scene.model.actuator_dynprm[:, 0], 0.05)
    assert build_scene(adjust=body_of(draw_body(NONE, 0))).model.na == 0


def test_drawn_bodies_differ_within_their_ranges() -> None:
    bodies = [draw_body(Imperfections(), seed) for seed in range(50)]
    masses = np.array([b.mass for b in bodies])
    assert masses.min() > 0.85 and masses.max() < 1.15 and masses.std() > 0.05
    assert {round(b.delay, 3) for b in bodies} == {0.02, 0.03, 0.04}
    model = build_scene(adjust=body_of(bodies[0])).model
    assert model.body("robot/torso").mass[0] == pytest.approx(32.0 * bodies[0].mass)
    assert model.body("robot/torso").ipos[2] == pytest.approx(0.5 + bodies[0].com[2])
    assert model.joint("robot/ball").damping[0] == pytest.approx(0.6 * bodies[0].drive_friction)
