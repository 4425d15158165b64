"""Picture of a map with the free space for a robot of a given radius."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shmoo_mjx.planning.maps import OccupancyGrid, inflate
from shmoo_mjx.report.style import blank_figure, extent, save_figure, show_cells


def draw_map(grid: OccupancyGrid, radius: float, path: Path) -> Path:
    """Write a PNG of a map: walls dark, unknown cells grey, floor white, and free positions for the robot blue.

    The axes are those of {W}, as in scenario files. A grid helps to choose a start.

    Args:
        grid: the map.
        radius: radius of the robot [m].
        path: the file to write.

    Returns:
        ``path``.
    """
    from matplotlib.patches import Patch

    room = inflate(grid, radius)
    share = room.sum() * grid.resolution**2
    kinds = {
        "unknown": (~grid.free & ~grid.occupied, (0.75, 0.75, 0.75)),
        "floor": (grid.free, (1.0, 1.0, 1.0)),
        f"room for a radius of {radius:g} m: {share:.0f} m²": (room, (0.72, 0.84, 0.95)),
        "wall": (grid.occupied, (0.15, 0.15, 0.15)),
    }
    picture = np.ones((*grid.cells.shape, 3))
    for where, colour in kinds.values():
        picture[where] = colour
    height, width = grid.cells.shape
    figure = blank_figure(1.0, 1.0)
    axes = figure.add_subplot()
    show_cells(axes, picture, grid.resolution, grid.origin)
    # Crop to the known cells, because maps from SLAM often have a wide border of unknown cells.
    low, high = extent(grid.free | grid.occupied, grid.resolution, grid.origin)
    size = (high - low) * 9.0 / (high - low).max()
    figure.set_size_inches(max(size[0], 3.0) + 1.0, size[1] + 1.6)
    axes.set(
        xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x in {W} [m]", ylabel="y in {W} [m]"
    )
    axes.grid(color="0.5", lw=0.4, alpha=0.5)
    axes.set_title(f"{width} x {height} cells of {grid.resolution:g} m", fontsize="medium")
    patches = [Patch(facecolor=colour, edgecolor="0.5", label=name) for name, (_, colour) in kinds.items()]
    figure.legend(
        handles=patches, loc="outside lower center", ncols=4 if size[0] > 6 else 2, fontsize="small", frameon=False
    )
    return save_figure(path, figure)
