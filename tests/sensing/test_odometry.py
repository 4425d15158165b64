"""Odometry drifts by about 1 % of the way, and the localiser keeps it near without jumps."""

from __future__ import annotations

import dataclasses

import numpy as np

from shmoo_mjx.geometry import se2
from shmoo_mjx.sensing import odometry
from shmoo_mjx.sensing.odometry import TICK, OdometryConfig, OdometryDraw

ROBOTS = 200


def drawn(config: OdometryConfig, count: int = ROBOTS) -> OdometryDraw:
    each = [odometry.draw(config, np.random.default_rng(i)) for i in range(count)]
    return OdometryDraw(*(np.stack(column) for column in zip(*each, strict=True)))


def walk(config: OdometryConfig, seconds: float = 40.0, speed: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Errors ``[T, W, 3]`` of the pose in {W}, and the poses: straight on, with two corners."""
    robots, start = drawn(config), np.tile([1.0, 2.0, 0.4], (ROBOTS, 1))
    state = odometry.init(start, 16)
    pose, errors, poses = start, [], []
    rng = np.random.default_rng(9)
    for now in range(1, round(seconds / TICK) + 1):
        turn = 0.6 * TICK if now % 1500 < 260 else 0.0
        pose = se2.compose(pose, np.array([speed * TICK, 0.0, turn]) * np.ones((ROBOTS, 1)))
        state = odometry.step(config, robots, state, pose, noise=rng.normal(size=(ROBOTS, 6)), now=now)
        believed = se2.compose(state.frame, odometry.estimate(robots, state))
        error = believed - pose
        errors.append(np.concatenate([error[:, :2], se2.wrap(error[:, 2:])], axis=-1))
        poses.append(believed)
    return np.array(errors), np.array(poses)


def test_drift_is_about_one_per_cent_of_the_way() -> None:
    errors, _ = walk(OdometryConfig(localised=False), seconds=20.0)
    share = np.linalg.norm(errors[-1, :, :2], axis=-1) / (20.0 * 0.5)
    assert 0.005 < np.mean(share) < 0.015
    assert np.rad2deg(np.abs(errors[-1, :, 2])).mean() < 2.0


def test_corrected_it_stays_near_and_does_not_jump() -> None:
    errors, poses = walk(OdometryConfig())
    far = np.linalg.norm(errors[1000:, :, :2], axis=-1)
    assert far.mean() < 0.03 and far.max() < 0.12
    assert np.rad2deg(np.abs(errors[1000:, :, 2])).mean() < 0.5
    # Beside its own motion of 5 mm a tick, the pose moves by no more than the blending allows and the walk adds.
    steps = np.linalg.norm(np.diff(poses[1000:, :, :2], axis=0), axis=-1)
    assert steps.max() < 0.0105
    sample = np.linalg.norm((errors[1010::10] - errors[1000:-10:10])[..., :2], axis=-1)
    assert np.quantile(sample, 0.99) < 0.015


def test_a_pose_that_arrives_late_is_carried_on() -> None:
    config = dataclasses.replace(
        OdometryConfig(localised=False), scale=0.0, yaw_scale=0.0, yaw_bias=0.0, walk=0.0, yaw_walk=0.0
    )
    robots = drawn(config)
    assert set(robots.delay.tolist()) == {2, 3, 4}
    state, pose = odometry.init(np.zeros((ROBOTS, 3)), 16), np.zeros((ROBOTS, 3))
    quiet = np.zeros((ROBOTS, 6))
    for now in range(1, 6):  # a step of 0.1 m at tick 1
        pose = np.tile([0.1, 0.0, 0.0], (ROBOTS, 1))
        state = odometry.step(config, robots, state, pose, noise=quiet, now=now)
        arrived = odometry.ago(state.pose, robots.delay)[:, 0] > 0.05
        np.testing.assert_array_equal(arrived, now > robots.delay)
    for now in range(6, 60):
        pose = pose + np.array([0.005, 0.0, 0.0])
        state = odometry.step(config, robots, state, pose, noise=quiet, now=now)
    assert np.abs(odometry.estimate(robots, state) - pose).max() < 1e-3
    assert np.abs(state.twist[:, 0] - 0.5).max() < 0.01


def test_standing_still_it_hardly_drifts() -> None:
    errors, _ = walk(OdometryConfig(localised=False), seconds=10.0, speed=0.0)
    assert np.linalg.norm(errors[-1, :, :2], axis=-1).max() < 1e-3
