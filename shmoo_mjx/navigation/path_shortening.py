"""Grid paths made straight: fewer points, no more cost, and never nearer to walls than allowed."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.navigation.clearance import ClearanceField
from shmoo_mjx.navigation.line_costs import PathConfig, line_costs, metre_cost

__all__ = ["PathConfig", "metre_cost", "shorten"]

_ANGLES = np.arange(8) * np.pi / 4
_MOVES = np.vstack([[0.0, 0.0], np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1)])


def shorten(points: np.ndarray, field: ClearanceField, radius: float, cfg: PathConfig) -> np.ndarray:
    """Replaces parts of a polyline by straight lines, then moves the corners that are left to where they cost least.

    Args:
        points: ``[N, 2]`` in {W} [m].
        field: distance to walls and obstacles [m].
        radius: what straight lines must keep [m].
        cfg: the cost of being near walls.

    Returns:
        ``[M, 2]`` with the same ends, M <= N.
    """
    corners = _pull_taut(field.to_cells(points), field, radius, cfg)
    for step in (0.32, 0.16, 0.08, 0.04):
        corners = _settle(corners, step / float(field.resolution), field, radius, cfg)
    inner = field.to_world(corners[1:-1])
    return np.vstack([points[:1], inner, points[-1:]])


def _pull_taut(points: np.ndarray, field: ClearanceField, radius: float, cfg: PathConfig) -> np.ndarray:
    edge_cost = line_costs(points[:-1], points[1:], field, radius, cfg)[1]
    total = np.concatenate([[0.0], np.cumsum(edge_cost)])
    kept, i, n = [0], 0, len(points)
    while i < n - 1:
        ends = _look_ahead(i, n)
        lowest, straight = line_costs(np.broadcast_to(points[i], (len(ends), 2)), points[ends], field, radius, cfg)
        good = np.flatnonzero((lowest >= radius) & (straight <= 1.002 * (total[ends] - total[i])))
        i = int(ends[good[-1]]) if good.size else i + 1
        kept.append(i)
    return points[kept]


def _look_ahead(i: int, n: int) -> np.ndarray:
    """Candidates for the end of a straight line from point i, spaced ever wider."""
    return i + np.unique(np.geomspace(1, n - 1 - i, 24).astype(int))


def _settle(points: np.ndarray, step: float, field: ClearanceField, radius: float, cfg: PathConfig) -> np.ndarray:
    """Sweeps over the corners, four at most, until none is dropped or moved by ``step`` [cells] any more."""
    corners = list(points)
    restless = [True] * len(corners)
    for _ in range(4):
        if not any(restless[1:-1]):
            break
        i = 1
        while i < len(corners) - 1:
            if not restless[i]:
                i += 1
                continue
            restless[i] = False
            better = _better(corners[i - 1], corners[i], corners[i + 1], step, field, radius, cfg)
            if better is None:
                i += 1
                continue
            restless[i - 1 : i + 2] = [True] * 3
            if better.size:
                corners[i] = better
                i += 1
            else:
                del corners[i], restless[i]
    return np.array(corners)


def _better(
    before: np.ndarray,
    corner: np.ndarray,
    after: np.ndarray,
    step: float,
    field: ClearanceField,
    radius: float,
    cfg: PathConfig,
) -> np.ndarray | None:
    """A cheaper place ``[2]`` for the corner, an empty array if it is better dropped, or None if it is best there."""
    candidates = corner + step * _MOVES
    m = len(candidates)
    starts = np.concatenate([np.broadcast_to(before, (m, 2)), candidates, before[None]])
    ends = np.concatenate([candidates, np.broadcast_to(after, (m, 2)), after[None]])
    lowest, cost = line_costs(starts, ends, field, radius, cfg)
    both = cost[:m] + cost[m : 2 * m]
    if lowest[-1] >= radius and cost[-1] <= both[0] + 1e-9:
        return np.empty(0)
    safe = (lowest[:m] >= radius) & (lowest[m : 2 * m] >= radius)
    best = int(np.argmin(np.where(safe, both, np.inf)))
    return candidates[best] if safe[best] and both[best] < both[0] - 1e-6 else None
