"""Clearance field: distance to the nearest obstacle, interpolated between cell centres."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float, Numbers, Scalar, Shaped
from shmoo_mjx.geometry import se2


class _Field(NamedTuple):
    values: Float[Array, "H W"]
    """Distance to the nearest obstacle [m]; row 0 is at the bottom."""
    origin: Float[Array, "3"]
    """Pose (x, y, yaw) of the lower-left corner in {W} [m, m, rad]."""
    resolution: Scalar
    """Side of a cell [m]."""


class DistanceField(_Field):
    """Distance to the nearest obstacle, sampled at cell centres. A plain pytree.

    ``values [H, W]`` [m] with row 0 at the bottom, ``origin [3]`` pose (x, y, yaw) in {W} of the lower-left corner,
    ``resolution`` side of a cell [m].
    """

    @cached_property
    def memo(self) -> dict[Any, Any]:
        """Cache for results derived from this field. Each user has its own key. Copies start with an empty cache."""
        return {}

    @property
    def constant(self) -> bool:
        """Whether the values are read-only. Only then may derived results be kept in ``memo``."""
        return not np.asarray(self.values).flags.writeable

    def __getstate__(self) -> None:
        """Excludes ``memo`` from pickles and copies."""

    def at(self, points: Numbers | Float[Array, "*p 2"]) -> Float[np.ndarray, "*p"]:
        """Bilinearly interpolated distance [m] at ``points`` in {W}; zero off the map."""
        at = self.to_cells(points)
        return self.look_up(at[..., 0], at[..., 1])

    def to_cells(self, points: Numbers | Float[Array, "*p 2"]) -> Float[np.ndarray, "*p 2"]:
        """Fractional (row, column) of ``points`` in {W}. Cell centres have whole numbers."""
        points = np.asarray(points, dtype=float)
        origin = np.asarray(self.origin, dtype=float)
        local = points - origin[:2] if origin[2] == 0.0 else se2.inverse_transform_point(origin, points)
        return local[..., ::-1] / self.resolution - 0.5

    def to_world(self, cells: Shaped[Array, "*c 2"]) -> Float[np.ndarray, "*c 2"]:
        """Points in {W} of fractional (row, column). The inverse of ``to_cells``."""
        local = (np.asarray(cells, dtype=float)[..., ::-1] + 0.5) * self.resolution
        return se2.transform_point(np.asarray(self.origin, dtype=float), local)

    def look_up(
        self, rows: Scalar | Float[np.ndarray, "*p"], cols: Scalar | Float[np.ndarray, "*p"]
    ) -> Float[np.ndarray, "*p"]:
        """Bilinearly interpolated distance [m] at fractional ``rows``, ``cols`` of ``to_cells``; zero off the map."""
        values = np.asarray(self.values)
        height, width = values.shape
        row = np.minimum(np.maximum(rows, 0.0), height - 1.0)
        col = np.minimum(np.maximum(cols, 0.0), width - 1.0)
        low_row = np.minimum(row.astype(np.intp), max(height - 2, 0))
        low_col = np.minimum(col.astype(np.intp), max(width - 2, 0))
        row, col = row - low_row, col - low_col
        corner = low_row * width + low_col
        up, right = width * (height > 1), int(width > 1)
        flat = values.reshape(-1)
        low, high = flat.take(corner), flat.take(corner + up)
        low = low + col * (flat.take(corner + right) - low)
        high = high + col * (flat.take(corner + (up + right)) - high)
        distance = low + row * (high - low)
        return np.where(self._holds(rows, cols), distance, 0.0)

    def _holds(
        self, rows: Scalar | Float[np.ndarray, "*p"], cols: Scalar | Float[np.ndarray, "*p"]
    ) -> Scalar | Bool[np.ndarray, "*p"]:
        height, width = np.shape(self.values)
        return (rows >= -0.5) & (rows <= height - 0.5) & (cols >= -0.5) & (cols <= width - 0.5)
