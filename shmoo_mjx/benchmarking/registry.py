"""The benchmarks by name. A benchmark is a module with three names, imported only when asked for.

``FULL`` and ``QUICK`` are its sizes, and ``run(config, options) -> Measured`` measures.
"""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from shmoo_mjx.arrays import single_precision
from shmoo_mjx.benchmarking.workers import usable_cores
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result, table, write_result

BENCHMARKS = {
    "startup": "shmoo_mjx.benchmarking.startup",
    "plant": "shmoo_mjx.benchmarking.plant",
    "planner": "shmoo_mjx.benchmarking.planner",
    "demo": "shmoo_mjx.benchmarking.demo",
    "navigation": "shmoo_mjx.benchmarking.navigation",
    "mppi": "shmoo_mjx.benchmarking.mppi",
    "daiml": "shmoo_mjx.benchmarking.daiml",
}
"""Name to module."""


@dataclass(frozen=True)
class BenchOptions:
    """What the command line asks of a benchmark."""

    quick: bool = False
    """A short form of the same shape."""
    peers_python: Path | None = None
    """Interpreter that has the peers installed (default: the one that runs this)."""
    seed: int = 0
    """Of made-up weights and noise."""
    progress: Callable[[str, float], None] = lambda stage, fraction: None
    """Called with (stage, fraction done)."""
    maps: Path | None = None
    """Folder of map_server maps, for the benchmark navigation."""


@dataclass(frozen=True)
class Measured:
    """What a benchmark has found."""

    metrics: dict[str, Any]
    rows: list[dict[str, Any]]
    setup: dict[str, Any] = field(default_factory=dict)
    """What the result's config holds beside the sizes."""
    paper: dict[str, float] = field(default_factory=dict)
    """Numbers of others, by the names of the metrics that they compare with."""


@single_precision
def run_benchmark(name: str, options: BenchOptions, sizes: Any = None) -> ExperimentResult:
    """Run one benchmark, of other ``sizes`` than its own if given; its config says on which machine."""
    if name not in BENCHMARKS:
        names = ", ".join(BENCHMARKS)
        raise ShmooError(f"benchmark {name!r} is not known; choose one of {names}, all or compare.")
    module = import_module(BENCHMARKS[name])
    config = sizes or (module.QUICK if options.quick else module.FULL)
    found: Measured = module.run(config, options)
    return _result(name, options, asdict(config) | found.setup, found.metrics, found.paper, found.rows)


def run_all(options: BenchOptions, out: Path) -> ExperimentResult:
    """Every benchmark in turn, each with its own file in ``out``; the result holds them all, names before metrics."""
    metrics: dict[str, float | None] = {}
    paper: dict[str, float] = {}
    settings: dict[str, Any] = {}
    rows: list[dict[str, Any]] = []
    for done, name in enumerate(BENCHMARKS):

        def report(stage: str, fraction: float, name: str = name, done: int = done) -> None:
            options.progress(f"{name}: {stage}", (done + fraction) / len(BENCHMARKS))

        one = run_benchmark(name, replace(options, progress=report))
        write_result(out / f"bench_{name}.json", one)
        metrics |= {f"{name}_{key}": value for key, value in one.metrics.items()}
        paper |= {f"{name}_{key}": value for key, value in one.paper.items()}
        rows += [{"benchmark": name} | row for row in one.rows]
        settings[name] = one.config
    return _result("all", options, settings, metrics, paper, rows)


def _result(name: str, options: BenchOptions, settings: dict[str, Any], *found: Any) -> ExperimentResult:
    asked = ExperimentOptions(seed=options.seed, quick=options.quick)
    return make_result(f"bench_{name}", asked, settings | {"machine": machine()}, *found)


def describe(result: ExperimentResult) -> str:
    """The metrics, what was left out, and the machine, as text."""
    absent = [str(row["absent"]) for row in result.rows if "absent" in row]
    made = result.config["machine"]
    return "\n".join([table(result), *absent, f"{made['processor']}, {made['cores']} cores, {made['device']}"])


def machine() -> dict[str, str | int]:
    """What two results must have in common to be compared."""
    import jax

    return {"processor": _processor(), "cores": usable_cores(), "device": jax.devices()[0].device_kind}


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if "model name" in line]
        if names:
            return names[0]
    return platform.processor() or platform.machine()
