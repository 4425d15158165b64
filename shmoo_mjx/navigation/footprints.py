"""Rectangular footprints of objects: as polygons, in clearance fields and maps, and against walls and paths."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import shapely

from shmoo_mjx import se2
from shmoo_mjx.navigation.maps import OCCUPIED, ClearanceField, OccupancyGrid

__all__ = ["add_obstacles", "footprint_corners", "footprint_polygon", "footprints_free", "register_obstacles"]

Array = Any

_SIGNS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def footprint_corners(poses: Array, half_extents: Array) -> np.ndarray:
    """Corners ``[..., 4, 2]`` in {W} of rectangles at ``poses [..., 3]`` with ``half_extents`` (2,) along {O} [m]."""
    poses = np.asarray(poses, dtype=float)
    return se2.transform_point(poses[..., None, :], np.asarray(half_extents, dtype=float) * _SIGNS)


def footprint_polygon(pose: Array, half_extents: Array) -> shapely.Polygon:
    """The footprint in {W} of a rectangle at ``pose`` (3,) with ``half_extents`` (2,) along {O} [m]."""
    return shapely.Polygon(footprint_corners(pose, half_extents))


def add_obstacles(field: ClearanceField, polygons: Iterable[shapely.Polygon], reach: float = 1.5) -> ClearanceField:
    """The clearance field [m] with the distance to ``polygons`` (footprints in {W}) taken into account.

    Exact up to ``reach`` [m] from a polygon; farther away the polygon is not looked at.
    """
    frame = OccupancyGrid(np.zeros(np.shape(field.values), np.int8), float(field.resolution), tuple(field.origin))
    values = np.array(field.values)
    for polygon in polygons:
        rows, cols = _cells_near(frame, polygon, reach)
        centres = frame.cell_to_world(np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1))
        distance = shapely.distance(polygon, shapely.points(centres))
        window = np.ix_(rows, cols)
        values[window] = np.minimum(values[window], np.where(distance < reach, distance, np.inf))
    return field._replace(values=values)


def register_obstacles(grid: OccupancyGrid, polygons: Iterable[shapely.Polygon]) -> OccupancyGrid:
    """The map with every cell that a polygon touches marked occupied (Algorithm 1, "register as obstacle on M")."""
    cells = grid.cells.copy()
    half = grid.resolution / 2
    for polygon in polygons:
        rows, cols = _cells_near(grid, polygon, grid.resolution)
        centres = grid.cell_to_world(np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1))
        squares = shapely.polygons(footprint_corners(_with_yaw(centres, grid.origin[2]), (half, half)))
        window = np.ix_(rows, cols)
        cells[window] = np.where(shapely.intersects(polygon, squares), OCCUPIED, cells[window])
    return replace(grid, cells=cells)


def footprints_free(
    field: ClearanceField,
    poses: Array,
    half_extents: Array,
    path: Array | None = None,
    path_clearance: float = 0.0,
    wall_clearance: float = 0.0,
) -> np.ndarray:
    """Which placements of a rectangle touch neither walls nor the path; the whole footprint is looked at.

    Args:
        field: distance to walls, unknown cells and registered obstacles [m].
        poses: ``[N, 3]`` in {W}.
        half_extents: (2,) half sizes along {O} [m].
        path: ``[M, 2]`` polyline in {W}, or None.
        path_clearance: distance that must be left between footprint and path [m].
        wall_clearance: distance that must be left between footprint and walls [m].

    Returns:
        bool ``[N]``.
    """
    poses = np.atleast_2d(np.asarray(poses, dtype=float))
    resolution = float(field.resolution)
    samples = _lattice(np.asarray(half_extents, dtype=float), resolution)
    points = se2.transform_point(poses[:, None, :], samples)
    # At a wall's face the bilinear look-up reads a quarter of a cell: half a cell at the free centre, zero in the wall.
    free = (field.at(points) >= max(wall_clearance, 0.25 * resolution)).all(axis=1)
    if path is None or not free.any():
        return free
    line = shapely.LineString(np.asarray(path, dtype=float))
    rectangles = shapely.polygons(footprint_corners(poses[free], half_extents))
    free[free] = shapely.distance(rectangles, line) >= path_clearance
    return free


def _lattice(half_extents: np.ndarray, spacing: float) -> np.ndarray:
    """Points ``[P, 2]`` that fill a rectangle, edges included, at most ``spacing`` apart."""
    axes = [np.linspace(-h, h, max(2, int(np.ceil(2 * h / spacing)) + 1)) for h in half_extents]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def _cells_near(grid: OccupancyGrid, polygon: shapely.Polygon, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the part of the map within ``reach`` of the polygon's bounding box."""
    x0, y0, x1, y1 = polygon.bounds
    corners = np.array([[x0, y0], [x1, y0], [x0, y1], [x1, y1]])
    cells = grid.world_to_cell(corners)
    pad = int(np.ceil(reach / grid.resolution)) + 1
    low = np.maximum(cells.min(axis=0) - pad, 0)
    high = np.minimum(cells.max(axis=0) + pad + 1, grid.cells.shape)
    return np.arange(low[0], max(low[0], high[0])), np.arange(low[1], max(low[1], high[1]))


def _with_yaw(points: np.ndarray, yaw: float) -> np.ndarray:
    return np.concatenate([points, np.full((*points.shape[:-1], 1), yaw)], axis=-1)
