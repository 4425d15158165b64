"""The command ``shmoo sweep``: prints an estimate, computes the missing shards, and writes table and figures."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from shmoo_mjx.base.assets import asset
from shmoo_mjx.base.files import claimed, write_whole
from shmoo_mjx.base.options import SensesName
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.sweep.cluster import Cluster, submit
from shmoo_mjx.sweep.config import SweepConfig, load_sweep, quick
from shmoo_mjx.sweep.run import ShardRunner, Sweep, duration, read_table

Progress = Callable[[], AbstractContextManager[Callable[[str, float], None]]]


def find(name: Path) -> Path:
    """Path of a sweep file, or of the shipped sweep with that name."""
    shipped = asset(f"experiments/sweeps/{name.name.removesuffix('.yaml')}.yaml")
    return shipped if not name.exists() and len(name.parts) == 1 and shipped.exists() else name


def carry_out(
    name: Path,
    out: Path | None,
    *,
    weights: Path | None,
    short: bool,
    only_estimate: bool,
    memory_gb: float | None,
    jobs: int,
    cluster: Cluster,
    options: tuple[str, ...],
    progress: Progress,
    senses: SensesName | None = None,
) -> list[Path]:
    """Run or resume a sweep. Prints the estimated time first and the summary last.

    Args:
        name: sweep file, or the name of a shipped sweep.
        out: folder for shards, table and figures; by default runs/sweeps/NAME.
        weights: trained weights; by default the shipped ones.
        short: run the short form (`quick`).
        only_estimate: print the expected time and memory, and compute nothing.
        memory_gb: memory limit for a batch of worlds [GB]; by default the free memory.
        jobs: number of cluster jobs; 0 computes in this process.
        cluster: kind of cluster, with ``jobs``.
        options: settings of submitit as ``name=value`` texts, with ``jobs``.
        progress: opens a progress display, which is called with (text, fraction).
        senses: replaces the sensing that the file names.

    Returns:
        Paths of the written files; empty with ``only_estimate``.

    Raises:
        ShmooError: file, options or weights are wrong, or ``out`` holds another sweep.
    """
    cluster_options, path = _options(options), find(name)
    config = quick(load_sweep(path)) if short else load_sweep(path)
    if senses is not None:
        config = config.model_copy(update={"senses": senses})
    sweep = Sweep.open(config, out or Path("runs/sweeps") / f"{path.stem}{'-quick' if short else ''}", weights)
    there = len(sweep.shards) - len(sweep.missing())
    if there:
        print(f"{sweep.out}: {there} of {len(sweep.shards)} shards are there")
    if jobs and sweep.missing() and not only_estimate:
        with progress() as report:
            submit(sweep, jobs, cluster, options=cluster_options, progress=report)
    elif sweep.missing():
        # The claim comes first, so that a second process fails before it compiles for a minute.
        with claimed(sweep.out):
            if not _alone(sweep, memory_gb, only_estimate, progress):
                return []
    return _collected(config, sweep)


def _alone(sweep: Sweep, memory_gb: float | None, only_estimate: bool, progress: Progress) -> bool:
    """Compute the missing shards in this process. Returns False if only the estimate was requested."""
    runner = ShardRunner(sweep, memory=int(memory_gb * 1e9) if memory_gb else None)
    print("compiling; then one second of each is timed", flush=True)
    seconds = 0.0
    for estimate in runner.estimate():
        seconds += estimate.seconds
        print(estimate, flush=True)
    print(f"about {duration(seconds)} in all on {_devices()}", flush=True)
    if only_estimate:
        return False
    with progress() as report:
        runner.run(report)
    return True


def _collected(config: SweepConfig, sweep: Sweep) -> list[Path]:
    from shmoo_mjx.sweep.figures import draw_figures, summary

    results = sweep.collect()
    table = read_table(results)
    text = summary(config, table)
    print(text)
    write_whole(sweep.out / "summary.txt", (text + "\n").encode())
    return [results, sweep.out / "summary.txt", *draw_figures(config, table, sweep.out)]


def _devices() -> str:
    import jax

    kinds = [d.device_kind for d in jax.devices()]
    return f"{len(kinds)} x {kinds[0]}"


def _options(options: tuple[str, ...]) -> dict[str, Any]:
    """Parse ``name=value`` texts; values of digits become integers."""
    values: dict[str, Any] = {}
    for option in options:
        name, equals, value = option.partition("=")
        if not equals or not name.isidentifier():
            raise ShmooError(f"--options {option!r} must be name=value, such as timeout_min=60.")
        values[name] = int(value) if value.isdecimal() else value
    return values
