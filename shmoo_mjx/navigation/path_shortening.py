"""Grid paths made straight: fewer points, no more cost, and never nearer to walls than allowed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shmoo_mjx.navigation.maps import ClearanceField

__all__ = ["PathConfig", "metre_cost", "shorten"]

_ANGLES = np.arange(8) * np.pi / 4
_MOVES = np.vstack([[0.0, 0.0], np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1)])


@dataclass(frozen=True)
class PathConfig:
    """How much a path keeps away from walls."""

    soft_clearance: float = 0.30
    """Beyond the robot's radius, walls are felt up to this distance [m]."""
    soft_weight: float = 3.0
    """Cost of a metre that touches the inflated walls, less 1 (a metre in the open costs 1)."""
    escape_radius: float = 0.35
    """Round a start nearer to a wall than the radius allows, cells that are no nearer may be used [m]."""


def metre_cost(distance: np.ndarray, radius: float, cfg: PathConfig) -> np.ndarray:
    """Cost ``[...]`` of a metre driven at ``distance [...]`` from the nearest wall, by a disc of ``radius`` [m]."""
    nearness = np.clip(1.0 - (distance - radius) / max(cfg.soft_clearance, 1e-9), 0.0, 1.0)
    return 1.0 + cfg.soft_weight * nearness**2


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
    points = _pull_taut(points, field, radius, cfg)
    for step in (0.32, 0.16, 0.08, 0.04):
        for _ in range(4):
            before = points
            points = _move_corners(points, step, field, radius, cfg)
            if points.shape == before.shape and np.array_equal(points, before):
                break
    return points


def _pull_taut(points: np.ndarray, field: ClearanceField, radius: float, cfg: PathConfig) -> np.ndarray:
    edge_cost = _lines(points[:-1], points[1:], field, radius, cfg)[1]
    total = np.concatenate([[0.0], np.cumsum(edge_cost)])
    kept, i, n = [0], 0, len(points)
    while i < n - 1:
        ends = _look_ahead(i, n)
        safe, straight = _lines(points[[i]], points[ends], field, radius, cfg)
        good = np.flatnonzero(safe & (straight <= 1.002 * (total[ends] - total[i])))
        i = int(ends[good[-1]]) if good.size else i + 1
        kept.append(i)
    return points[kept]


def _look_ahead(i: int, n: int) -> np.ndarray:
    """Candidates for the end of a straight line from point i, spaced ever wider."""
    return i + np.unique(np.geomspace(1, n - 1 - i, 24).astype(int))


def _move_corners(points: np.ndarray, step: float, field: ClearanceField, radius: float, cfg: PathConfig) -> np.ndarray:
    """One sweep over the corners: each is dropped where that costs nothing, or moved by ``step`` where that pays."""
    points, i = points.copy(), 1
    while i < len(points) - 1:
        before, after = points[i - 1], points[i + 1]
        candidates = points[i] + step * _MOVES
        starts = np.vstack([np.broadcast_to(before, candidates.shape), candidates, before])
        ends = np.vstack([candidates, np.broadcast_to(after, candidates.shape), after])
        safe, cost = _lines(starts, ends, field, radius, cfg)
        m = len(candidates)
        both_safe, both_cost = safe[:m] & safe[m : 2 * m], cost[:m] + cost[m : 2 * m]
        if safe[-1] and cost[-1] <= both_cost[0] + 1e-9:
            points = np.delete(points, i, axis=0)
            continue
        best = int(np.argmin(np.where(both_safe, both_cost, np.inf)))
        if both_safe[best] and both_cost[best] < both_cost[0] - 1e-6:
            points[i] = candidates[best]
        i += 1
    return points


def _lines(
    starts: np.ndarray, ends: np.ndarray, field: ClearanceField, radius: float, cfg: PathConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Are the straight lines ``[M, 2]`` to ``[M, 2]`` at least ``radius`` from everything, and what do they cost."""
    lengths = np.linalg.norm(ends - starts, axis=-1)
    count = max(2, int(np.ceil(lengths.max() / (0.5 * float(field.resolution)))) + 1)
    fractions = np.linspace(0.0, 1.0, count)[:, None]
    distance = field.at(starts[:, None] + fractions * (ends - starts)[:, None])
    return (distance >= radius).all(axis=1), lengths * metre_cost(distance, radius, cfg).mean(axis=1)
