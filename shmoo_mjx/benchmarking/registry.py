"""The benchmarks by name. Each module has ``run(ask) -> ExperimentResult`` and is imported only when asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.result import ExperimentResult

__all__ = ["BENCHMARKS", "BenchAsk", "run_benchmark"]

BENCHMARKS = {"mppi": "shmoo_mjx.benchmarking.mppi", "daiml": "shmoo_mjx.benchmarking.daiml"}
"""Name to module."""


@dataclass(frozen=True)
class BenchAsk:
    """What the command line asks of a benchmark."""

    quick: bool = False
    """A short form of the same shape."""
    peers_python: Path | None = None
    """Interpreter that has the peers installed (default: the one that runs this)."""
    seed: int = 0
    """Of made-up weights and noise."""
    progress: Callable[[str, float], None] = lambda stage, fraction: None
    """Called with (stage, fraction done)."""


def run_benchmark(name: str, ask: BenchAsk) -> ExperimentResult:
    """Run one benchmark."""
    if name not in BENCHMARKS:
        raise ShmooError(f"benchmark {name!r} is not known; choose one of {', '.join(BENCHMARKS)}.")
    result: ExperimentResult = import_module(BENCHMARKS[name]).run(ask)
    return result
