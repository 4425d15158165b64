"""Runs the trials of an experiment and keeps each in a file, so that an interrupted experiment can resume."""

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
"""Runs one trial and returns its rows. Must be picklable."""


def run_trials(
    trials: Mapping[str, Any],
    work: Work,
    folder: Path,
    progress: Callable[[str, float], None],
    *,
    workers: int = 2,
) -> list[dict[str, Any]]:
    """The rows of all trials in the order of ``trials``. Trials with a file in ``folder`` are not run again.

    Args:
        trials: arguments of ``work`` by name. The names serve as file names.
        work: runs one trial, in another process if ``workers`` > 1.
        folder: gets a file NAME.json per trial.
        progress: called with (stage, fraction done).
        workers: number of processes.
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
    """Limit this process to one core. Workers call it before their first computation, as trials run side by side."""
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
    """The pushing controller of a weights file and a method. It is compiled once per process."""
    from shmoo_mjx.behavior.methods import method_named

    return method_named(method).controller(weights)
