"""Shortens grid paths: fewer points, at no higher cost, with the required clearance."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Bool, Float, Int
from shmoo_mjx.planning.line_costs import DiscSpace, line_costs

_ANGLES = np.arange(8) * np.pi / 4
_MOVES = np.vstack([[0.0, 0.0], np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1)])


_AHEAD = np.unique(np.geomspace(1, 1e5, 48).astype(int))
_STEPS = (0.20, 0.06)
"""Distances by which corners are moved, tried in this order [m]."""


def shorten(points: Float[np.ndarray, "N 2"], space: DiscSpace) -> Float[np.ndarray, "M 2"]:
    """Replaces parts of a polyline by straight lines, then moves the remaining corners to reduce the cost.

    Args:
        points: polyline in {W} [m].
        space: the disc and its clearance; straight lines keep its radius.

    Returns:
        A polyline with the same ends, M <= N.
    """
    corners = _pull_taut(space.clearance.to_cells(points), space)
    for step in _STEPS:
        corners = _settle(corners, step / space.resolution, space)
    inner = space.clearance.to_world(corners[1:-1])
    return np.vstack([points[:1], inner, points[-1:]])


def _pull_taut(points: Float[np.ndarray, "N 2"], space: DiscSpace) -> Float[np.ndarray, "M 2"]:
    """The polyline [cells] with straight lines replacing every part that does not cost less."""
    total = np.concatenate([[0.0], np.cumsum(line_costs(points[:-1], points[1:], space)[1])])
    kept, i, n = [0], 0, len(points)
    while i < n - 1:
        ends = _look_ahead(i, n)
        here = np.broadcast_to(points[i], (len(ends), 2))
        lowest, straight = line_costs(here, points[ends], space)
        good = np.flatnonzero((lowest >= space.radius) & (straight <= 1.002 * (total[ends] - total[i])))
        i = int(ends[good[-1]]) if good.size else i + 1
        kept.append(i)
    return points[kept]


def _look_ahead(i: int, n: int) -> Int[np.ndarray, "K"]:
    """Candidate end points of a straight line from point i, with growing spacing. They include the last point."""
    farthest = n - 1 - i
    return i + np.append(_AHEAD[: np.searchsorted(_AHEAD, farthest)], farthest)


def _settle(corners: Float[np.ndarray, "N 2"], step: float, space: DiscSpace) -> Float[np.ndarray, "M 2"]:
    """Sweeps over the corners, at most four times, until ``step`` [cells] drops or moves none.

    Each half sweep tries every other corner at once, so the corners between them stay fixed. A corner is skipped if its
    neighbours have not moved since it was last tried.
    """
    corners, restless = corners.copy(), np.ones(len(corners), dtype=bool)
    for half in range(8):
        tried = np.arange(1 + half % 2, len(corners) - 1, 2)
        tried = tried[restless[tried]]
        if not len(tried):
            if not restless[1:-1].any():
                break
            continue
        places, dropped = _better(corners, tried, step, space)
        moved = tried[dropped | (places != corners[tried]).any(axis=1)]
        restless[tried] = False
        restless[moved - 1] = restless[moved] = restless[moved + 1] = True
        corners[tried] = places
        if dropped.any():
            kept = np.ones(len(corners), dtype=bool)
            kept[tried[dropped]] = False
            corners, restless = corners[kept], restless[kept]
    return corners


def _better(
    corners: Float[np.ndarray, "N 2"], tried: Int[np.ndarray, "K"], step: float, space: DiscSpace
) -> tuple[Float[np.ndarray, "K 2"], Bool[np.ndarray, "K"]]:
    """Cheaper places for the corners ``tried``, and which of them to drop."""
    before, after = corners[tried - 1], corners[tried + 1]
    candidates = corners[tried, None] + step * _MOVES
    candidates = np.clip(candidates, 0.0, np.array(space.clearance.values.shape) - 1.0)
    k, m = candidates.shape[:2]
    flat = candidates.reshape(-1, 2)
    starts = np.concatenate([np.repeat(before, m, axis=0), flat, before])
    ends = np.concatenate([flat, np.repeat(after, m, axis=0), after])
    lowest, cost = line_costs(starts, ends, space)
    both = (cost[: k * m] + cost[k * m : 2 * k * m]).reshape(k, m)
    safe = (np.minimum(lowest[: k * m], lowest[k * m : 2 * k * m]) >= space.radius).reshape(k, m)
    dropped = (lowest[2 * k * m :] >= space.radius) & (cost[2 * k * m :] <= both[:, 0] + 1e-9)
    allowed = np.where(safe, both, np.inf)
    best = allowed.argmin(axis=1)
    pays = allowed[np.arange(k), best] < both[:, 0] - 1e-6
    return candidates[np.arange(k), np.where(pays, best, 0)], dropped
