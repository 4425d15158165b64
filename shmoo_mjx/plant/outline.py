"""The robot's outline from above as discs, and the clearance of each part to obstacles.

The outline includes the arms, which reach beyond the body. With unfolded arms, the hands are 0.46 m ahead. With folded
arms, the elbows are 0.28 m to the side and slightly behind.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, TUCKED_HEIGHT, TUCKED_REACH, hand_targets
from shmoo_mjx.plant.robot import Robot, shmoobot

_SPACING = 0.04
"""Largest spacing of the discs along an arm [m]."""


class Outline(NamedTuple):
    """Centres of the discs in {R} [m]. The radii are those of the robot's parts."""

    torso: Float[np.ndarray, "2 2"]
    """Discs of the torso's two ends. They differ because the torso leans."""
    arms: Float[np.ndarray, "A 2"]
    """Discs of both arms."""
    hands: Float[np.ndarray, "2 2"]
    """Discs of the hands (left, right)."""


class Room(NamedTuple):
    """Clearance of each part's surface to the nearest obstacle [m]; negative inside an obstacle."""

    torso: Scalar | Float[np.ndarray, "..."]
    """Clearance of the torso [m]."""
    arms: Scalar | Float[np.ndarray, "..."]
    """Clearance of both arms [m]."""
    hands: Scalar | Float[np.ndarray, "..."]
    """Clearance of both hands [m]."""

    @property
    def least(self) -> Scalar | Float[np.ndarray, "..."]:
        """Smallest clearance of all parts [m]."""
        return np.minimum(np.minimum(self.torso, self.arms), self.hands)


@lru_cache(maxsize=64)  # callers use few different postures, and the inverse kinematics of the arms is slow
def outline(
    reach: float = REACH,
    hand_height: float | None = None,
    gamma: float = 0.0,
    lean: tuple[float, float] | None = None,
    *,
    robot: Robot | None = None,
) -> Outline:
    """Outline of a standing robot with the given hand posture.

    Args:
        reach: x of the hands' midpoint in {R} [m].
        hand_height: height of the hands above the floor [m], by default interpolated between folded and unfolded arms
            according to ``reach``.
        gamma: steering angle [rad].
        lean: lean of the body towards +x, +y of {R} [rad], by default the slight backward lean of a balanced robot.
        robot: robot, by default Shmoobot.

    Returns:
        The discs in {R}.
    """
    robot = robot or shmoobot()
    folded = (REACH - reach) / (REACH - TUCKED_REACH)
    height = HAND_HEIGHT + folded * (TUCKED_HEIGHT - HAND_HEIGHT) if hand_height is None else hand_height
    flat = np.asarray(hand_targets(np.array(gamma), np.array(reach)))
    hands = np.concatenate([flat, np.full((2, 1), height - robot.ball_radius)], axis=-1)
    if lean is None:
        # The balanced lean depends on the arms' CoM. The CoM for an upright body is accurate enough.
        lean = (-float(robot.com_offset(robot.arm_angles(hands))[0]) / robot.body_com_height, 0.0)
    body = _leant(*lean)
    angles = robot.arm_angles(hands @ body)
    yaw, pitch = angles[:, 0], angles[:, 1]
    out, up = robot.upper_arm * np.cos(pitch), -robot.upper_arm * np.sin(pitch)
    elbows = robot.shoulders + np.stack([out * np.cos(yaw), out * np.sin(yaw), up], axis=-1)
    shoulders, elbows = robot.shoulders @ body.T, elbows @ body.T
    segments = [*zip(shoulders, elbows, strict=True), *zip(elbows, hands, strict=True)]
    torso = np.array([(0.0, 0.0, z) for z in robot.torso]) @ body.T
    return Outline(torso[:, :2], np.concatenate([_along(a[:2], b[:2]) for a, b in segments]), flat)


def _leant(x: float, y: float) -> np.ndarray:
    """Axes ``[3, 3]`` (columns) in {R} of a body that leans by these angles [rad]."""
    (cx, sx), (cy, sy) = (np.cos(x), np.sin(x)), (np.cos(y), np.sin(y))
    return np.array([[cx, 0, sx], [0, 1, 0], [-sx, 0, cx]]) @ np.array([[1, 0, 0], [0, cy, sy], [0, -sy, cy]])


def _along(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    count = int(np.ceil(np.hypot(*(end - start)) / _SPACING)) + 1
    return np.linspace(start, end, count)


def room(
    at: Callable[[Float[np.ndarray, "... 2"]], Float[Array, "..."]],
    pose: Float[Array, "... 3"],
    reach: float | Sequence[float] = REACH,
    gamma: float = 0.0,
    *,
    robot: Robot | None = None,
) -> Room:
    """Clearance of torso, arms and hands to obstacles.

    Args:
        at: function that gives the distance to the nearest obstacle [m] at points in {W}, such as
            ``DistanceField.at``.
        pose: pose of {R} in {W} [m, rad].
        reach: x of the hands' midpoint in {R} [m]. For several values, such as those while the arms unfold, the
            smallest clearance counts.
        gamma: steering angle [rad].
        robot: robot, by default Shmoobot.
    """
    robot = robot or shmoobot()
    pose = np.asarray(pose, dtype=float)
    postures = [outline(r, gamma=gamma, robot=robot) for r in np.atleast_1d(np.asarray(reach, dtype=float))]
    parts = [np.concatenate(discs) for discs in zip(*postures, strict=True)]
    far = [np.asarray(at(se2.transform_point(pose[..., None, :], discs))).min(axis=-1) for discs in parts]
    return Room(far[0] - robot.radius, far[1] - robot.arm_radius, far[2] - robot.hand_radius)
