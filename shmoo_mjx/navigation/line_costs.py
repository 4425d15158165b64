"""What straight lines through a clearance field cost, and how near they come to walls: many lines at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shmoo_mjx.navigation.clearance import ClearanceField

__all__ = ["PathConfig", "line_costs", "metre_cost"]


@dataclass(frozen=True)
class PathConfig:
    """How much a path keeps away from walls."""

    soft_clearance: float = 0.30
    """Beyond the robot's radius, walls are felt up to this distance [m]."""
    soft_weight: float = 3.0
    """Cost of a metre that touches the inflated walls, less 1 (a metre in the open costs 1)."""
    escape_radius: float = 0.35
    """Round a start nearer to a wall than the radius allows, cells that are no nearer may be used [m]."""
    spacing: float = 0.20
    """Distance between the points of the lattice on which a way is sought [m]; at least a cell."""


def metre_cost(distance: np.ndarray, radius: float, cfg: PathConfig) -> np.ndarray:
    """Cost ``[...]`` of a metre driven at ``distance [...]`` from the nearest wall, by a disc of ``radius`` [m]."""
    reach = max(cfg.soft_clearance, 1e-9)
    nearness = np.minimum(np.maximum((radius + reach - distance) / reach, 0.0), 1.0)
    return 1.0 + cfg.soft_weight * nearness * nearness


def line_costs(
    starts: np.ndarray, ends: np.ndarray, field: ClearanceField, radius: float, cfg: PathConfig
) -> tuple[np.ndarray, np.ndarray]:
    """How near straight lines come to anything, and what they cost; sampled at least twice in a cell's length.

    Args:
        starts: ``[M, 2]`` (row, column) with fractions, as of ``ClearanceField.to_cells``.
        ends: ``[M, 2]`` likewise.
        field: distance to walls and obstacles [m].
        radius: of the disc [m].
        cfg: the cost of being near walls.

    Returns:
        Lowest clearance ``[M]`` [m], and cost ``[M]`` [m, near-wall metres counted more].
    """
    steps = ends - starts
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    count = np.maximum(np.ceil(2.0 * lengths).astype(int) + 1, 2)
    first = np.cumsum(count) - count
    fraction = (np.arange(count.sum()) - np.repeat(first, count)) * np.repeat(1.0 / (count - 1), count)
    rows, cols = (np.repeat(starts[:, i], count) + fraction * np.repeat(steps[:, i], count) for i in range(2))
    distance = field.look_up(rows, cols)
    per_metre = np.add.reduceat(metre_cost(distance, radius, cfg), first) / count
    return np.minimum.reduceat(distance, first), lengths * float(field.resolution) * per_metre
