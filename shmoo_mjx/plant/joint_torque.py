"""Gamma = J tau: the interaction wrench as hardware without force sensors estimates it (Sec. III-C.1).

Arm torque less gravity is balanced by the hand's contact force, exactly so at rest. The simulator's own contact wrench
(plant/observe.py) stands beside it.
"""

from __future__ import annotations

from typing import Any

from shmoo_mjx import se2
from shmoo_mjx.hands import HAND_RADIUS
from shmoo_mjx.plant.lowlevel import arm_gravity
from shmoo_mjx.plant.robot import RobotState, arm_jacobian, hand_in_body

__all__ = ["hand_forces", "joint_torque_wrench"]

Array = Any


def hand_forces(robot: RobotState, arm_torque: Array) -> Array:
    """Force of each hand on what it touches, in {R} [N].

    Args:
        robot: the robot's state.
        arm_torque: motor torques ``[..., 6]`` (left, right) x (yaw, pitch, elbow) [N m].

    Returns:
        ``[..., 2, 3]`` (left, right) x (x, y, z), from J^T f = tau - tau_gravity.
    """
    xp = se2.array_module(robot.arms, arm_torque)
    torque = arm_torque.reshape(robot.arms.shape) - arm_gravity(robot.arms, robot.lean[..., :1])
    transposed = xp.swapaxes(arm_jacobian(robot.arms), -1, -2)
    in_body = xp.linalg.solve(transposed, torque[..., None])[..., 0]
    return xp.einsum("...ij,...hj->...hi", robot.rotation, in_body)


def joint_torque_wrench(robot: RobotState, arm_torque: Array, object_pose: Array) -> Array:
    """Planar wrench of both hands on the object about its centre, in {W}: ``[..., 3]`` (fx, fy [N], tz [N m]).

    Args:
        robot: the robot's state.
        arm_torque: ``[..., 6]`` [N m].
        object_pose: ``[..., 3]`` of the object the hands touch, in {W}.
    """
    xp = se2.array_module(robot.arms, arm_torque, object_pose)
    force = hand_forces(robot, arm_torque)[..., :2]
    hands = xp.einsum("...ij,...hj->...hi", robot.rotation, hand_in_body(robot.arms))[..., :2]
    size = xp.sqrt(xp.sum(force * force, axis=-1, keepdims=True))
    # The contact lies where the force leaves the sphere.
    contact = hands + HAND_RADIUS * force / xp.maximum(size, 1e-6)
    heading = robot.pose[..., 2][..., None]
    force = se2.rotate(force, heading)
    lever = robot.pose[..., None, :2] + se2.rotate(contact, heading) - object_pose[..., None, :2]
    moment = se2.cross(lever, force)
    return xp.sum(xp.concatenate([force, moment[..., None]], axis=-1), axis=-2)
