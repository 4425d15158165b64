"""A sweep's shards over many machines, by submitit: Slurm, or processes of this machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.sweep.config import SweepConfig
from shmoo_mjx.sweep.run import ShardRunner, Sweep

Cluster = Literal["slurm", "local", "debug"]
"""Slurm; other processes of this machine; or this process, one job after the other, for tests."""


def job(config: SweepConfig, out: Path, weights: Path, part: tuple[int, int]) -> int:
    """The k-th of n jobs: computes its missing shards, on whatever devices its machine has. Says how many those were.

    It may be killed and started again, and run beside others.
    """
    runner = ShardRunner(Sweep.open(config, out, weights), part)
    runner.run()
    return len(runner.missing)


def submit(
    sweep: Sweep,
    jobs: int,
    cluster: Cluster,
    *,
    options: dict[str, Any],
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
    poll: float = 2.0,
) -> None:
    """Start ``jobs`` jobs and wait for them; whoever stops waiting leaves them running.

    The sweep's folder must be one that all machines see. ``options`` are those of submitit's executor, ``progress``
    takes (stage, share of the shards that are there), ``poll`` is the time between two looks [s].

    Raises:
        ShmooError: submitit is missing, there is no such cluster here, or a job failed.
    """
    total, jobs = len(sweep.shards), min(jobs, len(sweep.shards))
    started = _start(sweep, jobs, cluster, options)
    for one in started if cluster == "debug" else []:
        _result(one)  # a debug job runs when it is asked for its result
    while not all(one.done() for one in started):
        progress(f"{jobs} jobs", 1 - len(sweep.missing()) / total)
        time.sleep(poll)
    for one in started:
        _result(one)
    progress(f"{jobs} jobs", 1 - len(sweep.missing()) / total)


def _start(sweep: Sweep, jobs: int, cluster: Cluster, options: dict[str, Any]) -> list[Any]:
    try:
        import submitit
    except ImportError:
        raise ShmooError("shmoo sweep: --jobs needs the package submitit; install it.") from None
    try:
        executor = submitit.AutoExecutor(folder=sweep.out / "jobs", cluster=cluster)
    except RuntimeError as error:
        raise ShmooError(f"shmoo sweep: there is no {cluster} here ({error}); try --cluster local.") from None
    executor.update_parameters(name="shmoo-sweep", **options)
    with executor.batch():
        folder, weights = sweep.out.resolve(), sweep.weights.resolve()
        return [executor.submit(job, sweep.config, folder, weights, (k, jobs)) for k in range(jobs)]


def _result(one: Any) -> None:
    try:
        one.result()
    except Exception as error:
        # submitit quotes the job's trace between two dashed lines, then says where the logs are.
        quoted = (str(error) or repr(error)).split("-" * 22)
        reason = quoted[len(quoted) // 2].strip().splitlines()[-1]
        raise ShmooError(f"{one.paths.stderr}: job {one.job_id} failed ({reason}); read it there.") from None
