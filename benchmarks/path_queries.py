"""Global paths on every map below a folder: length and time per query, beside pyastar2d's where it is installed.

uv run python benchmarks/path_queries.py MAPS [PAIRS]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from scipy import ndimage

from shmoo_mjx.evaluation.navigation_places import find_maps
from shmoo_mjx.navigation.maps import clearance_field, load_map
from shmoo_mjx.navigation.path_shortening import PathConfig
from shmoo_mjx.navigation.paths import plan_path
from shmoo_mjx.navigation.scenario import ROBOT_RADIUS

try:
    import pyastar2d
except ImportError:
    pyastar2d = None


def main() -> None:
    """Print a row per map: ours, ours without the cost of being near walls (comparable in length), and the peer."""
    maps, pairs = find_maps(Path(sys.argv[1])), int(sys.argv[2]) if len(sys.argv) > 2 else 100
    if pyastar2d is None:
        print("pyastar2d is not installed, so its columns are missing")
    print("map: ours [ms, m]; shortest [ms, m]; pyastar2d [ms, m]; all medians of", pairs, "random free pairs")
    for name, file in maps.items():
        grid = load_map(file)
        field = clearance_field(grid)
        labels, _ = ndimage.label(field.values > ROBOT_RADIUS + grid.resolution)
        room = np.argwhere(labels == np.bincount(labels.ravel())[1:].argmax() + 1)
        cells = room[np.random.default_rng(0).integers(len(room), size=(pairs, 2))]
        rows = []
        for start, goal in cells:
            ends = grid.cell_to_world(np.stack([start, goal]))
            row = []
            for cfg in (PathConfig(), PathConfig(soft_weight=0.0)):
                begin = time.perf_counter()
                path = plan_path(grid, *ends, robot_radius=ROBOT_RADIUS, cfg=cfg, field=field)
                row += [1e3 * (time.perf_counter() - begin), np.nan if path is None else path.length]
            if pyastar2d is not None:
                costs = np.where(field.values >= ROBOT_RADIUS, 1.0, np.inf).astype(np.float32)
                begin = time.perf_counter()
                found = pyastar2d.astar_path(costs, tuple(start), tuple(goal), allow_diagonal=True)
                elapsed = 1e3 * (time.perf_counter() - begin)
                steps = np.nan if found is None else np.linalg.norm(np.diff(found, axis=0), axis=1).sum()
                row += [elapsed, steps * grid.resolution]
            rows.append(row)
        numbers = np.nanmedian(np.array(rows), axis=0)
        missing = int(np.isnan(np.array(rows)[:, 1]).sum())
        print(
            f"{name}:", "; ".join(f"{a:.0f} ms, {b:.2f} m" for a, b in numbers.reshape(-1, 2)), f"; {missing} without"
        )


if __name__ == "__main__":
    main()
