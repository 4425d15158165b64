"""Every pytree that crosses a folder's border, with shapes, units and frames.

Frames: {W} world; {R} robot (origin at the wheel's contact point, x forward, yaw only); {O} object (at the object's
centre, yaw only). SI units, angles in rad. ``...`` stands for any batch dimensions.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, get_args

__all__ = ["DT", "SENSES", "Array", "Command", "Observation", "SensesName", "SystemState"]

Array = Any
"""numpy.ndarray or jax.Array."""

DT = 0.1
"""Sample time of the dynamics model and of the controllers [s] (Eq. 1)."""

SensesName = Literal["real", "perfect"]
"""How the robot perceives: as a robot does, or the simulator's truth (shmoo_mjx/sensing)."""
SENSES: tuple[str, ...] = get_args(SensesName)


class Command(NamedTuple):
    """What the low-level control of the robot takes, held for one sample time."""

    u: Array
    """``[..., 3]`` lean angle towards +x and +y of {R} and steering angle: (phi_x, phi_y, gamma) [rad]."""
    yaw: Array
    """``[...]`` heading of the robot in {W} that the yaw loop holds [rad]."""
    reach: Array
    """``[...]`` x of the hands' midpoint in {R} [m]."""
    hand_height: Array
    """``[...]`` height of the hands above the floor [m]."""


class Observation(NamedTuple):
    """What the robot perceives at the end of a sample time; an engine's own observation is the truth. N objects."""

    time: Array
    """``[...]`` [s]"""
    robot_pose: Array
    """``[..., 3]`` of {R} in {W}: (x, y, yaw)."""
    robot_twist: Array
    """``[..., 3]`` derivative of robot_pose, in {W}."""
    lean: Array
    """``[..., 2]`` lean angles towards +x and +y of {R} [rad]."""
    lean_rate: Array
    """``[..., 2]`` their rates [rad/s]."""
    hands: Array
    """``[..., 2, 3]`` hand centres (left, right) in {R}; z above the floor [m]."""
    object_pose: Array
    """``[..., N, 3]`` of {O} in {W}."""
    object_twist: Array
    """``[..., N, 3]`` derivative of object_pose, in {W}."""
    wrench: Array
    """``[..., N, 3]`` Gamma: planar wrench of the hands on each object, about that object's centre, in {W}, mean over
    the last sample time (fx, fy [N], tz [N m])."""
    robot_age: Array
    """``[...]`` time since the measurement that the robot's pose rests on [s]."""
    object_age: Array
    """``[..., N]`` time since the measurement that each object's pose rests on [s]; infinite, with a pose of NaN, for
    an object that was never detected."""
    detected: Array
    """``[..., N]`` whether the object was detected within the last sample time; otherwise its pose is carried on."""


class SystemState(NamedTuple):
    """x_t of Eq. 1 for the robot and the one object it pushes, with the memory the learned models use."""

    robot_pose: Array
    """``[..., 3]`` of {R} in {W}."""
    robot_twist: Array
    """``[..., 3]`` derivative of robot_pose, in {W}."""
    lean: Array
    """``[..., 2]`` [rad]"""
    lean_rate: Array
    """``[..., 2]`` [rad/s]"""
    object_pose: Array
    """``[..., 3]`` of {O} in {W}."""
    object_twist: Array
    """``[..., 3]`` derivative of object_pose, in {W}."""
    last_object_twist: Array
    """``[..., 3]`` the twist one sample earlier, in {O} of that time: casters have memory."""
    last_wrench: Array
    """``[..., 3]`` mean wrench of the hands on the object over the last sample, in {O} of that time: with the two
    twists it tells what held the object back, whatever that was [N, N m]."""
    last_force: Array
    """``[..., 2]`` mean force of the hands on the object over the last sample, in {R} [N]."""
    last_u: Array
    """``[..., 3]`` the command of the last sample [rad]."""
    face: Array
    """``[..., 4]`` the face that is pushed, in {O}: centre x, y [m], direction of its inward normal [rad], half its
    width [m]. Constant over a roll-out."""
    size: Array
    """``[...]`` half the diagonal of the object's footprint [m]. Constant over a roll-out."""
