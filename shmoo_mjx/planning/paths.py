"""Global paths for a disc-shaped robot: minimum-cost search on the distance field, and path geometry.

The cell search uses scikit-image's ``MCP_Geometric`` with Euclidean step costs. The cost per metre rises near walls, so
paths stay in the middle where there is room. The path is then shortened where that does not raise its cost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from skimage.graph import MCP_Geometric

from shmoo_mjx.arrays import Array, Float, Numbers, Scalar
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.footprints import add_obstacles
from shmoo_mjx.planning.line_costs import DiscSpace, PathConfig
from shmoo_mjx.planning.maps import OccupancyGrid, distance_field
from shmoo_mjx.planning.path_search import cell_costs, find_way
from shmoo_mjx.planning.path_shortening import shorten


@dataclass(frozen=True, eq=False)
class Path:
    """A polyline on the floor."""

    points: Float[np.ndarray, "N 2"]
    """Vertices in {W} [m], N >= 2."""
    length: float
    """Total length [m]."""

    @cached_property
    def along(self) -> Float[np.ndarray, "N"]:
        """Arc length [m] from the first point to each point."""
        return arc_lengths(self.points)


def plan_path(
    grid: OccupancyGrid,
    start: Numbers | Float[Array, "2"],
    goal: Numbers | Float[Array, "2"],
    obstacles: Sequence[shapely.Polygon] = (),
    *,
    robot_radius: float = 0.25,
    cfg: PathConfig = PathConfig(),  # noqa: B008  (frozen)
    wall_clearance: DistanceField | None = None,
) -> Path | None:
    """The cheapest collision-free path of a disc, or None if there is none.

    Args:
        grid: the map; unknown cells count as walls.
        start: position in {W} [m].
        goal: position in {W} [m].
        obstacles: footprints in {W} that the path avoids like walls.
        robot_radius: radius of the disc, margin included [m].
        cfg: cost of driving near walls.
        wall_clearance: ``distance_field(grid)``, if the caller already has it.

    Returns:
        The path from start to goal. Every point keeps ``robot_radius`` from walls and obstacles, up to the map's
        discretisation, except near a start that is itself too close.
    """
    start, goal = np.asarray(start, dtype=float)[:2], np.asarray(goal, dtype=float)[:2]
    if not grid.inside(grid.world_to_cell(np.stack([start, goal]))).all():
        return None
    walls, obstacles = wall_clearance if wall_clearance is not None else distance_field(grid), tuple(obstacles)
    # Beyond this distance a polygon adds no cost. Two extra cells cover the interpolation between cell centres.
    clearance = add_obstacles(walls, obstacles, robot_radius + cfg.soft_clearance + 2 * float(walls.resolution))
    space = DiscSpace(clearance, robot_radius, cfg)
    cells = find_way(start, goal, space, wall_clearance=walls, obstacles=obstacles)
    if cells is None:
        return None
    points = shorten(np.vstack([start, clearance.to_world(cells[1:-1]), goal]), space)
    return Path(points, path_length(points))


def cost_to_go(
    grid: OccupancyGrid,
    goal: Numbers | Float[Array, "2"],
    obstacles: Sequence[shapely.Polygon] = (),
    *,
    robot_radius: float = 0.25,
    cfg: PathConfig = PathConfig(),  # noqa: B008  (frozen)
) -> Float[np.ndarray, "H W"]:
    """Cost of the cheapest path from each cell's centre to the goal [m, weighted near walls].

    Infinite where no path exists. With ``soft_weight = 0`` it is the length of the shortest 8-connected path [m].
    """
    costs = cell_costs(DiscSpace(add_obstacles(distance_field(grid), obstacles), robot_radius, cfg))
    last = grid.world_to_cell(np.asarray(goal, dtype=float)[:2])
    if not grid.inside(last) or costs[tuple(last)] < 0:
        return np.full(grid.cells.shape, np.inf)
    total, _ = MCP_Geometric(costs).find_costs([tuple(last)])
    return np.where(costs < 0, np.inf, total * grid.resolution)


def path_length(points: Float[Array, "N 2"]) -> float:
    """Length [m] of the polyline ``points``."""
    return float(arc_lengths(points)[-1])


def arc_lengths(points: Float[Array, "N 2"]) -> Float[np.ndarray, "N"]:
    """Arc length [m] from the first point to each point of the polyline ``points``."""
    steps = np.linalg.norm(np.diff(np.asarray(points, dtype=float), axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def point_at(path: Path, s: Scalar | Float[Array, "*s"]) -> Float[np.ndarray, "*s 2"]:
    """Points in {W} at arc lengths ``s`` [m]. Values beyond an end return that end."""
    return np.stack([np.interp(s, path.along, path.points[:, i]) for i in range(2)], axis=-1)


def tangent_at(path: Path, s: Scalar | Float[Array, "*s"]) -> Float[np.ndarray, "*s 2"]:
    """Unit direction in {W} of the path at arc lengths ``s`` [m]."""
    along, steps = path.along, np.diff(path.points, axis=0)
    long_enough = np.flatnonzero(np.diff(along) > 1e-9)
    if long_enough.size == 0:
        return np.broadcast_to(np.array([1.0, 0.0]), (*np.shape(s), 2))
    at = np.searchsorted(along[long_enough + 1], np.asarray(s, dtype=float), side="right")
    chosen = steps[long_enough[np.minimum(at, long_enough.size - 1)]]
    return chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)


def project(path: Path, point: Numbers | Float[Array, "2"], after: float = 0.0) -> float:
    """Arc length [m] of the path's point nearest to ``point`` in {W}, at or beyond arc length ``after`` [m]."""
    along, steps = path.along, np.diff(path.points, axis=0)
    lengths = np.diff(along)
    offset = np.asarray(point, dtype=float)[:2] - path.points[:-1]
    fraction = np.einsum("ij,ij->i", offset, steps) / np.maximum(lengths**2, 1e-18)
    earliest = np.clip((after - along[:-1]) / np.maximum(lengths, 1e-12), 0.0, 1.0)
    fraction = np.clip(fraction, earliest, 1.0)
    distance = np.linalg.norm(offset - fraction[:, None] * steps, axis=1)
    distance[along[1:] < min(after, along[-1])] = np.inf
    nearest = int(np.argmin(distance))
    return float(along[nearest] + fraction[nearest] * lengths[nearest])


def path_blocked_by(
    path: Path, polygon: shapely.Polygon, radius: float, after: float = 0.0
) -> tuple[bool, float | None]:
    """Whether a disc that follows the path from arc length ``after`` [m] touches the polygon.

    Args:
        path: the path to follow.
        polygon: obstacle in {W}.
        radius: radius of the disc [m].
        after: arc length at which the disc starts [m].

    Returns:
        (blocked, arc length [m] of the first touch or None).
    """
    ahead = shapely.LineString(_part_after(path, after))
    if ahead.distance(polygon) > radius:
        return False, None
    hit = ahead.intersection(polygon.buffer(max(radius - 1e-6, 0.0), quad_segs=32))
    if hit.is_empty:
        return False, None
    touching = [project(path, xy, after) for xy in shapely.get_coordinates(hit)]
    return True, float(min(touching))


def _part_after(path: Path, s: float) -> Float[np.ndarray, "N 2"]:
    return np.vstack([point_at(path, s), path.points[path.along > s], path.points[-1]])
