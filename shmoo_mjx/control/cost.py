"""Cost of a push: Eq. 9 of the paper, and additional terms that are off unless given a weight.

Every term is a function of one batch of roll-outs (``SystemState`` with leading axes ``[S, T]``, states after each
control) and returns ``[S]``. All terms are in metres once weighted, so MPPI's temperature reads in metres too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import Protocol, runtime_checkable

import jax.numpy as jnp

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.dynamics.layout import SO2, once
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import REACH, hand_targets
from shmoo_mjx.types import DT, SystemState

HAND_MARGIN = 0.08
"""Clearance that the hands' centres keep [m]: their radius and a reserve."""


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
    object_margin: float = 0.10
    """Clearance the object's outline keeps [m]; more keeps farther off walls."""
    robot_margin: float = 0.30
    """Clearance the robot's centre keeps [m]: its radius and a reserve. Holds the elbows of extended arms as well."""
    clearance_stride: int = 1
    """Number of time steps between two look-ups in the map [1]; the last one always is looked up. More is faster and
    sees less of narrow walls."""
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
    """Cost per m/s of the robot above ``speed_limit``, averaged over the roll-out [s]; more keeps to the limit."""
    speed_limit: float = 0.4
    """Speed of the robot that is free of charge [m/s]; more is faster, and loses what rolls."""
    terminal_speed: float = 0.0
    """Speed of the robot that is free of charge at the goal [m/s]; pushing can't brake, so that what rolls has to
    arrive slowly."""
    slow_down: float = 0.0
    """Increase of the free speed per metre from the goal, up to ``speed_limit`` [1/s]; more slows down later, 0 leaves
    the limit the same everywhere."""


@runtime_checkable
class DistanceField(Protocol):
    """Distance to the nearest obstacle on a grid: the map's clearance field has these, and so can any other pytree."""

    @property
    def values(self) -> Float[Array, "H W"]:
        """[m]; ``values[j, i]`` holds at the centre of cell (i, j), i along x and j along y of the grid."""

    @property
    def origin(self) -> Float[Array, "3"]:
        """Pose in {W} of the grid's corner, the outer corner of cell (0, 0) (x, y [m], yaw [rad])."""

    @property
    def resolution(self) -> Scalar:
        """Side of a cell [m]."""


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


def _length(vector: Float[Array, "*b n"]) -> Scalar | Float[Array, "*b"]:
    return jnp.sqrt(_square(vector))


def _time_first(x: Array) -> Array:
    """``[S, T, n]`` as ``[T, S, n]``. In memory the roll-outs' samples lie side by side: terms that compute in this
    order read them as vectors."""
    return jnp.moveaxis(x, -2, 0)


def _mean(x: Array) -> Array:
    """Mean ``[...]`` over time of ``x [T, ...]``: as a product, for which XLA has faster code than for a sum."""
    return jnp.tensordot(jnp.full(len(x), 1.0 / len(x)), x, axes=1)


def clearance_at(field: DistanceField, points: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    """Clearance [m] at ``points`` in {W}, bilinear; zero off the grid."""
    # With a rim of zeros every look-up lies on the grid: `map_coordinates` would check each of the four.
    values = once(jnp.pad(jnp.asarray(field.values), 1))
    rows, columns = values.shape
    i, j = _on_grid(field, points)
    x, y = jnp.clip(i + 0.5, 0.0, columns - 1.0), jnp.clip(j + 0.5, 0.0, rows - 1.0)
    left, low = jnp.minimum(jnp.floor(x), columns - 2.0), jnp.minimum(jnp.floor(y), rows - 2.0)
    corner, flat = once(low.astype(int) * columns + left.astype(int)), values.ravel()
    a, b, c, d = (flat.at[corner + k].get(mode="promise_in_bounds") for k in (0, 1, columns, columns + 1))
    across, up = x - left, y - low
    return (1 - up) * ((1 - across) * a + across * b) + up * ((1 - across) * c + across * d)


def footprint_points(pose: Float[Array, "*batch 3"], half_extents: Float[Array, "2"]) -> Float[Array, "*batch 8 2"]:
    """Corners and edge midpoints in {W} of a rectangle with ``half_extents`` [m] at ``pose``."""
    unit = jnp.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]], dtype=float)
    return _placed(pose, unit * jnp.asarray(half_extents))


def clearance_near(field: DistanceField, points: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    """Clearance [m] of the cell that holds each of ``points`` in {W}; zero off the grid.

    Off by up to 0.7 cells from :func:`clearance_at`, at a quarter of its look-ups.
    """
    values = jnp.asarray(field.values)
    rows, columns = values.shape
    i, j = (jnp.floor(cells).astype(int) for cells in _on_grid(field, points))
    inside = (i >= 0) & (j >= 0) & (i < columns) & (j < rows)
    found = values.ravel()[jnp.clip(j, 0, rows - 1) * columns + jnp.clip(i, 0, columns - 1)]
    return jnp.where(inside, found, 0.0)


def hand_points(
    robot_pose: Float[Array, "*batch 3"], gamma: Scalar | Float[Array, "*batch"]
) -> Float[Array, "*batch 2 2"]:
    """Centres of the extended hands (left, right) in {W}; gamma [rad]."""
    return _placed(robot_pose, hand_targets(gamma))


def _placed(pose: Array, points: Array) -> Array:
    """``points [..., P, 2]`` of bodies at ``pose [..., 3]``, in {W}: `se2.transform_point`, but for computing each sine
    once and not once a point."""
    turn, x, y = once(SO2.from_angle(pose[..., 2:])), points[..., 0], points[..., 1]
    return jnp.stack([pose[..., :1] + turn.c * x - turn.s * y, pose[..., 1:2] + turn.s * x + turn.c * y], axis=-1)


def _on_grid(field: DistanceField, points: Array) -> tuple[Array, Array]:
    """Column and row ``[...]``, in cells from the grid's corner, of ``points [..., 2]`` in {W}."""
    origin = jnp.asarray(field.origin)
    turn = once(SO2.from_angle(origin[2]))
    x, y = (points[..., 0] - origin[0]) / field.resolution, (points[..., 1] - origin[1]) / field.resolution
    return turn.c * x + turn.s * y, turn.c * y - turn.s * x


def clearance_penalty(
    cfg: PushCost, traj: SystemState, field: DistanceField, half_extents: Float[Array, "2"]
) -> Float[Array, "..."]:
    """Time integral of the depth by which robot centre, hands and object outline enter their margins [m s].

    The object counts with the deepest of its four corners and four edge midpoints, the hands with the deeper one. Hands
    stick out of the disc round the robot, and where one pushes round a corner they sweep where the object has not been.
    """
    steps = traj.robot_pose.shape[-2]
    robot_pose, object_pose, command = (
        _time_first(x)[(steps - 1) % cfg.clearance_stride :: cfg.clearance_stride]
        for x in (traj.robot_pose, traj.object_pose, traj.last_u)
    )
    robot = clearance_at(field, robot_pose[..., :2])
    outline = footprint_points(object_pose, half_extents)
    thing = _least(clearance_at(field, outline))
    depth = jnp.maximum(cfg.robot_margin - robot, 0.0) + jnp.maximum(cfg.object_margin - thing, 0.0)
    hands = hand_points(robot_pose, command[..., 2])
    depth = depth + jnp.maximum(HAND_MARGIN - _least(clearance_near(field, hands)), 0.0)
    return _mean(depth) * (steps * DT)


def _least(x: Array) -> Array:
    """Least ``[...]`` of ``x [..., P]`` for a few P; see `_mean`."""
    return reduce(jnp.minimum, (x[..., i] for i in range(x.shape[-1])))


def face_misalignment(traj: SystemState, reach: float = REACH) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Lateral offset and heading error of the hands against the pushed face, means over the roll-out.

    Returns:
        Distance of the hands' midpoint from the face's centre line [m], and angle between the robot's heading and the
        face's inward normal [rad].
    """
    robot, thing, face = _time_first(traj.robot_pose), _time_first(traj.object_pose), _time_first(traj.face)[:1]
    normal = thing[..., 2] + face[..., 2]
    heading = se2.wrap(robot[..., 2] - normal)
    turn, error = once((SO2.from_angle(normal), SO2.from_angle(heading)))
    x, y = (robot[..., i] - thing[..., i] for i in range(2))
    # In a frame along the normal: hands less the face's centre, which stands still in it.
    centre = se2.rotate(face[..., :2], -face[..., 2])[..., 1]
    lateral = turn.c * y - turn.s * x + reach * error.s - centre
    return _mean(jnp.abs(lateral)), _mean(jnp.abs(heading))


def aim_error(goal: Float[Array, "... 3"], traj: SystemState, with_yaw: bool = False) -> Float[Array, "..."]:
    """Distance by which a push straight on would miss the goal, mean over the roll-out [m].

    The distance of the goal from the line through the object's centre along the face's normal. ``with_yaw``, instead of
    the line, the arc that ends at the goal with the goal's yaw: at bearing b of the goal it starts in the direction
    2 b - (direction at the goal). The lead over the bearing is limited to 0.6 rad.
    """
    thing, face = _time_first(traj.object_pose), _time_first(traj.face)[:1]
    offset = goal[..., :2] - thing[..., :2]
    angle = thing[..., 2] + face[..., 2]
    if with_yaw:
        bearing = jnp.arctan2(offset[..., 1], offset[..., 0])
        lead = se2.wrap(bearing - goal[..., 2] - face[..., 2])
        # Behind the goal the bearing says nothing about the yaw.
        angle = angle - jnp.where(jnp.abs(lead) < jnp.pi / 2, jnp.clip(lead, -0.6, 0.6), 0.0)
    normal = once(SO2.from_angle(angle))
    return _mean(jnp.abs(normal.c * offset[..., 1] - normal.s * offset[..., 0]))


def terminal_speed(traj: SystemState) -> Float[Array, "..."]:
    """Speed of the object's centre at the end [m/s]."""
    return _length(traj.object_twist[..., -1, :2])


def allowed_speed(cfg: PushCost, distance: Scalar | Float[Array, "..."]) -> Scalar | Float[Array, "..."]:
    """Speed of the robot that is free of charge [m/s] where the object is ``distance`` [m] from its goal."""
    if not cfg.slow_down:
        return cfg.speed_limit + 0.0 * distance
    return se2.array_module(distance).minimum(cfg.terminal_speed + cfg.slow_down * distance, cfg.speed_limit)


def overspeed(traj: SystemState, limit: Scalar | Float[Array, "T *S"]) -> Float[Array, "*S"]:
    """Speed of the robot above ``limit`` [m/s], mean over the roll-out [m/s]."""
    return _mean(jnp.maximum(_length(_time_first(traj.robot_twist)[..., :2]) - limit, 0.0))


def push_cost(
    cfg: PushCost,
    goal: Float[Array, "3"],
    traj: SystemState,
    controls: Float[Array, "*S T m"],
    last_u: Float[Array, "m"],
    field: DistanceField | None = None,
    half_extents: Float[Array, "2"] | None = None,
) -> Float[Array, "*S"]:
    """Cost of each roll-out [m]: Eq. 9, plus the additional terms that have a weight.

    Args:
        cfg: weights.
        goal: desired object pose in {W}.
        traj: roll-outs, leaves ``[S, T, ...]``.
        controls: [rad]
        last_u: control applied last [rad].
        field: map clearance; needed when ``clearance_weight`` is set.
        half_extents: half length and width of the object's footprint [m]; needed with ``field``.
    """
    goal = jnp.asarray(goal)
    cost = pose_distance(goal, traj.object_pose[..., -1, :], cfg.yaw_weight)
    cost = cost + cfg.effort * effort(controls) + cfg.change * change(controls, last_u)
    if cfg.running_weight:
        distance = pose_distance(goal, _time_first(traj.object_pose), cfg.yaw_weight)
        cost = cost + cfg.running_weight * _mean(distance)
    if cfg.clearance_weight and field is not None:
        if half_extents is None:
            raise ValueError("the clearance term needs the object's half_extents")
        cost = cost + cfg.clearance_weight * clearance_penalty(cfg, traj, field, half_extents)
    if cfg.lateral_weight or cfg.heading_weight:
        lateral, heading = face_misalignment(traj)
        cost = cost + cfg.lateral_weight * lateral + cfg.heading_weight * heading
    if cfg.aim_weight:
        cost = cost + cfg.aim_weight * aim_error(goal, traj, with_yaw=cfg.yaw_weight > 0)
    if cfg.speed_weight:
        cost = cost + cfg.speed_weight * terminal_speed(traj)
    if cfg.overspeed_weight:
        distance = pose_distance(goal, _time_first(traj.object_pose), 0.0)
        cost = cost + cfg.overspeed_weight * overspeed(traj, allowed_speed(cfg, distance))
    return cost
