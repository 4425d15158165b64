"""Force estimate Gamma = J tau, assigned to the object that the hands can touch.

Motor constants are known to about 15 % only. With extended arms, this error of the torques that carry the arms' weight
looks like a contact force of a few newtons. The motor constants are therefore calibrated while the hands are extended
and free, when the motors carry gravity only.
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
    """Settings of the contact force estimate from the arms' motor currents."""

    least: float = 2.0
    """Planar force at or below which a reading counts as no contact [N]. Arm motion and calibration errors cause
    readings of this size. Larger values miss light contacts."""


_PRIOR = 20.0
"""Weight of the nominal motor constants, as a sum of squared gravity torques [(N m)^2]. It equals 0.1 s with extended
arms."""
_FREE = 0.10
"""Distance of the hands' midpoint from all objects' outlines at which the hands count as free [m]. It is several times
the pose error."""
_LIMIT = 1.4
"""Largest ratio between commanded and exerted torque; the smallest ratio is its inverse. A ratio beyond twice the
tolerance of motor constants means a failing motor, or an arm that leans on something."""


class ArmScale(NamedTuple):
    """Sums for a least-squares calibration of the arm motors of W robots, over readings with extended, free hands."""

    products: Float[Array, "W 6"]
    """Sum of the products of motor torque and gravity torque [(N m)^2]."""
    squares: Float[Array, "W 6"]
    """Sum of the squared gravity torques [(N m)^2]."""


class ArmReading(NamedTuple):
    """Sensor reading of the arms of W robots."""

    sensed: RobotState
    """Measured joint angles and lean, with the estimated pose."""
    torque: Float[Array, "W 6"]
    """Torques of the arm motors [N m]."""
    reach: Float[Array, "W"]
    """Reach of the hands [m]."""

    @property
    def hands(self) -> Float[Array, "W 2"]:
        """Midpoint of the hands in {W} [m]."""
        xp = se2.array_module(self.reach, self.sensed.pose)
        return se2.transform_point(self.sensed.pose, se2.stack(self.reach, xp.zeros_like(self.reach)))


def init(worlds: int) -> ArmScale:
    """State before the first reading."""
    return ArmScale(np.zeros((worlds, 6)), np.zeros((worlds, 6)))


def calibrate(
    scale: ArmScale,
    robot: Robot,
    reading: ArmReading,
    object_pose: Float[Array, "W N 3"],
    *,
    half_extents: Float[Array, "W N 2"],
) -> ArmScale:
    """Add one reading to the calibration sums, if the hands are extended and free.

    Args:
        scale: sums so far.
        robot: nominal robot parameters.
        reading: reading of the arms.
        object_pose: estimated object poses in {W} [m, rad]; NaN where unknown.
        half_extents: half extents of the objects' footprints [m].
    """
    xp = se2.array_module(reading.reach, reading.torque, object_pose)
    sensed, torque, extended = reading.sensed, reading.torque, reading.reach > REACH - 0.01
    inside = xp.abs(se2.rotate(reading.hands[:, None] - object_pose[..., :2], -object_pose[..., 2]))
    away = xp.linalg.norm(xp.maximum(inside - half_extents, 0.0), axis=-1)
    # A comparison with NaN is false, so objects that have never been seen count as out of reach.
    free = extended & ~(away < _FREE).any(axis=-1)
    gravity = xp.where(free[:, None], arm_gravity(robot, sensed.arms, sensed.lean[..., :1]).reshape(torque.shape), 0.0)
    return ArmScale(scale.products + torque * gravity, scale.squares + gravity**2)


def wrench(
    touch: TouchConfig, scale: ArmScale, robot: Robot, reading: ArmReading, *, object_pose: Float[Array, "W N 3"]
) -> Float[Array, "W N 3"]:
    """Estimated wrench Gamma on each object about its centre, in {W} [N, N m].

    The whole wrench is assigned to the object nearest to the hands; all other objects get 0.

    Args:
        touch: settings of the estimate.
        scale: calibration sums of the motors.
        robot: nominal robot parameters.
        reading: reading of the arms.
        object_pose: estimated object poses in {W} [m, rad]; NaN where unknown.
    """
    if not object_pose.size:
        return object_pose
    xp = se2.array_module(reading.reach, reading.torque, object_pose)
    far = xp.linalg.norm(object_pose[..., :2] - reading.hands[:, None], axis=-1)
    nearest = xp.argmin(xp.where(xp.isfinite(far), far, xp.inf), axis=1)
    torque_ratio = xp.clip((_PRIOR + scale.products) / (_PRIOR + scale.squares), 1 / _LIMIT, _LIMIT)
    where = xp.take_along_axis(object_pose, nearest[:, None, None], axis=1)[:, 0]
    estimate = joint_torque_wrench(robot, reading.sensed, reading.torque / torque_ratio, where)
    # A comparison with NaN is false, so an object with unknown pose is not touched.
    firm = (xp.hypot(estimate[:, 0], estimate[:, 1]) > touch.least) & xp.isfinite(estimate).all(axis=-1)
    there = firm[:, None] & (nearest[:, None] == np.arange(object_pose.shape[1]))
    return xp.where(there[..., None], estimate[:, None], 0.0)
