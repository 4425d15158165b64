"""Time of a navigation trial by part, for trials as in ``shmoo experiment navigation``.

Each trial runs twice in a process of its own that is restricted to one core, like a worker of an experiment. The second
run counts, because nothing compiles in it. Trials in the demo's building need no files. ``--maps`` adds one scenario on
each map of a folder.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from shmoo_mjx.errors import ShmooError

from .parts import PartClock, watch
from .registry import BenchOptions, Measured

DEMO = "demo building"
REST = "the rest"


@dataclass(frozen=True)
class NavigationSizes:
    """Sizes of the benchmark."""

    time_s: float = 180.0
    """Maximum simulated time of a trial [s]."""
    demos: int = 3
    """Number of trials in the demo's building."""


FULL = NavigationSizes()
QUICK = NavigationSizes(time_s=10.0, demos=1)


def run(cfg: NavigationSizes, options: BenchOptions) -> Measured:
    """Time of each part by place, relative to the simulated time."""
    from shmoo_mjx.base.processes import process_pool
    from shmoo_mjx.evaluation.navigation_places import find_maps
    from shmoo_mjx.evaluation.trials import one_core

    trials: list[tuple[str, Any]] = [(DEMO, options.seed + i) for i in range(cfg.demos)]
    trials += [] if options.maps is None else [*find_maps(options.maps).items()]
    found: dict[str, list[dict[str, Any]]] = {}
    for done, (place, what) in enumerate(trials):
        options.progress(place, done / len(trials))
        with process_pool(1, one_core) as pool:  # what one trial has compiled must not help the next
            timed = pool.submit(partial(_timed, cfg.time_s, options.seed), place, what).result()
        found.setdefault(place, []).append(timed)
    metrics: dict[str, Any] = {}
    rows = []
    for place, runs in found.items():
        simulated, wall = (sum(run[name] for run in runs) for name in ("simulated_s", "wall_s"))
        name = place.replace(" ", "_")
        metrics |= {f"{name}_simulated_s": simulated, f"{name}_ratio_to_simulated_time": wall / simulated}
        for part in runs[0]["parts"]:
            seconds = sum(run["parts"][part] for run in runs)
            rows.append({"place": place, "part": part, "s": seconds, "ms_per_sample": 100 * seconds / simulated})
    return Measured(metrics, rows)


def _timed(time_s: float, seed: int, place: str, what: Any) -> dict[str, Any]:
    """Simulated time, wall-clock time and time of each part of one trial [s]. ``what`` is the demo's seed, or the YAML
    file of the map."""
    from shmoo_mjx.base.assets import WEIGHTS, asset
    from shmoo_mjx.evaluation.navigation_places import Places, kept_scenario
    from shmoo_mjx.evaluation.result import ExperimentOptions
    from shmoo_mjx.evaluation.scenarios import ScenarioConfig
    from shmoo_mjx.evaluation.trials import controller_of
    from shmoo_mjx.planning.floorplan import demo_scenario
    from shmoo_mjx.planning.maps import load_map
    from shmoo_mjx.planning.scenario import Limits
    from shmoo_mjx.run.episode import run_episode

    if place == DEMO:
        grid, scenario = demo_scenario(what)
    else:
        grid = load_map(what)
        with TemporaryDirectory() as scratch:
            places = Places({place: what}, Path(scratch), ExperimentOptions(seed=seed).first_unseen, ScenarioConfig())
            _, generated = kept_scenario(places, grid, place, 0)
        if generated is None:
            raise ShmooError(f"bench navigation: {what} has no place for a scenario; leave this map out.")
        scenario = generated.scenario
    scenario = scenario.model_copy(update={"limits": Limits(time_s=time_s)})
    play = partial(run_episode, grid, scenario, controller_of(asset(WEIGHTS)))
    play()
    clock = PartClock()
    watch(clock)
    began = time.perf_counter()
    episode = play()
    wall = time.perf_counter() - began
    parts = dict(clock.seconds)
    return {
        "simulated_s": episode.result["time_s"],
        "wall_s": wall,
        "parts": parts | {REST: wall - sum(parts.values())},
    }
