"""Global paths on every map below a folder: time and length per query, beside pyastar2d's where it is installed.

Times are processor time, which a busy machine spoils less than the clock.

uv run --with pyastar2d python benchmarks/path_queries.py MAPS [PAIRS]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import ndimage

from shmoo_mjx.evaluation.navigation_places import find_maps
from shmoo_mjx.planning.clearance import ClearanceField
from shmoo_mjx.planning.footprints import footprint_polygon
from shmoo_mjx.planning.maps import OccupancyGrid, clearance_field, load_map
from shmoo_mjx.planning.paths import plan_path, point_at
from shmoo_mjx.planning.scenario import ROBOT_RADIUS

try:
    import pyastar2d
except ImportError:
    pyastar2d = None

COLUMNS = "first ms | median ms | p90 ms | same goal ms | with a box ms | length m"
PEER = " | pyastar2d median ms | p90 ms | length m | time over it | length over it"


def main() -> None:
    """Print a row per map; each pair of ends is asked of ours and of the peer in turn."""
    maps, pairs = find_maps(Path(sys.argv[1])), int(sys.argv[2]) if len(sys.argv) > 2 else 100
    peer = "pyastar2d is not installed" if pyastar2d is None else "beside pyastar2d"
    print(f"{pairs} random free pairs a map; ms of processor time; {peer}")
    print("map |", COLUMNS + (PEER if pyastar2d is not None else ""))
    for name, file in maps.items():
        print(name, "|", " | ".join(f"{number:.3g}" for number in measure(load_map(file), pairs)), flush=True)


def measure(grid: OccupancyGrid, pairs: int) -> list[float]:
    """The numbers of ``COLUMNS`` and ``PEER``; "with a box" puts one on the path and plans again to the same goal."""
    field = clearance_field(grid)
    cells = random_pairs(field, pairs)
    first = timed(lambda: plan_path(grid, *grid.cell_to_world(cells[0]), robot_radius=ROBOT_RADIUS, field=field))[0]
    rows = np.array([query(grid, field, ends) for ends in cells])
    median, p90 = np.nanmedian(rows, axis=0), np.nanpercentile(rows, 90, axis=0)
    numbers = [first, median[0], p90[0], median[1], median[2], median[3]]
    if pyastar2d is not None:
        numbers += [median[4], p90[4], median[5], median[0] / median[4], np.nanmedian(rows[:, 3] / rows[:, 5])]
    return [float(number) for number in numbers]


def query(grid: OccupancyGrid, field: ClearanceField, ends: np.ndarray) -> list[float]:
    """One pair: ms, ms again, ms with a box in the way, length [m], and the peer's ms and length."""
    start, goal = grid.cell_to_world(ends)
    elapsed, path = timed(lambda: plan_path(grid, start, goal, robot_radius=ROBOT_RADIUS, field=field))
    again, _ = timed(lambda: plan_path(grid, start, goal, robot_radius=ROBOT_RADIUS, field=field))
    assert path is not None, "the pairs lie in one room"
    box = footprint_polygon((*point_at(path, path.length / 2), 0.5), (0.3, 0.25))
    boxed, _ = timed(lambda: plan_path(grid, start, goal, [box], ROBOT_RADIUS, field=field))
    numbers = [elapsed, again, boxed, path.length]
    if pyastar2d is None:
        return numbers
    costs = np.where(field.values >= ROBOT_RADIUS, 1.0, np.inf).astype(np.float32)
    peer, found = timed(lambda: pyastar2d.astar_path(costs, tuple(ends[0]), tuple(ends[1]), allow_diagonal=True))
    steps = np.nan if found is None else np.linalg.norm(np.diff(found, axis=0), axis=1).sum()
    return [*numbers, peer, steps * grid.resolution or np.nan]


def random_pairs(field: ClearanceField, pairs: int) -> np.ndarray:
    """Cells ``[pairs, 2, 2]``: start and goal within the largest room."""
    labels, _ = ndimage.label(field.values > ROBOT_RADIUS + field.resolution)
    room = np.argwhere(labels == np.bincount(labels.ravel())[1:].argmax() + 1)
    return room[np.random.default_rng(0).integers(len(room), size=(pairs, 2))]


def timed[T](options: Callable[[], T]) -> tuple[float, T]:
    """How much processor time it takes [ms], and the answer; both engines work in the one thread that asks."""
    begin = time.thread_time()
    answer = options()
    return 1e3 * (time.thread_time() - begin), answer


if __name__ == "__main__":
    main()
