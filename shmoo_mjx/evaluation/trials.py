"""Trials of an experiment in files of their own, so that an interrupted experiment goes on where it was stopped."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import as_completed
from functools import cache
from pathlib import Path
from typing import Any

from shmoo_mjx.arrays import single_precision
from shmoo_mjx.base.files import write_whole
from shmoo_mjx.base.processes import process_pool

Work = Callable[[Any], list[dict[str, Any]]]
"""What is to be tried -> its rows. Must be picklable."""


def run_trials(
    trials: Mapping[str, Any],
    work: Work,
    folder: Path,
    progress: Callable[[str, float], None],
    *,
    workers: int = 2,
) -> list[dict[str, Any]]:
    """The rows of every trial, in the order of ``trials``; those that ``folder`` has already are read from it.

    Args:
        trials: what ``work`` is called with, by names that are good as file names.
        work: runs one; called in other processes if ``workers`` > 1.
        folder: gets NAME.json for each.
        progress: called with (stage, fraction done).
        workers: processes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = {name: folder / f"{name}.json" for name in trials}
    missing = {name: trial for name, trial in trials.items() if not files[name].is_file()}
    done = len(trials) - len(missing)
    progress(f"{done} of {len(trials)} trials were there", done / max(len(trials), 1))
    for name, rows in _worked(missing, work, min(workers, len(missing))):
        done += 1
        write_whole(files[name], (json.dumps(rows, indent=1) + "\n").encode())
        progress(f"trial {name}", done / len(trials))
    return [row for file in files.values() for row in json.loads(file.read_text())]


def one_core() -> None:
    """Before a worker's first computation: the trials run side by side, so that each keeps to one core."""
    import jax

    jax.config.update("jax_num_cpu_devices", 1)
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false".strip()


def _worked(trials: Mapping[str, Any], work: Work, workers: int) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    if workers <= 1:
        yield from ((name, _tried(work, trial)) for name, trial in trials.items())
        return
    with process_pool(min(workers, os.cpu_count() or 1), one_core) as pool:
        waiting = {pool.submit(_tried, work, trial): name for name, trial in trials.items()}
        for future in as_completed(waiting):
            yield waiting[future], future.result()


@single_precision
def _tried(work: Work, trial: Any) -> list[dict[str, Any]]:
    return work(trial)


@cache
def controller_of(weights: Path, method: str = "ours") -> Any:
    """The pushing controller of a weights file and a method, compiled once in each process."""
    from shmoo_mjx.behavior.methods import method_named

    return method_named(method).controller(weights)
