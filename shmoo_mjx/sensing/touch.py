"""Force estimate Gamma = J tau, assigned to the object that the hands can be touching.

Motor constants are known to some 15 % only, and extended arms weigh: what their motors seem to hold beyond gravity is
a force of some newtons that nothing exerts. With the hands extended and free, gravity is all there is to hold, which
calibrates them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import REACH
from shmoo_mjx.plant.joint_torque import joint_torque_wrench
from shmoo_mjx.plant.lowlevel import arm_gravity
from shmoo_mjx.plant.robot import Robot, RobotState


@dataclass(frozen=True)
class TouchConfig:
    """The estimate of contact forces from the arms' motor currents."""

    least: float = 2.0
    """Force below which a reading counts as no contact [N]: the arms' swing and the errors of motor constants
    leave as much. More: light touches are missed."""


_PRIOR = 20.0
"""What counts for the nominal motor constants, in squares of the torque of gravity [(N m)^2]: 0.1 s with extended
arms."""
_FREE = 0.10
"""Distance of the hands' midpoint from every object's outline from which they touch nothing [m]: several times the
error of a pose."""
_LIMIT = 1.4
"""Largest factor between torques asked for and exerted, and the inverse of the least [1]: what is beyond twice the
tolerance of motor constants is a motor that fails, or an arm that leans on something."""


class ArmScale(NamedTuple):
    """Sums over the readings with the hands extended and free, for the arms' motors of W robots."""

    products: Float[Array, "W 6"]
    """Of torque asked for and torque of gravity [(N m)^2]."""
    squares: Float[Array, "W 6"]
    """Of the torque of gravity [(N m)^2]."""


class ArmReading(NamedTuple):
    """What W robots sense of their arms."""

    sensed: RobotState
    """Joint angles and lean, and as pose the one that the robot believes in."""
    torque: Float[Array, "W 6"]
    """Of the arms' motors [N m]."""
    reach: Float[Array, "W"]
    """Of the hands [m]."""

    @property
    def hands(self) -> Float[Array, "W 2"]:
        """The hands' midpoint in {W} [m]."""
        xp = se2.array_module(self.reach, self.sensed.pose)
        return se2.transform_point(self.sensed.pose, se2.stack(self.reach, xp.zeros_like(self.reach)))


def init(worlds: int) -> ArmScale:
    """Before the first reading."""
    return ArmScale(np.zeros((worlds, 6)), np.zeros((worlds, 6)))


def calibrate(
    scale: ArmScale,
    robot: Robot,
    reading: ArmReading,
    object_pose: Float[Array, "W N 3"],
    *,
    half_extents: Float[Array, "W N 2"],
) -> ArmScale:
    """The sums after one more reading; arguments as for :func:`wrench`, ``half_extents`` of the objects [m]."""
    xp = se2.array_module(reading.reach, reading.torque, object_pose)
    sensed, torque, extended = reading.sensed, reading.torque, reading.reach > REACH - 0.01
    inside = xp.abs(se2.rotate(reading.hands[:, None] - object_pose[..., :2], -object_pose[..., 2]))
    away = xp.linalg.norm(xp.maximum(inside - half_extents, 0.0), axis=-1)
    # An object that has never been seen is not within reach; nor is what a comparison with NaN says nothing of.
    free = extended & ~(away < _FREE).any(axis=-1)
    gravity = xp.where(free[:, None], arm_gravity(robot, sensed.arms, sensed.lean[..., :1]).reshape(torque.shape), 0.0)
    return ArmScale(scale.products + torque * gravity, scale.squares + gravity**2)


def wrench(
    touch: TouchConfig, scale: ArmScale, robot: Robot, reading: ArmReading, *, object_pose: Float[Array, "W N 3"]
) -> Float[Array, "W N 3"]:
    """Gamma on each object about its centre, in {W}; all of it goes to the one nearest to the hands.

    Args:
        touch: see there.
        scale: what is known of the motors.
        robot: its numbers.
        reading: of the arms.
        object_pose: believed, in {W}; NaN where unknown.
    """
    if not object_pose.size:
        return object_pose
    xp = se2.array_module(reading.reach, reading.torque, object_pose)
    far = xp.linalg.norm(object_pose[..., :2] - reading.hands[:, None], axis=-1)
    nearest = xp.argmin(xp.where(xp.isfinite(far), far, xp.inf), axis=1)
    torque_ratio = xp.clip((_PRIOR + scale.products) / (_PRIOR + scale.squares), 1 / _LIMIT, _LIMIT)
    where = xp.take_along_axis(object_pose, nearest[:, None, None], axis=1)[:, 0]
    estimate = joint_torque_wrench(robot, reading.sensed, reading.torque / torque_ratio, where)
    # A comparison with NaN is false: what is not known anywhere is not touched either.
    firm = (xp.hypot(estimate[:, 0], estimate[:, 1]) > touch.least) & xp.isfinite(estimate).all(axis=-1)
    there = firm[:, None] & (nearest[:, None] == np.arange(object_pose.shape[1]))
    return xp.where(there[..., None], estimate[:, None], 0.0)
