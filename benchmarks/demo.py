"""Time of ``shmoo demo`` by part, including film and report: physics, control, planning, compilation, Python.

The demo runs in a process of its own, first with an empty compilation cache, then with a warm one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .parts import PartClock, watch
from .registry import BenchOptions, Measured

START, REST = "start and imports", "the rest"


@dataclass(frozen=True)
class DemoSizes:
    """Sizes of the benchmark."""

    time_s: float = 180.0
    """Maximum simulated time [s]."""
    runs: int = 3
    """Runs with a warm cache. The fastest one counts, because other processes can only slow a run down."""


FULL = DemoSizes()
QUICK = DemoSizes(time_s=14.0, runs=1)


def run(cfg: DemoSizes, options: BenchOptions) -> Measured:
    """Times of the demo of the seed, with an empty and with a warm compilation cache."""
    with tempfile.TemporaryDirectory() as empty:
        options.progress("with an empty compilation cache", 0.0)
        cold = _demo(cfg, options.seed, empty)
        warm = []
        for i in range(cfg.runs):
            options.progress("with a warm one", (i + 1) / (cfg.runs + 1))
            warm.append(_demo(cfg, options.seed, empty))
    best = min(warm, key=lambda row: row["wall_s"])
    rows = [
        {"name": name, "cache": cache, "s": seconds, "share": seconds / run["wall_s"]}
        for cache, run in (("empty", cold), ("warm", best))
        for name, seconds in sorted(run["parts"].items(), key=lambda item: -item[1])
    ]
    metrics: dict[str, Any] = {
        "simulated_time": best["simulated"],
        "first_time_s": cold["wall_s"],
        "warm_s": best["wall_s"],
        "ratio_to_simulated_time": best["wall_s"] / best["simulated"],
    }
    metrics |= {f"warm_{name.replace(',', '').replace(' ', '_')}_s": s for name, s in best["parts"].items()}
    return Measured(metrics, rows)


def _demo(cfg: DemoSizes, seed: int, cache: str) -> dict[str, Any]:
    """One run: simulated time and wall-clock time [s], and the seconds of each part."""
    began = time.perf_counter()
    command = [sys.executable, "-P", "-m", __name__, str(seed), str(cfg.time_s)]
    done = subprocess.run(
        command, check=True, capture_output=True, text=True, env=os.environ | {"JAX_COMPILATION_CACHE_DIR": cache}
    )
    wall, found = time.perf_counter() - began, json.loads(done.stdout.splitlines()[-1])
    parts = found["parts"]
    parts[REST] = found["run_s"] - sum(parts.values())
    parts[START] = wall - found["run_s"]
    return {"simulated": found["simulated"], "wall_s": wall, "parts": parts}


def main() -> None:
    """Run the demo of the seed with the clock on, and print one line of JSON."""
    from shmoo_mjx.base.environment import prepare_environment

    prepare_environment()
    import shmoo_mjx.run.episode  # noqa: F401
    from shmoo_mjx.planning.floorplan import demo_scenario
    from shmoo_mjx.planning.scenario import Limits
    from shmoo_mjx.run import scenario_run as runs

    clock = PartClock()
    watch(clock)
    grid, scenario = demo_scenario(int(sys.argv[1]))
    scenario = scenario.model_copy(update={"limits": Limits(time_s=float(sys.argv[2]))})
    with tempfile.TemporaryDirectory() as out:
        began = time.perf_counter()
        result = runs.run_scenario(grid, scenario, Path(out) / "demo")
        took = time.perf_counter() - began
    print(json.dumps({"simulated": np.round(result["time_s"], 2), "run_s": took, "parts": clock.seconds}))


if __name__ == "__main__":
    main()
