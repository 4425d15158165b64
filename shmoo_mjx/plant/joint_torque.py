"""Gamma = J tau: the interaction wrench as hardware without force sensors estimates it (Sec. III-C.1).

Arm torque less gravity is balanced by the hand's contact force, exactly so at rest. The simulator's own contact wrench
(plant/observe.py) stands beside it.
"""

from __future__ import annotations

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.geometry import se2
from shmoo_mjx.plant.lowlevel import arm_gravity
from shmoo_mjx.plant.robot import Robot, RobotState


def hand_forces(robot: Robot, sensed: RobotState, arm_torque: Float[Array, "... 6"]) -> Float[Array, "... 2 3"]:
    """Force of each hand on what it touches, in {R} [N].

    Args:
        robot: its numbers.
        sensed: its state.
        arm_torque: motor torques (left, right) x (yaw, pitch, elbow) [N m].

    Returns:
        (left, right) x (x, y, z), from J^T f = tau - tau_gravity.
    """
    xp = se2.array_module(sensed.arms, arm_torque)
    torque = arm_torque.reshape(sensed.arms.shape) - arm_gravity(robot, sensed.arms, sensed.lean[..., :1])
    transposed = xp.swapaxes(robot.arm_jacobian(sensed.arms), -1, -2)
    in_body = xp.linalg.solve(transposed, torque[..., None])[..., 0]
    return xp.einsum("...ij,...hj->...hi", sensed.rotation, in_body)


def joint_torque_wrench(
    robot: Robot, sensed: RobotState, arm_torque: Float[Array, "... 6"], object_pose: Float[Array, "... 3"]
) -> Float[Array, "... 3"]:
    """Planar wrench of both hands on the object about its centre, in {W}: (fx, fy [N], tz [N m]).

    Args:
        robot: its numbers.
        sensed: its state.
        arm_torque: [N m].
        object_pose: of the object the hands touch, in {W}.
    """
    xp = se2.array_module(sensed.arms, arm_torque, object_pose)
    force = hand_forces(robot, sensed, arm_torque)[..., :2]
    hands = xp.einsum("...ij,...hj->...hi", sensed.rotation, robot.hand_in_body(sensed.arms))[..., :2]
    size = xp.sqrt(xp.sum(force * force, axis=-1, keepdims=True))
    # The contact lies where the force leaves the sphere.
    contact = hands + robot.hand_radius * force / xp.maximum(size, 1e-6)
    heading = sensed.pose[..., 2][..., None]
    force = se2.rotate(force, heading)
    lever = sensed.pose[..., None, :2] + se2.rotate(contact, heading) - object_pose[..., None, :2]
    moment = se2.cross(lever, force)
    return xp.sum(xp.concatenate([force, moment[..., None]], axis=-1), axis=-2)
