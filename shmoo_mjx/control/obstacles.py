"""Clearance between the obstacles of a map and the robot, hands and object of a roll-out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import Protocol, runtime_checkable

import jax.numpy as jnp

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.dynamics.layout import SO2, mean_over_time, once, time_first
from shmoo_mjx.geometry.hands import hand_targets
from shmoo_mjx.types import DT, SystemState

HAND_MARGIN = 0.08
"""Margin of the hands' centres [m]: their radius plus a reserve. Larger keeps the hands farther from obstacles."""


@dataclass(frozen=True)
class Margins:
    """Margins of robot and object to obstacles, and the interval of the look-ups in the map."""

    object: float = 0.10
    """Margin of the object's outline [m]. Larger keeps the object farther from walls."""
    robot: float = 0.30
    """Margin of the robot's centre [m]: its radius plus a reserve, which includes the elbows of extended arms. Larger
    keeps the robot farther from walls."""
    stride: int = 1
    """Number of time steps between two look-ups in the map [1]. The last step is always looked up. Larger is faster and
    can miss narrow walls."""


@runtime_checkable
class DistanceField(Protocol):
    """Distance to the nearest obstacle on a grid. The map's clearance field and any pytree with these fields fit."""

    @property
    def values(self) -> Float[Array, "H W"]:
        """Distances [m]. ``values[j, i]`` is at the centre of cell (i, j), with i along x and j along y of the grid."""

    @property
    def origin(self) -> Float[Array, "3"]:
        """Pose (x, y [m], yaw [rad]) of the grid's corner in {W}, the outer corner of cell (0, 0)."""

    @property
    def resolution(self) -> Scalar:
        """Side of a cell [m]."""


def clearance_at(field: DistanceField, points: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    """Clearance at ``points`` in {W} [m], with bilinear interpolation; zero outside the grid."""
    # A border of zeros puts every look-up on the grid. This avoids the four range checks of `map_coordinates`.
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
    """Corners and edge midpoints in {W} of a rectangle with ``half_extents`` [m] at ``pose`` in {W}."""
    unit = jnp.array([[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]], dtype=float)
    return _placed(pose, unit * jnp.asarray(half_extents))


def clearance_near(field: DistanceField, points: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    """Clearance of the cell that contains each of ``points`` in {W} [m]; zero outside the grid.

    It needs a quarter of the look-ups of :func:`clearance_at` and differs from it by up to 0.7 cells.
    """
    values = jnp.asarray(field.values)
    rows, columns = values.shape
    i, j = (jnp.floor(cells).astype(int) for cells in _on_grid(field, points))
    inside = (i >= 0) & (j >= 0) & (i < columns) & (j < rows)
    cell = jnp.clip(j, 0, rows - 1) * columns + jnp.clip(i, 0, columns - 1)
    return jnp.where(inside, values.ravel()[cell], 0.0)


def hand_points(
    robot_pose: Float[Array, "*batch 3"], gamma: Scalar | Float[Array, "*batch"]
) -> Float[Array, "*batch 2 2"]:
    """Centres of the extended hands (left, right) in {W} [m], for the steering angle ``gamma`` [rad]."""
    return _placed(robot_pose, hand_targets(gamma))


def _placed(pose: Array, points: Array) -> Array:
    """``points [..., P, 2]`` of bodies at ``pose [..., 3]``, in {W}.

    The same as `se2.transform_point`, with one sine and cosine per body instead of one per point.
    """
    turn, x, y = once(SO2.from_angle(pose[..., 2:])), points[..., 0], points[..., 1]
    return jnp.stack([pose[..., :1] + turn.c * x - turn.s * y, pose[..., 1:2] + turn.s * x + turn.c * y], axis=-1)


def _on_grid(field: DistanceField, points: Array) -> tuple[Array, Array]:
    """Column and row ``[...]`` of ``points [..., 2]`` in {W}, in cells from the grid's corner."""
    origin = jnp.asarray(field.origin)
    turn = once(SO2.from_angle(origin[2]))
    x, y = (points[..., 0] - origin[0]) / field.resolution, (points[..., 1] - origin[1]) / field.resolution
    return turn.c * x + turn.s * y, turn.c * y - turn.s * x


def clearance_penalty(
    margins: Margins, traj: SystemState, field: DistanceField, half_extents: Float[Array, "2"]
) -> Float[Array, "..."]:
    """Time integral of the depth by which robot centre, hands and object outline are inside their margins [m s].

    The depth of the object is the largest of its four corners and four edge midpoints. The depth of the hands is the
    larger of the two. The hands are included because they extend beyond the disc of the robot, and in a push around a
    corner they sweep an area that the object has not passed.

    Args:
        margins: margins, and interval of the look-ups.
        traj: roll-outs.
        field: distance to obstacles.
        half_extents: half length and half width of the object's footprint [m].
    """
    steps = traj.robot_pose.shape[-2]
    robot_pose, object_pose, command = (
        time_first(x)[(steps - 1) % margins.stride :: margins.stride]
        for x in (traj.robot_pose, traj.object_pose, traj.last_u)
    )
    robot = clearance_at(field, robot_pose[..., :2])
    outline = footprint_points(object_pose, half_extents)
    thing = _least(clearance_at(field, outline))
    depth = jnp.maximum(margins.robot - robot, 0.0) + jnp.maximum(margins.object - thing, 0.0)
    hands = hand_points(robot_pose, command[..., 2])
    depth = depth + jnp.maximum(HAND_MARGIN - _least(clearance_near(field, hands)), 0.0)
    return mean_over_time(depth) * (steps * DT)


def _least(x: Array) -> Array:
    """Minimum ``[...]`` of ``x [..., P]``, computed element by element because XLA is slow for reductions of few P."""
    return reduce(jnp.minimum, (x[..., i] for i in range(x.shape[-1])))
