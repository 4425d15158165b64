"""Path search through a distance field: on a lattice where possible, cell by cell where necessary.

Both ends of a path, where the robot may stand too near to an obstacle, are searched cell by cell in a small window. The
part between them is searched on the lattice. If the lattice has no path that certainly keeps the radius, all cells are
searched. So a path is found exactly if one exists on the cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely
from scipy.ndimage import label
from skimage.graph import MCP_Geometric

from shmoo_mjx.arrays import Bool, Float, Int
from shmoo_mjx.planning import lattice as lattices
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.lattice import Lattice
from shmoo_mjx.planning.line_costs import DiscSpace, line_costs

_ESCAPE_RADIUS = 0.35
"""Radius around a start that is too near to a wall [m]. Within it, cells that are no nearer to a wall may be used. It
is the robot's radius plus a margin."""
_KEPT = 8
"""Number of shortest-path trees that are cached for each lattice."""


class _Query(NamedTuple):
    """A path query."""

    space: DiscSpace
    start: Float[np.ndarray, "2"]
    """Start position in {W} [m]."""
    goal: Float[np.ndarray, "2"]
    """Goal position in {W} [m]."""

    def cell(self, point: Float[np.ndarray, "2"]) -> tuple[int, int]:
        """(row, column) of the cell that contains the point."""
        row, col = np.floor(self.space.clearance.to_cells(point) + 0.5).astype(int)
        return int(row), int(col)


class _Ways(NamedTuple):
    """Data shared by queries with the same walls."""

    lattice: Lattice
    trees: dict[int, tuple[Float[np.ndarray, "N"], Int[np.ndarray, "N"]]]
    """Recent results of ``costs_from`` by their root point, for walls only."""

    def tree(self, root: int) -> tuple[Float[np.ndarray, "N"], Int[np.ndarray, "N"]]:
        """``costs_from`` the point ``root``, cached."""
        if root not in self.trees:
            while len(self.trees) >= _KEPT:
                del self.trees[next(iter(self.trees))]
            self.trees[root] = lattices.costs_from(self.lattice, root)
        return self.trees[root]


class _Window(NamedTuple):
    """Cell-by-cell paths from one end of the query to the cells around it."""

    parts: tuple[slice, slice]
    search: MCP_Geometric
    cost: Float[np.ndarray, "h w"]
    """Cost from that end [m, weighted near walls]."""

    @property
    def corner(self) -> Int[np.ndarray, "2"]:
        return np.array([part.start for part in self.parts])

    def costs_at(self, cells: Int[np.ndarray, "M 2"]) -> Float[np.ndarray, "M"]:
        """Cost of the cheapest path to ``cells`` of the window."""
        rows, cols = (cells - self.corner).T
        return self.cost[rows, cols]

    def way_to(self, cell: Int[np.ndarray, "2"]) -> Int[np.ndarray, "K 2"]:
        """Cells of that path, from the end outwards."""
        return np.array(self.search.traceback(tuple(np.asarray(cell) - self.corner))) + self.corner


def cell_costs(space: DiscSpace, parts: tuple[slice, ...] = (slice(None), slice(None))) -> Float[np.ndarray, "h w"]:
    """Cost per metre of each cell in ``parts`` (rows, columns; default all); -1 where the disc does not fit."""
    values = np.asarray(space.clearance.values)[parts]
    return np.where(values >= space.radius, space.metre_cost(values), -1.0)


def find_way(
    start: Float[np.ndarray, "2"],
    goal: Float[np.ndarray, "2"],
    space: DiscSpace,
    *,
    wall_clearance: DistanceField,
    obstacles: Sequence[shapely.Polygon],
) -> Int[np.ndarray, "N 2"] | None:
    """A cheapest or nearly cheapest path of a disc from start to goal as cells, or None if there is none.

    Args:
        start: position in {W} [m], on the map.
        goal: position in {W} [m], on the map.
        space: the disc with the clearance that includes the obstacles.
        wall_clearance: distance to walls alone; its ``memo`` caches derived data.
        obstacles: footprints in {W}.

    Returns:
        (row, column) of each cell. Consecutive cells are adjacent, or are lattice points with a clear line between
        them.
    """
    task = _Query(space, start, goal)
    ways = _ways_past(space._replace(clearance=wall_clearance))
    near_start, near_goal = (_window(task, end, ways.lattice.side) for end in (start, goal))
    if near_start is None or near_goal is None:
        return None
    cells = _on_lattice(task, ways, obstacles, near_start=near_start, near_goal=near_goal)
    return _cell_by_cell(task) if cells is None else cells


def _ways_past(walls: DiscSpace) -> _Ways:
    """Shared data for these walls. It is cached in the distance field's memo if the field is read-only."""
    field, key = walls.clearance, ("ways", walls.radius, walls.cfg)
    if not field.constant:
        return _Ways(lattices.build(walls), {})
    if key not in field.memo:
        field.memo[key] = _Ways(lattices.build(walls), {})
    return field.memo[key]


def _window(task: _Query, end: Float[np.ndarray, "2"], side: int) -> _Window | None:
    """Paths from one end of the query to all cells near it; None if the disc does not fit at that end."""
    cell, resolution = task.cell(end), task.space.resolution
    half = max(int(np.ceil(_ESCAPE_RADIUS / resolution)), 2 * side) + 2
    shape = np.shape(task.space.clearance.values)
    rows, cols = (slice(max(c - half, 0), min(c + half + 1, n)) for c, n in zip(cell, shape, strict=True))
    parts = (rows, cols)
    costs = _opened_costs(task, parts)
    local = tuple(c - part.start for c, part in zip(cell, parts, strict=True))
    if costs[local] < 0:
        return None
    search = MCP_Geometric(costs)
    total, _ = search.find_costs([local])
    return _Window(parts, search, total * resolution)


def _opened_costs(task: _Query, parts: tuple[slice, slice]) -> Float[np.ndarray, "h w"]:
    """Cell costs in ``parts``, with additional cells opened near the start and at the goal."""
    (clearance, radius, cfg), resolution = task.space, task.space.resolution
    costs = cell_costs(task.space, parts)
    last = tuple(c - part.start for c, part in zip(task.cell(task.goal), parts, strict=True))
    inside = all(0 <= c < n for c, n in zip(last, costs.shape, strict=True))
    if inside and costs[last] < 0 and float(clearance.at(task.goal)) >= radius:
        costs[last] = 1.0 + cfg.soft_weight  # the point has enough clearance although its cell's centre does not
    here = float(clearance.at(task.start))
    if here >= radius + resolution:
        return costs
    # A robot that is too near to an obstacle must be able to leave, but not through an even narrower place.
    rows, cols = np.mgrid[parts]
    row, col = clearance.to_cells(task.start)
    values = np.asarray(clearance.values)[parts]
    near = np.hypot(rows - row, cols - col) * resolution <= _ESCAPE_RADIUS + resolution
    usable = near & (values > 0) & (values >= min(here, radius) - 0.5 * resolution)
    return np.where(usable & (costs < 0), 10.0 * (1.0 + cfg.soft_weight), costs)


def _on_lattice(
    task: _Query, ways: _Ways, obstacles: Sequence[shapely.Polygon], *, near_start: _Window, near_goal: _Window
) -> Int[np.ndarray, "K 2"] | None:
    """Cells of the cheapest path over the lattice; None if no path certainly keeps the radius."""
    lattice, changed = ways.lattice, np.zeros(len(ways.lattice.cells), dtype=bool)
    if obstacles:
        lattice, changed = lattices.with_obstacles(lattice, task.space, obstacles)
    entries, exits = (_entries(lattice, window) for window in (near_start, near_goal))
    direct_cost, direct = _direct(task, near_start)
    if not len(entries[0]) or not len(exits[0]):
        return direct
    root = int(exits[0][np.argmin(exits[1])])
    cost, route = _route(ways, lattice, changed, entries=entries, root=root)
    if direct_cost <= cost + exits[1].min():
        return direct
    if len(route) == 0 or _is_tight(task, lattice.cells[route]):
        return None
    first, last = lattice.cells[route[0]], lattice.cells[route[-1]]
    return np.concatenate([near_start.way_to(first)[:-1], lattice.cells[route], near_goal.way_to(last)[-2::-1]])


def _entries(lattice: Lattice, window: _Window) -> tuple[Int[np.ndarray, "M"], Float[np.ndarray, "M"]]:
    """Lattice points reachable within a window, and the cost of reaching them."""
    numbers = lattices.nodes_in(lattice, window.parts)
    cost = window.costs_at(lattice.cells[numbers])
    return numbers[np.isfinite(cost)], cost[np.isfinite(cost)]


def _direct(task: _Query, near_start: _Window) -> tuple[float, Int[np.ndarray, "K 2"] | None]:
    """Cost and cells of the path that stays in the start's window; infinite and None if there is none."""
    last = np.array(task.cell(task.goal))
    inside = ((last >= near_start.corner) & (last < near_start.corner + near_start.cost.shape)).all()
    cost = float(near_start.costs_at(last[None])[0]) if inside else np.inf
    return cost, near_start.way_to(last) if np.isfinite(cost) else None


def _route(
    ways: _Ways,
    lattice: Lattice,
    changed: Bool[np.ndarray, "N"],
    *,
    entries: tuple[Int[np.ndarray, "M"], Float[np.ndarray, "M"]],
    root: int,
) -> tuple[float, Int[np.ndarray, "K"]]:
    """Cost [m] of the cheapest path from the start through an entry point to ``root``, and its points."""
    if not changed.any():
        return _follow(ways.tree(root), entries)
    if root in ways.trees:
        cost, route = _follow(ways.trees[root], entries)
        if len(route) and not changed[route].any():
            # Obstacles only raise the cost of lines, so an unchanged path is still the cheapest.
            return cost, route
    return _follow(lattices.costs_from(lattice, root), entries)


def _follow(
    tree: tuple[Float[np.ndarray, "N"], Int[np.ndarray, "N"]],
    entries: tuple[Int[np.ndarray, "M"], Float[np.ndarray, "M"]],
) -> tuple[float, Int[np.ndarray, "K"]]:
    total, following = tree
    cost = entries[1] + total[entries[0]]
    best = int(np.argmin(cost))
    if not np.isfinite(cost[best]):
        return np.inf, np.empty(0, dtype=int)
    route = [int(entries[0][best])]
    while following[route[-1]] >= 0:
        route.append(int(following[route[-1]]))
    return float(cost[best]), np.array(route)


def _is_tight(task: _Query, cells: Int[np.ndarray, "K 2"]) -> bool:
    """Whether a line of the route has less clearance than the radius, by half a cell at most."""
    if len(cells) < 2:
        return False
    starts, ends = cells[:-1], cells[1:]
    lowest, _ = line_costs(starts.astype(float), ends.astype(float), task.space)
    return bool(lattices.is_tight(starts, ends, lowest, task.space.radius).any())


def _cell_by_cell(task: _Query) -> Int[np.ndarray, "K 2"] | None:
    """The cheapest path over all cells of the map."""
    height, width = np.shape(task.space.clearance.values)
    costs = _opened_costs(task, (slice(0, height), slice(0, width)))
    first, last = task.cell(task.start), task.cell(task.goal)
    connected, _ = label(costs > 0, np.ones((3, 3)))
    if connected[first] != connected[last]:
        return None
    search = MCP_Geometric(costs)
    search.find_costs([first], [last])
    return np.array(search.traceback(last))
