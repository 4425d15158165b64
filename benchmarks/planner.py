"""Time of the navigator per sample of 0.1 s by state, of its planning stage, and of global paths.

A demo runs twice. The second run counts, because nothing compiles in it. A tick is everything between an observation
and its command: belief, paths, local trajectory, adaptation, MPPI. A tick with a planning stage (Algorithm 1: 500
roll-outs of 5 s, collision checks) is counted separately. Global paths are planned in the demo's building and, with
``--maps``, on each map of a folder. If pyastar2d is installed, it plans the same paths.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

import numpy as np

from shmoo_mjx.evaluation.navigation_places import find_maps
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.floorplan import demo_scenario
from shmoo_mjx.planning.footprints import footprint_polygon
from shmoo_mjx.planning.maps import OccupancyGrid, distance_field, load_map
from shmoo_mjx.planning.paths import plan_path, point_at
from shmoo_mjx.planning.scenario import ROBOT_RADIUS, Limits, Scenario
from shmoo_mjx.types import DT, Observation

from .registry import BenchOptions, Measured

PLANNING = "planning stage"
DEMO = "demo building"
COLUMNS = ("ms", "same_goal_ms", "with_a_box_ms", "length_m", "pyastar2d_ms", "pyastar2d_length_m")
"""Measures of a pair of places: time of its first path, of the same path again, and of a path round a box on it;
length of the first path; time and length of the peer's path."""


@dataclass(frozen=True)
class PlannerSizes:
    """Sizes of the benchmark."""

    time_s: float = 180.0
    """Maximum simulated time of a run [s]."""
    paths: int = 100
    """Number of pairs of places on each map between which a global path is planned."""


FULL = PlannerSizes()
QUICK = PlannerSizes(time_s=16.0, paths=5)
"""Sizes whose run ends shortly after the first contact."""


@dataclass
class _Clock:
    """Measures the time of every tick of a run, with the hooks before and after it."""

    ticks: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    began: float = 0.0
    mode: str = ""
    took: float = 0.0
    decisions: int = 0

    def before(self, seen: Observation) -> Observation:
        self.began = time.perf_counter()
        return seen

    def after(self, now: float, mode: str) -> None:
        self.took, self.mode = time.perf_counter() - self.began, mode

    def note(self, navigator: Any) -> bool:
        planned, self.decisions = len(navigator.decisions) > self.decisions, len(navigator.decisions)
        self.ticks[PLANNING if planned else self.mode].append(self.took)
        return False


def run(cfg: PlannerSizes, options: BenchOptions) -> Measured:
    """Times of the demo's ticks and of global paths on each map."""
    grid, scenario = demo_scenario(options.seed)
    scenario = scenario.model_copy(update={"limits": Limits(time_s=cfg.time_s)})
    ticks = _ticks(cfg, grid, scenario, options)
    rows = [_row(name, seconds) for name, seconds in ticks.items()]
    every = np.concatenate([np.array(s) for s in ticks.values()])
    metrics: dict[str, Any] = {f"{row['name'].replace(' ', '_')}_ms": row["median_ms"] for row in rows}
    metrics |= {
        "tick_ms": 1e3 * float(np.median(every)),
        "tick_p99_ms": 1e3 * float(np.quantile(every, 0.99)),
        "tick_max_ms": 1e3 * float(every.max()),
        "ticks_over_100_ms": int(np.sum(every > DT)),
    }
    grids = {} if options.maps is None else {name: load_map(file) for name, file in find_maps(options.maps).items()}
    for place, here in {DEMO: grid, **grids}.items():
        row, measured = _paths(place, here, cfg.paths)
        rows, metrics = [*rows, row], metrics | measured
    return Measured(metrics, rows)


def _ticks(cfg: PlannerSizes, grid: OccupancyGrid, scenario: Scenario, options: BenchOptions) -> dict[str, list[float]]:
    """Durations of all ticks of the second run by state [s]."""
    from shmoo_mjx.base.assets import WEIGHTS, asset
    from shmoo_mjx.control.pushing import PushController
    from shmoo_mjx.learning.weights import load_weights
    from shmoo_mjx.run.episode import Hooks, run_episode

    controller = PushController(load_weights(asset(WEIGHTS)))
    for name in ("first run, which compiles", "second run"):
        clock = _Clock()

        def after(now: float, mode: str, clock: _Clock = clock, name: str = name) -> None:
            clock.after(now, mode)
            options.progress(f"{name}: {mode}", (now / cfg.time_s + (name == "second run")) / 2)

        hooks = Hooks(progress=after, perceive=clock.before, over=clock.note)
        run_episode(grid, scenario, controller, hooks=hooks)
    return dict(clock.ticks)


def _paths(place: str, grid: OccupancyGrid, pairs: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """The row and the metrics of global paths between random pairs of places in one room, of ours and of pyastar2d."""
    field = distance_field(grid)
    rows = np.array([_query(grid, field, ends) for ends in _pairs(field, pairs)])
    # A column is empty if the peer is not installed.
    there = ~np.isnan(rows).all(axis=0)
    median, p90 = np.full((2, rows.shape[1]), np.nan)
    median[there], p90[there] = np.nanmedian(rows[:, there], axis=0), np.nanquantile(rows[:, there], 0.9, axis=0)
    row = {"name": "global path", "place": place, "pairs": pairs}
    row |= {f"{name}_median": median[i] for i, name in enumerate(COLUMNS)}
    row |= {f"{name}_p90": p90[i] for i, name in enumerate(COLUMNS)}
    prefix = "" if place == DEMO else f"{place}_"
    metrics = {f"{prefix}global_path_ms": median[0], f"{prefix}pyastar2d_ms": median[4]}
    if np.isnan(median[4]):
        return row | {"absent": "pyastar2d is absent: it is not installed"}, metrics | {f"{prefix}pyastar2d_ms": None}
    return row, metrics | {f"{prefix}ratio_to_pyastar2d": median[0] / median[4]}


def _query(grid: OccupancyGrid, field: DistanceField, ends: np.ndarray) -> list[float]:
    """The values of `COLUMNS` for one pair of cells."""
    start, goal = grid.cell_to_world(ends)
    first, path = _timed(lambda: plan_path(grid, start, goal, robot_radius=ROBOT_RADIUS, wall_clearance=field))
    again, _ = _timed(lambda: plan_path(grid, start, goal, robot_radius=ROBOT_RADIUS, wall_clearance=field))
    assert path is not None, "the pairs lie in one room"
    box = footprint_polygon((*point_at(path, path.length / 2), 0.5), (0.3, 0.25))
    boxed, _ = _timed(lambda: plan_path(grid, start, goal, [box], robot_radius=ROBOT_RADIUS, wall_clearance=field))
    numbers = [first, again, boxed, path.length]
    if find_spec("pyastar2d") is None:
        return [*numbers, np.nan, np.nan]
    import pyastar2d

    costs = np.where(field.values >= ROBOT_RADIUS, 1.0, np.inf).astype(np.float32)
    peer, cells = _timed(lambda: pyastar2d.astar_path(costs, tuple(ends[0]), tuple(ends[1]), allow_diagonal=True))
    steps = np.nan if cells is None else np.linalg.norm(np.diff(cells, axis=0), axis=1).sum()
    return [*numbers, peer, steps * grid.resolution or np.nan]


def _pairs(field: DistanceField, count: int) -> np.ndarray:
    """Random cells ``[count, 2, 2]``: start and goal within the largest room."""
    from scipy import ndimage

    labels, _ = ndimage.label(field.values > ROBOT_RADIUS + field.resolution)
    room = np.argwhere(labels == np.bincount(labels.ravel())[1:].argmax() + 1)
    return room[np.random.default_rng(0).integers(len(room), size=(count, 2))]


def _timed[T](work: Callable[[], T]) -> tuple[float, T]:
    """Processor time of ``work`` [ms], and its result. A busy machine affects it less than wall-clock time, and both
    planners have one thread."""
    began = time.thread_time()
    answer = work()
    return 1e3 * (time.thread_time() - began), answer


def _row(name: str, seconds: list[float]) -> dict[str, Any]:
    ms = 1e3 * np.array(seconds)
    quantiles = {"median_ms": np.median(ms), "p90_ms": np.quantile(ms, 0.9), "max_ms": ms.max()}
    return {"name": name, "count": len(ms)} | quantiles
