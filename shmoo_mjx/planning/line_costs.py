"""Cost and minimum clearance of straight lines through a distance field, vectorised over lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Float, Int
from shmoo_mjx.planning.distance_field import DistanceField


@dataclass(frozen=True)
class PathConfig:
    """Cost of driving near walls."""

    soft_clearance: float = 0.30
    """Distance beyond the robot's radius up to which walls add cost [m]. Larger values give wider bends at walls."""
    soft_weight: float = 3.0
    """Extra cost per metre at the inflated walls, relative to a metre in the open [1]. Larger values prefer longer
    detours in the open. 0 gives the shortest path."""


class DiscSpace(NamedTuple):
    """The space that a disc may drive in, and the cost of driving there."""

    clearance: DistanceField
    """Distance to walls and obstacles [m]."""
    radius: float
    """Radius of the disc [m]."""
    cfg: PathConfig
    """Cost of driving near walls."""

    def metre_cost(self, distance: Float[np.ndarray, "*d"]) -> Float[np.ndarray, "*d"]:
        """Cost per metre at ``distance`` [m] from the nearest wall."""
        reach = max(self.cfg.soft_clearance, 1e-9)
        nearness = np.minimum(np.maximum((self.radius + reach - distance) / reach, 0.0), 1.0)
        return 1.0 + self.cfg.soft_weight * nearness * nearness

    @property
    def resolution(self) -> float:
        """Side of a cell of the distance field [m]."""
        return float(self.clearance.resolution)


def line_costs(
    starts: Float[np.ndarray, "M 2"], ends: Float[np.ndarray, "M 2"], space: DiscSpace
) -> tuple[Float[np.ndarray, "M"], Float[np.ndarray, "M"]]:
    """Minimum clearance and cost of straight lines, sampled at least once per cell length.

    Args:
        starts: fractional (row, column) as ``DistanceField.to_cells`` returns. Points off the map are clipped to its
            border.
        ends: like ``starts``.
        space: the disc and its clearance.

    Returns:
        Minimum clearance [m], and cost [m, weighted near walls].
    """
    cfg, steps = space.cfg, ends - starts
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    count = np.ceil(lengths).astype(np.intp) + 1
    count[count < 2] = 2
    first = np.cumsum(count) - count
    distance = _sampled(np.concatenate([starts, steps / (count - 1)[:, None]], axis=1), count, first, space.clearance)
    lowest = np.minimum.reduceat(distance, first)
    if cfg.soft_weight == 0.0:
        return lowest, lengths * space.resolution
    reach = max(cfg.soft_clearance, 1e-9)
    nearness = (space.radius + reach) - distance
    np.maximum(nearness, 0.0, out=nearness)
    np.minimum(nearness, reach, out=nearness)
    nearness *= nearness
    excess = np.add.reduceat(nearness, first) * (cfg.soft_weight / reach**2)
    return lowest, lengths * space.resolution * (1.0 + excess / count)


def _sampled(
    lines: Float[np.ndarray, "M 4"], count: Int[np.ndarray, "M"], first: Int[np.ndarray, "M"], clearance: DistanceField
) -> Float[np.ndarray, "S"]:
    """Distances along all lines, concatenated. ``lines`` hold each first sample and the step to the next.

    Equivalent to ``DistanceField.look_up`` with less NumPy overhead, because it runs dozens of times per path.
    """
    values = np.asarray(clearance.values)
    height, width = values.shape
    each = np.repeat(lines, count, axis=0)
    along = np.arange(len(each)) - np.repeat(first, count)
    row, col = (each[:, i] + along * each[:, 2 + i] for i in range(2))
    for part, n in ((row, height), (col, width)):
        np.maximum(part, 0.0, out=part)
        np.minimum(part, n - 1.0, out=part)
    low_row, low_col = row.astype(np.intp), col.astype(np.intp)
    row -= low_row
    col -= low_col
    corner = low_row * width + low_col
    flat = values.reshape(-1)
    # Past the last row or column the fraction is zero, so the value of the clipped index does not matter.
    low, up = flat.take(corner), flat.take(corner + width, mode="clip")
    low += col * (flat.take(corner + 1, mode="clip") - low)
    up += col * (flat.take(corner + (width + 1), mode="clip") - up)
    up -= low
    up *= row
    up += low
    return up
