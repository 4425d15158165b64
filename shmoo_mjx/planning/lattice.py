"""Sparse lattice for path search: one point in each block of cells, connected by straight lines.

A map with 0.05 m cells has sixteen times as many cells as blocks of 0.2 m. Each point is the cheapest cell of its
block, so narrow passages keep their points. Line costs come from the distance field. SciPy's Dijkstra finds the paths.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from shmoo_mjx.arrays import Bool, Float, Int
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.footprints import window_near
from shmoo_mjx.planning.line_costs import DiscSpace, line_costs

_SPACING = 0.30
"""Largest block size of the lattice [m]; a block is at least one cell."""
_POINTS = 5000
"""Target number of points, from which the block size follows. More points are slower to search."""
_HALF = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Offsets (rows, columns) of the connected neighbour blocks. The other four are the same lines reversed."""
_TIGHT = 2.0
"""Cost factor of a line whose clearance is less than the radius, by half a cell at most."""


class Lattice(NamedTuple):
    """The graph of one `DiscSpace` with N points and E directed lines."""

    cells: Int[np.ndarray, "N 2"]
    """(row, column) of each point."""
    number: Int[np.ndarray, "BH BW"]
    """Index of the point in each block, or -1."""
    side: int
    """Side of a block [cells]."""
    graph: sparse.csr_matrix
    """``[N, N]`` costs of the lines [m, weighted near walls]; infinite where a line is blocked."""


def build(space: DiscSpace) -> Lattice:
    """Builds the lattice of a disc's space."""
    side = _side(space)
    blocks = tuple(-(-n // side) for n in np.shape(space.clearance.values))
    has_point, cells = _points(space, (slice(0, blocks[0]), slice(0, blocks[1])), side)
    number = np.where(has_point, np.cumsum(has_point).reshape(has_point.shape) - 1, -1)
    cells = cells[has_point]
    starts, ends = _neighbours(number)
    cost = _line_costs(cells[starts], cells[ends], space)
    pairs = (np.concatenate([starts, ends]), np.concatenate([ends, starts]))
    order = np.lexsort(pairs[::-1])
    counts = np.bincount(pairs[0], minlength=len(cells))
    graph = sparse.csr_matrix(
        (np.tile(cost, 2)[order], pairs[1][order], np.concatenate([[0], np.cumsum(counts)])),
        shape=(len(cells), len(cells)),
    )
    return Lattice(cells, number, side, graph)


def _side(space: DiscSpace) -> int:
    """Side of a block [cells]: small on a small map, where many points are cheap, and up to _SPACING on a large one."""
    usable = int(np.count_nonzero(np.asarray(space.clearance.values) >= space.radius))
    wanted = int(np.ceil(np.sqrt(usable / _POINTS)))
    return max(1, min(wanted, round(_SPACING / space.resolution)))


def with_obstacles(
    lattice: Lattice, space: DiscSpace, polygons: Sequence[shapely.Polygon]
) -> tuple[Lattice, Bool[np.ndarray, "N"]]:
    """Updates a lattice for ``space``, which is the lattice's own space with the polygons added.

    Returns:
        The new lattice, and a mask of the points with a changed line.
    """
    cells, data = lattice.cells.copy(), lattice.graph.data.copy()
    touched = np.zeros(len(cells), dtype=bool)
    for polygon in polygons:
        blocks = _blocks_near(lattice, space.clearance, polygon, space.radius + space.cfg.soft_clearance)
        number = lattice.number[blocks]
        chosen = _points(space, blocks, lattice.side)[1]
        cells[number[number >= 0]] = chosen[number >= 0]
        touched[number[number >= 0]] = True
    graph = lattice.graph
    edges = np.flatnonzero(np.repeat(touched, np.diff(graph.indptr)))
    starts = np.searchsorted(graph.indptr, edges, side="right") - 1
    data[edges] = _line_costs(cells[starts], cells[graph.indices[edges]], space)
    changed = np.zeros(len(cells), dtype=bool)
    changed[starts[~np.isclose(data[edges], graph.data[edges], rtol=1e-9)]] = True
    graph = sparse.csr_matrix((data, graph.indices, graph.indptr), shape=graph.shape)
    return Lattice(cells, lattice.number, lattice.side, graph), changed


def costs_from(lattice: Lattice, point: int) -> tuple[Float[np.ndarray, "N"], Int[np.ndarray, "N"]]:
    """Cost of the cheapest path between each point and ``point``, and the next point on that path (or < 0)."""
    return dijkstra(lattice.graph, indices=point, return_predecessors=True)


def nodes_in(lattice: Lattice, window: tuple[slice, slice]) -> Int[np.ndarray, "M"]:
    """Indices of the points in a window of cells."""
    side = lattice.side
    blocks = tuple(slice(part.start // side, -(-part.stop // side)) for part in window)
    number = lattice.number[blocks]
    number = number[number >= 0]
    low, high = (np.array([getattr(part, end) for part in window]) for end in ("start", "stop"))
    cells = lattice.cells[number]
    return number[((cells >= low) & (cells < high)).all(axis=1)]


def _points(
    space: DiscSpace, blocks: tuple[slice, slice], side: int
) -> tuple[Bool[np.ndarray, "h w"], Int[np.ndarray, "h w 2"]]:
    """Which blocks have a point, and the cells (row, column) of the points."""
    values = np.asarray(space.clearance.values)[tuple(slice(b.start * side, b.stop * side) for b in blocks)]
    h, w = (b.stop - b.start for b in blocks)
    padded = np.zeros((h * side, w * side))
    padded[: values.shape[0], : values.shape[1]] = values
    inner = padded.reshape(h, side, w, side).swapaxes(1, 2).reshape(h, w, side * side)
    offset = np.stack(np.divmod(np.arange(side * side), side), axis=-1)
    from_middle = np.hypot(*(offset - (side - 1) / 2).T) / side
    # If a whole block costs the same, its middle is chosen: evenly spaced points give the straightest paths.
    score = np.where(inner >= space.radius, space.metre_cost(inner) + 0.5 * from_middle, np.inf)
    best = score.argmin(axis=-1)
    corner = np.stack(np.meshgrid(*(np.arange(b.start, b.stop) * side for b in blocks), indexing="ij"), axis=-1)
    return np.isfinite(score.min(axis=-1)), corner + offset[best]


def _neighbours(number: Int[np.ndarray, "BH BW"]) -> tuple[Int[np.ndarray, "P"], Int[np.ndarray, "P"]]:
    """Pairs of points in neighbouring blocks. Each pair occurs once."""
    height, width = number.shape
    pairs = []
    for rows, cols in _HALF:
        here = number[: height - rows, max(0, -cols) : width - max(0, cols)]
        there = number[rows:, max(0, cols) : width + min(0, cols)]
        both = (here >= 0) & (there >= 0)
        pairs.append((here[both], there[both]))
    starts, ends = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return starts, ends


def _line_costs(
    starts: Int[np.ndarray, "M 2"], ends: Int[np.ndarray, "M 2"], space: DiscSpace
) -> Float[np.ndarray, "M"]:
    """Costs [m] of lines between cells; infinite where a line is blocked."""
    if not len(starts):
        return np.zeros(0)
    lowest, cost = line_costs(starts.astype(float), ends.astype(float), space)
    tight = is_tight(starts, ends, lowest, space.radius)
    cost[tight] *= _TIGHT
    # Between cell centres with enough clearance the interpolated value may be up to half a cell lower.
    cost[tight & (lowest < space.radius - 0.5 * space.resolution)] = np.inf
    values = np.asarray(space.clearance.values)
    cost[np.minimum(values[tuple(starts.T)], values[tuple(ends.T)]) < space.radius] = np.inf
    return cost


def is_tight(
    starts: Int[np.ndarray, "M 2"], ends: Int[np.ndarray, "M 2"], lowest: Float[np.ndarray, "M"], radius: float
) -> Bool[np.ndarray, "M"]:
    """Mask of lines between cells with less clearance than the radius. Neighbouring cells count as connected."""
    return (lowest < radius - 1e-9) & (np.abs(ends - starts).max(axis=1) > 1)


def _blocks_near(
    lattice: Lattice, clearance: DistanceField, polygon: shapely.Polygon, reach: float
) -> tuple[slice, slice]:
    """Blocks whose points or lines a polygon may change, and their neighbours."""
    side, shape = lattice.side, lattice.number.shape
    cells = window_near(clearance, polygon, reach)
    rows, cols = (
        slice(min(max(part.start // side - 1, 0), n), min(-(-part.stop // side) + 1, n))
        for part, n in zip(cells, shape, strict=True)
    )
    return rows, cols
