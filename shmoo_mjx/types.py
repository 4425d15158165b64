"""Every pytree that crosses a folder's border, with shapes, units and frames.

Frames: {W} world; {R} robot (origin at the wheel's contact point, x forward, yaw only); {O} object (at the object's
centre, yaw only). SI units, angles in rad. ``...`` stands for any batch dimensions.
"""

from __future__ import annotations

from typing import NamedTuple

from shmoo_mjx.arrays import Array, Bool, Float, Scalar

DT = 0.1
"""Sample time of the dynamics model and of the controllers [s] (Eq. 1)."""


class Command(NamedTuple):
    """What the low-level control of the robot takes, held for one sample time."""

    u: Float[Array, "... 3"]
    """Lean angle towards +x and +y of {R} and steering angle: (phi_x, phi_y, gamma) [rad]."""
    yaw: Scalar | Float[Array, "..."]
    """Heading of the robot in {W} that the yaw loop holds [rad]."""
    reach: Scalar | Float[Array, "..."]
    """x of the hands' midpoint in {R} [m]."""
    hand_height: Scalar | Float[Array, "..."]
    """Height of the hands above the floor [m]."""


class Track(NamedTuple):
    """What an engine's W worlds went through while a command was held, at the ends of T equal parts of the time."""

    physics: Float[Array, "T W n"]
    """MuJoCo's full physics state."""
    torque: Float[Array, "T W 9"]
    """Motor torques that the control asks for [N m]."""
    wrench: Float[Array, "W N 3"]
    """Gamma on each object, about its centre, in {W}, mean over the whole time [N, N m]."""
    wall_parts: Bool[Array, "W P"]
    """Which of scene.PARTS touched a wall in that time."""


class Observation(NamedTuple):
    """What the robot perceives at the end of a sample time; an engine's own observation is the truth. N objects."""

    time: Float[Array, "..."]
    """[s]"""
    robot_pose: Float[Array, "... 3"]
    """Of {R} in {W}: (x, y, yaw)."""
    robot_twist: Float[Array, "... 3"]
    """Derivative of robot_pose, in {W}."""
    lean: Float[Array, "... 2"]
    """Lean angles towards +x and +y of {R} [rad]."""
    lean_rate: Float[Array, "... 2"]
    """Their rates [rad/s]."""
    hands: Float[Array, "... 2 3"]
    """Hand centres (left, right) in {R}; z above the floor [m]."""
    object_pose: Float[Array, "... N 3"]
    """Of {O} in {W}."""
    object_twist: Float[Array, "... N 3"]
    """Derivative of object_pose, in {W}."""
    wrench: Float[Array, "... N 3"]
    """Gamma: planar wrench of the hands on each object, about that object's centre, in {W}, mean over
    the last sample time (fx, fy [N], tz [N m])."""
    robot_age: Scalar | Float[Array, "..."]
    """Time since the measurement that the robot's pose rests on [s]."""
    object_age: Float[Array, "... N"]
    """Time since the measurement that each object's pose rests on [s]; infinite, with a pose of NaN, for
    an object that was never detected."""
    detected: Bool[Array, "... N"]
    """Whether the object was detected within the last sample time; otherwise its pose is carried on."""


class SystemState(NamedTuple):
    """x_t of Eq. 1 for the robot and the one object it pushes, with the memory the learned models use.

    Inside the transition channels come first instead (dynamics/layout.py).
    """

    robot_pose: Float[Array, "... 3"]
    """Of {R} in {W}."""
    robot_twist: Float[Array, "... 3"]
    """Derivative of robot_pose, in {W}."""
    lean: Float[Array, "... 2"]
    """[rad]"""
    lean_rate: Float[Array, "... 2"]
    """[rad/s]"""
    object_pose: Float[Array, "... 3"]
    """Of {O} in {W}."""
    object_twist: Float[Array, "... 3"]
    """Derivative of object_pose, in {W}."""
    last_object_twist: Float[Array, "... 3"]
    """The twist one sample earlier, in {O} of that time: casters have memory."""
    last_wrench: Float[Array, "... 3"]
    """Mean wrench of the hands on the object over the last sample, in {O} of that time: with the two
    twists it tells what held the object back, whatever that was [N, N m]."""
    last_force: Float[Array, "... 2"]
    """Mean force of the hands on the object over the last sample, in {R} [N]."""
    last_u: Float[Array, "... 3"]
    """The command of the last sample [rad]."""
    face: Float[Array, "... 4"]
    """The face that is pushed, in {O}: centre x, y [m], direction of its inward normal [rad], half its
    width [m]. Constant over a roll-out."""
    size: Scalar | Float[Array, "..."]
    """Half the diagonal of the object's footprint [m]. Constant over a roll-out."""
