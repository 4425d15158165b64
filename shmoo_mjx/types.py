"""Pytrees shared by several packages, with shapes, units and frames.

Frames: {W} is the world. {R} is the robot (origin at the contact point with the floor, x forward, yaw only). {O} is the
object (origin at its centre, yaw only). SI units, angles in rad. ``...`` stands for any batch dimensions.
"""

from __future__ import annotations

from typing import NamedTuple

from shmoo_mjx.arrays import Array, Bool, Float, Scalar

DT = 0.1
"""Sample time of the dynamics model and of the controllers [s] (Eq. 1)."""


class Command(NamedTuple):
    """Command to the robot's low-level control, constant for one sample time."""

    u: Float[Array, "... 3"]
    """Lean angles towards +x and +y of {R}, and steering angle: (phi_x, phi_y, gamma) [rad]."""
    yaw: Scalar | Float[Array, "..."]
    """Desired heading of the robot in {W} [rad]."""
    reach: Scalar | Float[Array, "..."]
    """x of the hands' midpoint in {R} [m]."""
    hand_height: Scalar | Float[Array, "..."]
    """Height of the hands above the floor [m]."""


class Track(NamedTuple):
    """Motion of W worlds while a command is held, sampled at the ends of T equal parts of its duration."""

    physics: Float[Array, "T W n"]
    """MuJoCo's full physics state."""
    torque: Float[Array, "T W 9"]
    """Commanded motor torques [N m]."""
    wrench: Float[Array, "W N 3"]
    """Gamma on each object about its centre, in {W}, mean over the whole duration (fx, fy, tz) [N, N m]."""
    wall_parts: Bool[Array, "W P"]
    """Which of scene.PARTS touched a wall during that time."""


class Observation(NamedTuple):
    """Observation at the end of a sample time, with N objects: a sensed estimate, or ground truth from an engine."""

    time: Float[Array, "..."]
    """Simulated time [s]."""
    robot_pose: Float[Array, "... 3"]
    """Pose (x, y, yaw) of {R} in {W} [m, rad]."""
    robot_twist: Float[Array, "... 3"]
    """Derivative of ``robot_pose`` in {W} [m/s, rad/s]."""
    lean: Float[Array, "... 2"]
    """Lean angles towards +x and +y of {R} [rad]."""
    lean_rate: Float[Array, "... 2"]
    """Rates of the lean angles [rad/s]."""
    hands: Float[Array, "... 2 3"]
    """Hand centres (left, right) in {R}, with z above the floor [m]."""
    object_pose: Float[Array, "... N 3"]
    """Poses (x, y, yaw) of {O} in {W} [m, rad]."""
    object_twist: Float[Array, "... N 3"]
    """Derivatives of ``object_pose`` in {W} [m/s, rad/s]."""
    wrench: Float[Array, "... N 3"]
    """Gamma: planar wrench of the hands on each object about the object's centre, in {W}, mean over the last sample
    time (fx, fy, tz) [N, N m]."""
    robot_age: Scalar | Float[Array, "..."]
    """Age of the measurement on which the robot's pose is based [s]."""
    object_age: Float[Array, "... N"]
    """Age of the measurement on which each object's pose is based [s]. An object that was never detected has infinite
    age and a NaN pose."""
    detected: Bool[Array, "... N"]
    """Whether the object was detected within the last sample time. Otherwise its pose is extrapolated."""


class SystemState(NamedTuple):
    """State x_t of Eq. 1: the robot and the object that it pushes, with the past values that the learned models use.

    Here the feature axis is last; inside the transition it is first (dynamics/layout.py).
    """

    robot_pose: Float[Array, "... 3"]
    """Pose (x, y, yaw) of {R} in {W} [m, rad]."""
    robot_twist: Float[Array, "... 3"]
    """Derivative of ``robot_pose`` in {W} [m/s, rad/s]."""
    lean: Float[Array, "... 2"]
    """Lean angles towards +x and +y of {R} [rad]."""
    lean_rate: Float[Array, "... 2"]
    """Rates of the lean angles [rad/s]."""
    object_pose: Float[Array, "... 3"]
    """Pose (x, y, yaw) of {O} in {W} [m, rad]."""
    object_twist: Float[Array, "... 3"]
    """Derivative of ``object_pose`` in {W} [m/s, rad/s]."""
    last_object_twist: Float[Array, "... 3"]
    """Object twist one sample earlier, in {O} of that time [m/s, rad/s]. The casters' state depends on past motion."""
    last_wrench: Float[Array, "... 3"]
    """Mean wrench of the hands on the object over the last sample, in {O} of that time [N, N m]. Together with the two
    twists it determines the total resistance to the motion."""
    last_force: Float[Array, "... 2"]
    """Mean force of the hands on the object over the last sample, in {R} [N]."""
    last_u: Float[Array, "... 3"]
    """Command u of the last sample [rad]."""
    face: Float[Array, "... 4"]
    """Pushed face in {O}: centre x, y [m], direction of the inward normal [rad], half width [m]. Constant over a
    roll-out."""
    size: Scalar | Float[Array, "..."]
    """Half the diagonal of the object's footprint [m]. Constant over a roll-out."""
