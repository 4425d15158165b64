"""A map as a picture, with the free space that is left for a robot of a given radius."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shmoo_mjx.navigation.maps import OccupancyGrid, inflate
from shmoo_mjx.report.figures import to_png
from shmoo_mjx.report.trace import write_bytes

__all__ = ["draw_map"]


def draw_map(grid: OccupancyGrid, radius: float, path: Path) -> Path:
    """Write ``path`` (PNG): walls dark, unknown grey, floor white, and in blue where the robot's centre may be.

    Args:
        grid: the map.
        radius: radius of the robot [m].
        path: picture to write.
    """
    from matplotlib.figure import Figure

    picture = np.full((*grid.cells.shape, 3), 0.75)
    picture[grid.free] = 1.0
    picture[inflate(grid, radius)] = (0.80, 0.89, 0.97)
    picture[grid.occupied] = 0.15
    height, width = grid.cells.shape
    scale = 9.0 / max(height, width)
    figure = Figure(figsize=(width * scale + 1.0, height * scale + 1.0), layout="constrained")
    axes = figure.add_subplot()
    extent = (0.0, width * grid.resolution, 0.0, height * grid.resolution)
    axes.imshow(picture, origin="lower", extent=extent, interpolation="nearest")
    x, y, yaw = grid.origin
    axes.set_xlabel(f"along the map's x axis [m]; corner at ({x:g}, {y:g}) m, yaw {yaw:g} rad in {{W}}")
    axes.set_ylabel("along its y axis [m]")
    share = inflate(grid, radius).sum() * grid.resolution**2
    axes.set_title(f"{width} x {height} cells of {grid.resolution:g} m; {share:.0f} m² for a radius of {radius:g} m")
    return write_bytes(path, to_png(figure))
