"""Benchmarks by name. A benchmark is a module that is imported only when it runs.

The module has the sizes ``FULL`` and ``QUICK``, and the function ``run(config, options) -> Measured``. If it has
``GPU``, these sizes replace ``FULL`` on a machine with a graphics card.
"""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from pathlib import Path
from shutil import which
from typing import Any

from shmoo_mjx.arrays import single_precision
from shmoo_mjx.base.guard import EXPERIMENT, check_output
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result, table, write_result

from .compare import compare_files as compare_files
from .workers import usable_cores

BENCHMARKS = ("startup", "plant", "planner", "demo", "navigation", "mppi", "daiml")
"""Names of the modules here that are benchmarks."""


@dataclass(frozen=True)
class BenchOptions:
    """Options of a run of a benchmark."""

    quick: bool = False
    """Whether to measure the short form."""
    peers_python: Path | None = None
    """Interpreter that has the peers installed (default: the one that runs this)."""
    seed: int = 0
    """Seed of random weights and noise."""
    progress: Callable[[str, float], None] = lambda stage, fraction: None
    """Called with (stage, fraction done)."""
    maps: Path | None = None
    """Folder of map_server maps, for the benchmark navigation."""

    def __post_init__(self) -> None:
        if self.peers_python is not None and which(self.peers_python) is None:
            raise ShmooError(
                f"--peers-python {self.peers_python}: is no program; give the path of a Python interpreter."
            )


@dataclass(frozen=True)
class Measured:
    """Result of a benchmark."""

    metrics: dict[str, Any]
    rows: list[dict[str, Any]]
    setup: dict[str, Any] = field(default_factory=dict)
    """Entries of the result's config in addition to the sizes."""
    paper: dict[str, float] = field(default_factory=dict)
    """Published numbers, by the names of the metrics that they compare with."""


@single_precision
def run_benchmark(name: str, options: BenchOptions, sizes: Any = None) -> ExperimentResult:
    """Run one benchmark. The config of its result contains the machine.

    Args:
        name: one of `BENCHMARKS`.
        options: options of the run.
        sizes: sizes in place of those of the benchmark, or None.

    Raises:
        ShmooError: the name is unknown.
    """
    if name not in BENCHMARKS:
        names = ", ".join(BENCHMARKS)
        raise ShmooError(f"benchmark {name!r} is not known; choose one of {names}, all or compare.")
    module = import_module(f".{name}", __package__)
    whole = getattr(module, "GPU", module.FULL) if _on_gpu() else module.FULL
    config = sizes or (module.QUICK if options.quick else whole)
    measured: Measured = module.run(config, options)
    settings = asdict(config) | measured.setup
    return _result(name, options, settings, measured)


def run_all(options: BenchOptions, out: Path) -> ExperimentResult:
    """Run every benchmark in turn, and write a file for each to ``out``.

    Returns:
        One result of all benchmarks. The name of a metric starts with that of its benchmark.
    """
    every, settings = Measured({}, []), dict[str, Any]()
    for name in BENCHMARKS:
        check_output(out / f"bench_{name}.json", EXPERIMENT)
    for done, name in enumerate(BENCHMARKS):

        def report(stage: str, fraction: float, name: str = name, done: int = done) -> None:
            options.progress(f"{name}: {stage}", (done + fraction) / len(BENCHMARKS))

        one = run_benchmark(name, replace(options, progress=report))
        write_result(out / f"bench_{name}.json", one)
        every.metrics.update({f"{name}_{key}": value for key, value in one.metrics.items()})
        every.paper.update({f"{name}_{key}": value for key, value in one.paper.items()})
        every.rows.extend({"benchmark": name} | row for row in one.rows)
        settings[name] = one.config
    return _result("all", options, settings, every)


def _result(name: str, options: BenchOptions, settings: dict[str, Any], measured: Measured) -> ExperimentResult:
    sizes = ExperimentOptions(seed=options.seed, quick=options.quick)
    settings = settings | {"machine": machine()}
    return make_result(f"bench_{name}", sizes, settings, measured.metrics, paper=measured.paper, rows=measured.rows)


def _on_gpu() -> bool:
    import jax

    return bool(jax.default_backend() == "gpu")


def describe(result: ExperimentResult) -> str:
    """The metrics, the reasons for absent peers, and the machine, as text."""
    absent = [str(row["absent"]) for row in result.rows if "absent" in row]
    made = result.config["machine"]
    return "\n".join([table(result), *absent, f"{made['processor']}, {made['cores']} cores, {made['device']}"])


def machine() -> dict[str, str | int]:
    """Properties of the machine, which two results must share to be compared."""
    import jax

    return {"processor": _processor(), "cores": usable_cores(), "device": jax.devices()[0].device_kind}


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if "model name" in line]
        if names:
            return names[0]
    return platform.processor() or platform.machine()
