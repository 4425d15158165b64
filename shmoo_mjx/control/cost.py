"""Cost of a push: Eq. 9 of the paper, and additional terms whose default weight is zero.

Every term takes one batch of roll-outs (``SystemState`` with leading axes ``[S, T]``, states after each control) and
returns ``[S]``. The weighted terms are in metres, so the temperature of MPPI is in metres too.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.control.mppi import CostFn
from shmoo_mjx.control.obstacles import DistanceField, Margins, clearance_penalty
from shmoo_mjx.control.speed import SpeedProfile
from shmoo_mjx.dynamics.layout import SO2, mean_over_time, once, time_first
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import REACH
from shmoo_mjx.types import SystemState


@dataclass(frozen=True)
class PushCost:
    """Weights of the terms. The first three belong to Eq. 9; the others are additional and 0 (off) by default."""

    yaw_weight: float = 1.0
    """Weight of the yaw error relative to the position error [m/rad]. The paper has 1; 0 ignores the yaw. Larger is
    more accurate in yaw and less accurate in position."""
    effort: float = 0.01
    """lambda_1, weight of the control magnitude per time step [m/rad]; not given in the paper. Larger leans less and is
    slower."""
    change: float = 0.02
    """lambda_2, weight of the control change per time step [m/rad]; not given in the paper. Larger gives smoother and
    later commands."""
    running_weight: float = 0.0
    """Weight of the mean pose distance over the roll-out [-]. Larger rewards an early arrival."""
    clearance_weight: float = 0.0
    """Weight of the clearance penalty, the depth inside the margins integrated over time [1/s]. Larger keeps robot,
    hands and object farther from walls, at the expense of the goal."""
    lateral_weight: float = 0.0
    """Weight of the mean lateral offset between the hands' midpoint and the face's centre [-]. Larger pushes closer to
    the centre and turns the object less."""
    heading_weight: float = 0.0
    """Weight of the mean angle between the robot's heading and the face's inward normal [m/rad]. Larger keeps the robot
    more perpendicular to the face."""
    aim_weight: float = 0.0
    """Weight of the mean distance by which a push along the face's normal would miss the goal [-]. Larger turns the
    object towards its goal earlier, which otherwise pays off only beyond the horizon. See ``aim_error`` for goals with
    a yaw."""
    speed_weight: float = 0.0
    """Weight of the object's speed at the end of the roll-out [s]. Larger arrives more slowly, because a push can not
    brake a rolling object."""
    overspeed_weight: float = 0.0
    """Weight of the robot's mean speed above the allowed speed [s]. Larger enforces the limit more strictly."""


def pose_distance(
    goal: Float[Array, "... 3"], pose: Float[Array, "... 3"], yaw_weight: float = 1.0
) -> Float[Array, "..."]:
    """|| goal - pose ||_2 of Eq. 9 [m], with the wrapped yaw error times ``yaw_weight``.

    Args:
        goal: desired pose in {W}.
        pose: object poses in {W}.
        yaw_weight: weight of the yaw error [m/rad]; 0 gives the distance of the positions.
    """
    offset = pose - goal
    if not yaw_weight:
        return _length(offset[..., :2])
    return jnp.sqrt(_square(offset[..., :2]) + (yaw_weight * se2.wrap(offset[..., 2])) ** 2)


def effort(controls: Float[Array, "*S T m"]) -> Float[Array, "*S"]:
    """sum_k || u_k ||_2 of Eq. 9 [rad]."""
    return _length(controls) @ jnp.ones(controls.shape[-2])


def change(controls: Float[Array, "*S T m"], last_u: Float[Array, "m"]) -> Float[Array, "*S"]:
    """sum_k || u_k - u_{k-1} ||_2 of Eq. 9 [rad]; u_0 is the last applied control, ``last_u``."""
    first = jnp.broadcast_to(last_u, controls[..., :1, :].shape)
    return _length(jnp.diff(controls, axis=-2, prepend=first)) @ jnp.ones(controls.shape[-2])


def _square(vector: Float[Array, "*b n"]) -> Scalar | Float[Array, "*b"]:
    """Squared length, computed channel by channel because XLA is slow for sums over few elements."""
    return sum((vector[..., i] ** 2 for i in range(1, vector.shape[-1])), vector[..., 0] ** 2)


def _length(vector: Float[Array, "*b n"]) -> Float[Array, "*b"]:
    return jnp.sqrt(_square(vector))


def face_misalignment(traj: SystemState, reach: float = REACH) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Mean lateral offset and mean heading error of the robot relative to the pushed face.

    Returns:
        Distance of the hands' midpoint from the face's centre line [m], and angle between the robot's heading and the
        face's inward normal [rad]. Both are absolute values, averaged over the roll-out.
    """
    robot, thing, face = time_first(traj.robot_pose), time_first(traj.object_pose), time_first(traj.face)[:1]
    normal = thing[..., 2] + face[..., 2]
    heading = se2.wrap(robot[..., 2] - normal)
    turn, error = once((SO2.from_angle(normal), SO2.from_angle(heading)))
    x, y = (robot[..., i] - thing[..., i] for i in range(2))
    # Lateral position of the hands minus that of the face's centre, in a frame along the normal. The centre is constant
    # in this frame.
    centre = se2.rotate(face[..., :2], -face[..., 2])[..., 1]
    lateral = turn.c * y - turn.s * x + reach * error.s - centre
    return mean_over_time(jnp.abs(lateral)), mean_over_time(jnp.abs(heading))


def aim_error(goal: Float[Array, "... 3"], traj: SystemState, with_yaw: bool = False) -> Float[Array, "..."]:
    """Mean distance by which a straight push would miss the goal [m].

    It is the distance of the goal from the line through the object's centre along the face's normal. With ``with_yaw``
    the required direction is not the bearing b of the goal, but the initial direction of the arc that ends at the goal
    with the goal's yaw: 2 b - (direction at the goal). Its lead over the bearing is limited to 0.6 rad.

    Args:
        goal: desired pose in {W}.
        traj: roll-outs.
        with_yaw: True if the yaw of the goal counts.
    """
    thing, face = time_first(traj.object_pose), time_first(traj.face)[:1]
    offset = goal[..., :2] - thing[..., :2]
    angle = thing[..., 2] + face[..., 2]
    if with_yaw:
        bearing = jnp.arctan2(offset[..., 1], offset[..., 0])
        lead = se2.wrap(bearing - goal[..., 2] - face[..., 2])
        # Beyond the goal no such arc exists, so the lead is zero.
        angle = angle - jnp.where(jnp.abs(lead) < jnp.pi / 2, jnp.clip(lead, -0.6, 0.6), 0.0)
    normal = once(SO2.from_angle(angle))
    return mean_over_time(jnp.abs(normal.c * offset[..., 1] - normal.s * offset[..., 0]))


def terminal_speed(traj: SystemState) -> Float[Array, "..."]:
    """Speed of the object's centre at the end of the roll-out [m/s]."""
    return _length(traj.object_twist[..., -1, :2])


def overspeed(traj: SystemState, limit: Scalar | Float[Array, "T *S"]) -> Float[Array, "*S"]:
    """Mean speed of the robot above ``limit`` over the roll-out [m/s]."""
    return mean_over_time(jnp.maximum(_length(time_first(traj.robot_twist)[..., :2]) - limit, 0.0))


def push_cost(
    cfg: PushCost,
    goal: Float[Array, "3"],
    *,
    speed: SpeedProfile | None = None,
    margins: Margins | None = None,
    clearance: DistanceField | None = None,
    half_extents: Float[Array, "2"] | None = None,
) -> CostFn:
    """The cost function of a push for MPPI [m]: Eq. 9 plus the additional terms with a nonzero weight.

    Args:
        cfg: weights.
        goal: desired object pose in {W}.
        speed: allowed speed of the robot, for ``overspeed_weight``.
        margins: margins of robot and object, for ``clearance_weight``.
        clearance: distance to obstacles around the object; None for a floor without obstacles.
        half_extents: half length and half width of the object's footprint [m]; required with ``clearance``.
    """
    goal, speed, margins = jnp.asarray(goal), speed or SpeedProfile(), margins or Margins()

    def cost_fn(traj: SystemState, controls: Array, last_u: Array) -> Array:
        cost = pose_distance(goal, traj.object_pose[..., -1, :], cfg.yaw_weight)
        cost = cost + cfg.effort * effort(controls) + cfg.change * change(controls, last_u)
        if cfg.running_weight:
            distance = pose_distance(goal, time_first(traj.object_pose), cfg.yaw_weight)
            cost = cost + cfg.running_weight * mean_over_time(distance)
        if cfg.clearance_weight and clearance is not None:
            if half_extents is None:
                raise ValueError("the clearance term needs the object's half_extents")
            cost = cost + cfg.clearance_weight * clearance_penalty(margins, traj, clearance, half_extents)
        if cfg.lateral_weight or cfg.heading_weight:
            lateral, heading = face_misalignment(traj)
            cost = cost + cfg.lateral_weight * lateral + cfg.heading_weight * heading
        if cfg.aim_weight:
            cost = cost + cfg.aim_weight * aim_error(goal, traj, with_yaw=cfg.yaw_weight > 0)
        if cfg.speed_weight:
            cost = cost + cfg.speed_weight * terminal_speed(traj)
        if cfg.overspeed_weight:
            distance = pose_distance(goal, time_first(traj.object_pose), 0.0)
            cost = cost + cfg.overspeed_weight * overspeed(traj, speed.allowed(distance))
        return cost

    return cost_fn
