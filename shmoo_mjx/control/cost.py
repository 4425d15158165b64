"""Cost of a push: Eq. 9 of the paper, and additional terms that are off unless given a weight.

Every term is a function of one batch of roll-outs (``SystemState`` with leading axes ``[S, T]``, states after each
control) and returns ``[S]``. All terms are in metres once weighted, so MPPI's temperature reads in metres too.
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
    """Weights of the terms. The first three are those of Eq. 9; the rest are additional and 0 (off) by default."""

    yaw_weight: float = 1.0
    """Metres that a yaw error of 1 rad counts for [m/rad]; 1 as printed, 0 leaves the yaw free, more turns the object
    at the expense of its position."""
    effort: float = 0.01
    """lambda_1 [m/rad], per time step; not given in the paper. More leans less, and is slower."""
    change: float = 0.02
    """lambda_2 [m/rad], per time step; not given in the paper. More makes commands smoother, and later."""
    running_weight: float = 0.0
    """Factor on the pose distance averaged over the roll-out [-]: rewards getting there early."""
    clearance_weight: float = 0.0
    """Cost per metre-second that robot, hands or object spend inside their margins [1/s]; more keeps off walls at the
    expense of the goal."""
    lateral_weight: float = 0.0
    """Cost per metre of the hands' midpoint beside the face's centre, averaged over the roll-out [-]; more pushes
    nearer to the middle and turns the object less."""
    heading_weight: float = 0.0
    """Cost per rad between the robot's heading and the face's inward normal, averaged over the roll-out [m/rad]; more
    keeps the hands square to the face."""
    aim_weight: float = 0.0
    """Cost per metre by which a push along the face's normal would miss the goal, averaged over the roll-out [-]:
    turning an object towards its goal pays only after the horizon's end. Where the yaw counts, see ``aim_error``."""
    speed_weight: float = 0.0
    """Cost per m/s of the object at the end [s]; more arrives slower: pushing can't brake what rolls."""
    overspeed_weight: float = 0.0
    """Cost per m/s of the robot above the allowed speed, averaged over the roll-out [s]; more keeps to the limit."""


def pose_distance(
    goal: Float[Array, "... 3"], pose: Float[Array, "... 3"], yaw_weight: float = 1.0
) -> Float[Array, "..."]:
    """|| goal - pose ||_2 of Eq. 9 [m], the yaw error taken on the circle and times ``yaw_weight`` [m/rad].

    Args:
        goal: desired pose in {W}.
        pose: object poses in {W}.
        yaw_weight: 0 leaves the position alone.
    """
    offset = pose - goal
    if not yaw_weight:
        return _length(offset[..., :2])
    return jnp.sqrt(_square(offset[..., :2]) + (yaw_weight * se2.wrap(offset[..., 2])) ** 2)


def effort(controls: Float[Array, "*S T m"]) -> Float[Array, "*S"]:
    """sum_k || u_k ||_2 of Eq. 9 [rad]."""
    return _length(controls) @ jnp.ones(controls.shape[-2])


def change(controls: Float[Array, "*S T m"], last_u: Float[Array, "m"]) -> Float[Array, "*S"]:
    """sum_k || u_k - u_{k-1} ||_2 of Eq. 9 [rad]; u_0 is the control applied last, ``last_u``."""
    first = jnp.broadcast_to(last_u, controls[..., :1, :].shape)
    return _length(jnp.diff(controls, axis=-2, prepend=first)) @ jnp.ones(controls.shape[-2])


def _square(vector: Float[Array, "*b n"]) -> Scalar | Float[Array, "*b"]:
    """Squared length, channel by channel: a sum over a few is slow in XLA."""
    return sum((vector[..., i] ** 2 for i in range(1, vector.shape[-1])), vector[..., 0] ** 2)


def _length(vector: Float[Array, "*b n"]) -> Float[Array, "*b"]:
    return jnp.sqrt(_square(vector))


def face_misalignment(traj: SystemState, reach: float = REACH) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Lateral offset and heading error of the hands against the pushed face, means over the roll-out.

    Returns:
        Distance of the hands' midpoint from the face's centre line [m], and angle between the robot's heading and the
        face's inward normal [rad].
    """
    robot, thing, face = time_first(traj.robot_pose), time_first(traj.object_pose), time_first(traj.face)[:1]
    normal = thing[..., 2] + face[..., 2]
    heading = se2.wrap(robot[..., 2] - normal)
    turn, error = once((SO2.from_angle(normal), SO2.from_angle(heading)))
    x, y = (robot[..., i] - thing[..., i] for i in range(2))
    # In a frame along the normal: hands less the face's centre, which stands still in it.
    centre = se2.rotate(face[..., :2], -face[..., 2])[..., 1]
    lateral = turn.c * y - turn.s * x + reach * error.s - centre
    return mean_over_time(jnp.abs(lateral)), mean_over_time(jnp.abs(heading))


def aim_error(goal: Float[Array, "... 3"], traj: SystemState, with_yaw: bool = False) -> Float[Array, "..."]:
    """Distance by which a push straight on would miss the goal, mean over the roll-out [m].

    The distance of the goal from the line through the object's centre along the face's normal. ``with_yaw``, instead of
    the line, the arc that ends at the goal with the goal's yaw: at bearing b of the goal it starts in the direction
    2 b - (direction at the goal). The lead over the bearing is limited to 0.6 rad.
    """
    thing, face = time_first(traj.object_pose), time_first(traj.face)[:1]
    offset = goal[..., :2] - thing[..., :2]
    angle = thing[..., 2] + face[..., 2]
    if with_yaw:
        bearing = jnp.arctan2(offset[..., 1], offset[..., 0])
        lead = se2.wrap(bearing - goal[..., 2] - face[..., 2])
        # Behind the goal the bearing says nothing about the yaw.
        angle = angle - jnp.where(jnp.abs(lead) < jnp.pi / 2, jnp.clip(lead, -0.6, 0.6), 0.0)
    normal = once(SO2.from_angle(angle))
    return mean_over_time(jnp.abs(normal.c * offset[..., 1] - normal.s * offset[..., 0]))


def terminal_speed(traj: SystemState) -> Float[Array, "..."]:
    """Speed of the object's centre at the end [m/s]."""
    return _length(traj.object_twist[..., -1, :2])


def overspeed(traj: SystemState, limit: Scalar | Float[Array, "T *S"]) -> Float[Array, "*S"]:
    """Speed of the robot above ``limit`` [m/s], mean over the roll-out [m/s]."""
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
    """The cost [m] of a push, for MPPI: Eq. 9, plus the additional terms that have a weight.

    Args:
        cfg: weights.
        goal: desired object pose in {W}.
        speed: speed that is free of charge, for ``overspeed_weight``.
        margins: for ``clearance_weight``.
        clearance: distance to obstacles round the object; None on a floor without any.
        half_extents: half length and width of the object's footprint [m]; needed with ``clearance``.
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
