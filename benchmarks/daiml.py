"""Speed and memory of DAIML: an epoch of Neural-Fly's size, the cost of more conditions, and the shipped training.

Every row comes from a fresh process. Times exclude compilation, except for the whole training and ``first_chunk_s``.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.base.processes import process_pool
from shmoo_mjx.data import store
from shmoo_mjx.evaluation.datasets import TRAINING

from .registry import BenchOptions, Measured
from .workers import usable_cores

Row = dict[str, Any]

CHUNKS = 6
"""Number of chunks of a timed training. The first one compiles. Between two chunks, Python runs and scores a
condition."""
REFERENCE = {"neural_fly_epoch_ms": 33.0}
"""Time of an epoch in Neural-Fly's PyTorch code on one thread of a similar machine [ms]."""


@dataclass(frozen=True)
class DaimlSizes:
    """Sizes of the benchmark."""

    epochs: int = 200
    """Neural-Fly epochs per chunk; 0 leaves this part out."""
    conditions: tuple[int, ...] = (12, 48, 120, 480)
    """Numbers of training conditions."""
    whole: bool = True
    """Whether to train the shipped psi from start to end."""


FULL = DaimlSizes()
QUICK = DaimlSizes(epochs=50, conditions=(12, 120), whole=False)
GPU = DaimlSizes(epochs=0, conditions=(480,), whole=False)


def _one_thread() -> None:
    """Restrict this process to one core and XLA to one thread. JAX must not have started yet."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    flags = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}"


def _fresh(prepare: Callable[[], None] | None, work: Callable[..., Row], *arguments: Any) -> Row:
    """Run ``work`` in a process of its own."""
    with process_pool(1, prepare) as pool:
        return pool.submit(work, *arguments).result()


def _peak_bytes() -> int:
    """Peak memory of this process [bytes]. Unlike ru_maxrss, it does not include the parent process."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return 1024 * int(line.split()[1])
    return 0


def _law(rng: np.random.Generator, rows: int, inputs: int) -> tuple[np.ndarray, np.ndarray]:
    x = rng.normal(size=(rows, inputs))
    return x, np.tanh(x[:, :3]) * rng.uniform(0.5, 2.0, 3) + 0.1 * rng.normal(size=(rows, 3))


def _timed(train: Callable[[Callable[[Any], None]], Any], per_chunk: int) -> Row:
    """Times per step [ms], from chunks of ``per_chunk`` steps without the first chunk, which compiles.

    ``ms`` is the time of the fastest chunk. ``cpu_ms`` counts only the processor time of this process, so other
    processes add little.
    """
    started = time.perf_counter()
    ends: list[tuple[float, float]] = []
    train(lambda progress: ends.append((time.perf_counter(), time.process_time())))
    wall, cpu = 1e3 * np.diff(ends, axis=0).T / per_chunk
    times = {"ms": min(wall), "ms_median": np.median(wall), "cpu_ms": np.median(cpu)}
    return {k: round(float(v), 3) for k, v in times.items()} | {"first_chunk_s": round(ends[0][0] - started, 2)}


def neural_fly_epoch(epochs: int) -> Row:
    """The row of an epoch of Neural-Fly's size: 3 conditions with one update each.

    Batch 256, K-shot 32, phi 11-50-60-50-3, adversary every other time.
    """
    from shmoo_mjx.dynamics.object_model import ObjectConfig
    from shmoo_mjx.learning import daiml

    rng = np.random.default_rng(0)
    shape = ObjectConfig(hidden=(50, 60, 50), functions=3, per_axis=False, linear_terms=False)
    config = daiml.DaimlConfig(
        object=shape,
        horizon=1,
        conditions=1,
        adapt_samples=32,
        windows=256,
        coupled=False,
        alpha=0.01,
        epochs=CHUNKS,
        epoch_updates=3 * epochs,
        patience=CHUNKS,
    )
    data = {str(c): _law(rng, 6000, 11) for c in range(3)}
    held_out = {"held out": _law(rng, 600, 11)}
    found = _timed(lambda report: daiml.fit(data, held_out, config, progress=report), epochs)
    speed_up = round(REFERENCE["neural_fly_epoch_ms"] / found["ms"], 1)
    return {"name": "neural_fly_epoch", **found, "speed_up": speed_up}


def more_conditions(conditions: int) -> Row:
    """The row of an update with the shipped settings. It uses 12 conditions, whatever the number of ``conditions``."""
    from shmoo_mjx.dynamics import features
    from shmoo_mjx.learning import daiml
    from shmoo_mjx.learning.samples import Samples

    rng = np.random.default_rng(0)
    updates, n, length = 30, 952, 119
    run = np.tile(np.arange(length, 0, -1), (conditions, n // length))

    def rows(count: int) -> Samples:
        inputs = 0.3 * rng.normal(size=(count, n, features.width(features.OBJECT_INPUTS))).astype(np.float32)
        inputs[..., features.slices(features.OBJECT_INPUTS)["size"]] = 0.5
        labels = 0.3 * rng.normal(size=(count, n, 3)).astype(np.float32)
        return Samples(inputs, labels, np.ones((count, n), np.float32), run[:count].astype(np.int32))

    config = daiml.DaimlConfig(epochs=4, epoch_updates=updates, patience=4)
    train, held_out = rows(conditions), rows(3)
    before = _peak_bytes()
    found = _timed(lambda report: daiml.fit_samples(train, held_out, config, progress=report), updates)
    return {
        "name": f"update_{conditions}_conditions",
        **found,
        "data_mb": round(sum(np.asarray(leaf).nbytes for leaf in train) / 2**20, 1),
        "peak_mb": round(_peak_bytes() / 2**20),
        "peak_before_mb": round(before / 2**20),
    }


def whole_training(data: Path) -> Row:
    """The row of the shipped training of psi from start to end, including reading and compilation."""
    from shmoo_mjx.learning import daiml

    started = time.perf_counter()
    fitted = daiml.train_object(data)
    seconds = time.perf_counter() - started
    return {
        "name": "whole_training",
        "s": round(seconds, 1),
        "chunks": len(fitted.history),
        "score": round(float(fitted.score), 4),
        "peak_mb": round(_peak_bytes() / 2**20),
    }


def run(config: DaimlSizes, options: BenchOptions) -> Measured:
    """All rows. The shipped training takes minutes. It runs only if data/train exists, and not in a quick run."""
    jobs: list[tuple[Callable[[], None] | None, Callable[..., Row], tuple[Any, ...]]] = []
    if config.epochs:
        jobs.append((_one_thread, neural_fly_epoch, (config.epochs,)))
    jobs += [(None, more_conditions, (count,)) for count in config.conditions]
    if config.whole and (TRAINING / store.MANIFEST).exists():
        jobs.append((None, whole_training, (TRAINING,)))
    rows = []
    for done, (prepare, work, arguments) in enumerate(jobs):
        options.progress(work.__name__, done / len(jobs))
        rows.append(_fresh(prepare, work, *arguments))
    metrics = {f"{row['name']}_{key}": value for row in rows for key, value in row.items() if key != "name"}
    return Measured(metrics, rows, {"cores": usable_cores()}, REFERENCE)
