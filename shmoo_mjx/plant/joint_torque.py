"""Gamma = J tau: interaction wrench estimated from arm motor torques, without force sensors (Sec. III-C.1).

At rest, the arm torque minus gravity balances the hand's contact force exactly; during motion approximately. The
simulator's own contact wrench is computed in plant/observe.py.
"""

from __future__ import annotations

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.geometry import se2
from shmoo_mjx.plant.lowlevel import arm_gravity
from shmoo_mjx.plant.robot import Robot, RobotState


def hand_forces(robot: Robot, sensed: RobotState, arm_torque: Float[Array, "... 6"]) -> Float[Array, "... 2 3"]:
    """Contact force that each hand exerts, in {R} [N], from J^T f = tau - tau_gravity.

    Args:
        robot: nominal robot parameters.
        sensed: robot state.
        arm_torque: motor torques (left, right) x (yaw, pitch, elbow) [N m].

    Returns:
        Forces (left, right) x (x, y, z) [N].
    """
    xp = se2.array_module(sensed.arms, arm_torque)
    torque = arm_torque.reshape(sensed.arms.shape) - arm_gravity(robot, sensed.arms, sensed.lean[..., :1])
    transposed = xp.swapaxes(robot.arm_jacobian(sensed.arms), -1, -2)
    in_body = xp.linalg.solve(transposed, torque[..., None])[..., 0]
    return xp.einsum("...ij,...hj->...hi", sensed.rotation, in_body)


def joint_torque_wrench(
    robot: Robot, sensed: RobotState, arm_torque: Float[Array, "... 6"], object_pose: Float[Array, "... 3"]
) -> Float[Array, "... 3"]:
    """Planar wrench of both hands on the object about its centre, in {W}.

    Args:
        robot: nominal robot parameters.
        sensed: robot state.
        arm_torque: motor torques (left, right) x (yaw, pitch, elbow) [N m].
        object_pose: pose (x, y, yaw) of the touched object in {W} [m, rad].

    Returns:
        (fx, fy, tz) [N, N m].
    """
    xp = se2.array_module(sensed.arms, arm_torque, object_pose)
    force = hand_forces(robot, sensed, arm_torque)[..., :2]
    hands = xp.einsum("...ij,...hj->...hi", sensed.rotation, robot.hand_in_body(sensed.arms))[..., :2]
    size = xp.sqrt(xp.sum(force * force, axis=-1, keepdims=True))
    # The contact point is where the force direction leaves the hand's sphere.
    contact = hands + robot.hand_radius * force / xp.maximum(size, 1e-6)
    heading = sensed.pose[..., 2][..., None]
    force = se2.rotate(force, heading)
    lever = sensed.pose[..., None, :2] + se2.rotate(contact, heading) - object_pose[..., None, :2]
    moment = se2.cross(lever, force)
    return xp.sum(xp.concatenate([force, moment[..., None]], axis=-1), axis=-2)
