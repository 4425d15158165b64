"""How long the navigator thinks per sample of 0.1 s, by what it does; its planning stage; and a global path.

A demo is run as it is, twice, and the second run counts: nothing is compiled in it. A tick is all between an
observation and the command for it: belief, paths, local trajectory, adaptation, MPPI. A tick with a planning stage
(Algorithm 1: 500 roll-outs of 5 s, collision checks) is counted apart.
"""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from shmoo_mjx.benchmarking.registry import BenchOptions, Measured
from shmoo_mjx.planning.floorplan import demo_scenario
from shmoo_mjx.planning.maps import OccupancyGrid, clearance_field
from shmoo_mjx.planning.paths import plan_path
from shmoo_mjx.planning.scenario import ROBOT_RADIUS, Limits, Scenario
from shmoo_mjx.types import DT, Observation

PLANNING = "planning stage"


@dataclass(frozen=True)
class PlannerSizes:
    """Sizes of the benchmark."""

    time_s: float = 180.0
    """Longest simulated time of a run [s]."""
    paths: int = 30
    """Global paths."""


FULL = PlannerSizes()
QUICK = PlannerSizes(time_s=16.0, paths=5)
"""Until a little after the first touch."""


@dataclass
class _Clock:
    """Takes the time of every tick of a run by the hooks before and after it."""

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
    """Run, then count."""
    grid, scenario = demo_scenario(options.seed)
    scenario = scenario.model_copy(update={"limits": Limits(time_s=cfg.time_s)})
    ticks = _ticks(cfg, grid, scenario, options)
    rows = [_row(name, seconds) for name, seconds in ticks.items()]
    rows += _paths(cfg, grid, scenario)
    every = np.concatenate([np.array(s) for s in ticks.values()])
    metrics: dict[str, Any] = {f"{row['name'].replace(' ', '_')}_ms": row.get("median_ms") for row in rows}
    metrics |= {
        "tick_ms": 1e3 * float(np.median(every)),
        "tick_p99_ms": 1e3 * float(np.quantile(every, 0.99)),
        "tick_max_ms": 1e3 * float(every.max()),
        "ticks_over_100_ms": int(np.sum(every > DT)),
    }
    ours, peer = metrics["global_path_ms"], metrics["pyastar2d_ms"]
    metrics["ratio_to_pyastar2d"] = ours / peer if peer else None
    return Measured(metrics, rows)


def _ticks(cfg: PlannerSizes, grid: OccupancyGrid, scenario: Scenario, options: BenchOptions) -> dict[str, list[float]]:
    """Seconds of every tick of the second run, by state."""
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


def _paths(cfg: PlannerSizes, grid: OccupancyGrid, scenario: Scenario) -> list[dict[str, Any]]:
    """A global path from start to goal, ours and pyastar2d's on the same map."""
    walls = clearance_field(grid)
    start, goal = np.array(scenario.start[:2]), np.array(scenario.goal)
    ours = _seconds(lambda: plan_path(grid, start, goal, robot_radius=ROBOT_RADIUS, field=walls), cfg.paths)
    try:
        import pyastar2d
    except ImportError:
        absent = "pyastar2d is absent: it is not installed"
        return [_row("global path", ours), {"name": "pyastar2d", "absent": absent}]
    costs = np.where(walls.values >= ROBOT_RADIUS, 1.0, np.inf).astype(np.float32)
    ends = [tuple(int(i) for i in grid.world_to_cell(p)) for p in (start, goal)]
    peer = _seconds(lambda: pyastar2d.astar_path(costs, *ends, allow_diagonal=True), cfg.paths)
    return [_row("global path", ours), _row("pyastar2d", peer)]


def _seconds(work: Any, times: int) -> list[float]:
    taken = []
    for _ in range(times):
        began = time.perf_counter()
        work()
        taken.append(time.perf_counter() - began)
    return taken


def _row(name: str, seconds: list[float]) -> dict[str, Any]:
    ms = 1e3 * np.array(seconds)
    return {
        "name": name,
        "count": len(ms),
        "median_ms": np.median(ms),
        "p90_ms": np.quantile(ms, 0.9),
        "max_ms": ms.max(),
    }
