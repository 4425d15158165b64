"""Rectangular footprints of objects: polygons, clearance fields with obstacles, and collision checks."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import shapely

from shmoo_mjx.arrays import Array, Bool, Float, Int, Numbers, Scalar
from shmoo_mjx.geometry import se2
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.maps import OccupancyGrid

_KEPT = 4
"""Number of cached fields with obstacles. There are few objects, and each is queried with and without."""
_SIGNS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def footprint_corners(
    poses: Numbers | Float[Array, "*b 3"], half_extents: Numbers | Float[Array, "2"]
) -> Float[np.ndarray, "*b 4 2"]:
    """Corners in {W} of rectangles at ``poses`` with ``half_extents`` along {O} [m]."""
    poses = np.asarray(poses, dtype=float)
    return se2.transform_point(poses[..., None, :], np.asarray(half_extents, dtype=float) * _SIGNS)


def footprint_polygon(pose: Numbers | Float[Array, "3"], half_extents: Numbers | Float[Array, "2"]) -> shapely.Polygon:
    """Footprint polygon in {W} of a rectangle at ``pose`` with ``half_extents`` along {O} [m]."""
    return shapely.Polygon(footprint_corners(pose, half_extents))


def wall_distance(grid: OccupancyGrid, shape: shapely.Geometry, reach: float) -> float:
    """Distance [m] from a shape in {W} to the area of the nearest cell that is not free.

    Zero if they touch. Infinite if no such cell on the map is within ``reach`` [m].
    """
    corners = shapely.get_coordinates(shape.envelope.buffer(reach + grid.resolution, join_style="mitre"))
    local = se2.inverse_transform_point(np.asarray(grid.origin), corners) / grid.resolution
    low = np.clip(np.floor(local.min(axis=0)).astype(int), 0, grid.cells.shape[::-1])
    high = np.clip(np.ceil(local.max(axis=0)).astype(int), low, grid.cells.shape[::-1])
    cells = np.argwhere(~grid.free[low[1] : high[1], low[0] : high[0]]) + low[::-1]
    squares = grid.cell_to_world(cells[:, None] + 0.5 * _SIGNS)
    distance = shapely.distance(shape, shapely.polygons(squares)).min(initial=np.inf)
    return float(distance) if distance <= reach else float("inf")


def add_obstacles(clearance: DistanceField, polygons: Iterable[shapely.Polygon], reach: float = 1.5) -> DistanceField:
    """Adds the distance to ``polygons`` (footprints in {W}) to the clearance field [m].

    Exact up to ``reach`` [m] from a polygon. Farther away the polygon is ignored. Results are cached per field and
    polygons, because every tick asks for the same ones while objects stand still.
    """
    polygons = tuple(polygons)
    if not polygons:
        return clearance
    if not clearance.constant:
        return _with_obstacles(clearance, polygons, reach)
    kept: dict[Any, DistanceField] = clearance.memo.setdefault("obstacles", {})
    key = (reach, *(polygon.wkb for polygon in polygons))
    if key not in kept:
        while len(kept) >= _KEPT:
            del kept[next(iter(kept))]
        kept[key] = _with_obstacles(clearance, polygons, reach)
    return kept[key]


def _with_obstacles(clearance: DistanceField, polygons: tuple[shapely.Polygon, ...], reach: float) -> DistanceField:
    values = np.array(clearance.values)
    for polygon in polygons:
        window = window_near(clearance, polygon, reach)
        distance = polygon_distance(polygon, clearance.to_world(np.moveaxis(np.mgrid[window], 0, -1)))
        np.minimum(values[window], distance, out=values[window], where=distance < reach)
    values.flags.writeable = False
    return clearance._replace(values=values)


def window_near(clearance: DistanceField, polygon: shapely.Polygon, reach: float) -> tuple[slice, slice]:
    """Rows and columns of the part of the field within ``reach`` [m] of the polygon's bounding box."""
    cells = np.floor(clearance.to_cells(_bounding_corners(polygon)) + 0.5).astype(int)
    return _window(cells, int(np.ceil(reach / float(clearance.resolution))) + 1, np.shape(clearance.values))


def polygon_distance(polygon: shapely.Polygon, points: Float[np.ndarray, "*p 2"]) -> Scalar | Float[np.ndarray, "*p"]:
    """Distance [m] from ``points`` in {W} to a polygon, zero inside. Fast for convex polygons."""
    corners = _convex_corners(polygon)
    if corners is None:
        return shapely.distance(polygon, shapely.points(points))
    flat = points.reshape(-1, 2)
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.hypot(*sides.T)
    along = sides / lengths[:, None]
    outward = np.stack([along[:, 1], -along[:, 0]], axis=-1)
    # The nearest point of the polygon lies on the side from whose line the point is farthest outwards, or at its end.
    side = np.argmax(flat @ outward.T - np.einsum("ij,ij->i", outward, corners), axis=1)
    offset = flat - corners[side]
    off = np.einsum("ij,ij->i", offset, outward[side])
    beside = np.einsum("ij,ij->i", offset, along[side])
    beyond = beside - np.minimum(np.maximum(beside, 0.0), lengths[side])
    return np.where(off > 0, np.hypot(off, beyond), 0.0).reshape(points.shape[:-1])


def _convex_corners(polygon: shapely.Polygon) -> Float[np.ndarray, "E 2"] | None:
    """Corners in anticlockwise order without duplicates; None if the polygon is not convex or has holes."""
    ring = np.asarray(polygon.exterior.coords)[:, :2]
    ring = ring[:-1][np.hypot(*np.diff(ring, axis=0).T) > 1e-9]
    if len(ring) < 3 or len(polygon.interiors):
        return None
    sides = np.roll(ring, -1, axis=0) - ring
    following = np.roll(sides, -1, axis=0)
    turns = sides[:, 0] * following[:, 1] - sides[:, 1] * following[:, 0]
    if (turns >= -1e-12).all():
        return ring
    return ring[::-1] if (turns <= 1e-12).all() else None


def footprints_free(
    clearance: DistanceField,
    poses: Numbers | Float[Array, "3"] | Float[Array, "N 3"],
    half_extents: Numbers | Float[Array, "2"],
    path: Float[Array, "M 2"] | None = None,
    *,
    path_clearance: float = 0.0,
    wall_clearance: float = 0.0,
) -> Bool[np.ndarray, "N"]:
    """Mask of the placements whose whole footprint is clear of walls and of the path.

    Args:
        clearance: distance to walls, unknown cells and registered obstacles [m].
        poses: one or more poses in {W}.
        half_extents: half sizes along {O} [m].
        path: polyline in {W}, or None.
        path_clearance: required distance between footprint and path [m].
        wall_clearance: required distance between footprint and walls [m].
    """
    poses = np.atleast_2d(np.asarray(poses, dtype=float))
    resolution = float(clearance.resolution)
    samples = _lattice(np.asarray(half_extents, dtype=float), resolution)
    points = se2.transform_point(poses[:, None, :], samples)
    # At a wall's face the interpolated value is a quarter of a cell: half a cell at the free centre, zero in the wall.
    free = (clearance.at(points) >= max(wall_clearance, 0.25 * resolution)).all(axis=1)
    if path is None or not free.any():
        return free
    line = shapely.LineString(np.asarray(path, dtype=float))
    rectangles = shapely.polygons(footprint_corners(poses[free], half_extents))
    free[free] = shapely.distance(rectangles, line) >= path_clearance
    return free


def _lattice(half_extents: Float[np.ndarray, "2"], spacing: float) -> Float[np.ndarray, "P 2"]:
    """Grid of points that fills a rectangle, edges included, with a spacing of at most ``spacing``."""
    axes = [np.linspace(-h, h, max(2, int(np.ceil(2 * h / spacing)) + 1)) for h in half_extents]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def _bounding_corners(polygon: shapely.Polygon) -> Float[np.ndarray, "4 2"]:
    x0, y0, x1, y1 = polygon.bounds
    return np.array([[x0, y0], [x1, y0], [x0, y1], [x1, y1]])


def _window(cells: Int[np.ndarray, "N 2"], pad: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns that contain ``cells`` (row, column) and a border of ``pad`` cells, clipped to the map."""
    low = np.clip(cells.min(axis=0) - pad, 0, shape)
    high = np.maximum(np.minimum(cells.max(axis=0) + pad + 1, shape), low)
    return slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))
