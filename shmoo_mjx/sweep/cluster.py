"""Distributes a sweep's shards with submitit: over a Slurm cluster, or over processes of this machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.sweep.config import SweepConfig
from shmoo_mjx.sweep.run import ShardRunner, Sweep

Cluster = Literal["slurm", "local", "debug"]
"""Slurm, other processes of this machine ("local"), or this process, one job after the other, for tests ("debug")."""


def job(config: SweepConfig, out: Path, weights: Path, part: tuple[int, int]) -> int:
    """Run one job: compute its missing shards on all devices of its machine.

    A job can be killed and started again, and jobs can run in parallel.

    Args:
        config: configuration of the sweep.
        out: folder of the sweep.
        weights: file with the weights of the learned model.
        part: (k, n) for the k-th of n jobs.

    Returns:
        Number of computed shards.
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
    """Start jobs and wait for them. If waiting is interrupted, the jobs continue.

    Args:
        sweep: sweep to compute; all machines must have access to its folder.
        jobs: number of jobs.
        cluster: where to run the jobs.
        options: options of submitit's executor.
        progress: function called with (stage, fraction of finished shards).
        poll: time between two checks of the jobs [s].

    Raises:
        ShmooError: submitit is missing, the cluster is not available, or a job failed.
    """
    total, jobs = len(sweep.shards), min(jobs, len(sweep.shards))
    started = _start(sweep, jobs, cluster, options)
    for one in started if cluster == "debug" else []:
        _result(one)  # a debug job runs when its result is requested
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
        # submitit's message contains the job's traceback between two dashed lines, followed by the paths of the logs.
        quoted = (str(error) or repr(error)).split("-" * 22)
        reason = quoted[len(quoted) // 2].strip().splitlines()[-1]
        raise ShmooError(f"{one.paths.stderr}: job {one.job_id} failed ({reason}); read it there.") from None
