"""Trials of an experiment in files of their own, so that an interrupted experiment goes on where it was stopped."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

from shmoo_mjx.files import write_whole
from shmoo_mjx.processes import process_pool

__all__ = ["run_trials"]

Work = Callable[[Any], list[dict[str, Any]]]
"""What is to be tried -> its rows. Must be picklable."""


def run_trials(
    trials: Sequence[str] | Mapping[str, Any],
    work: Work,
    folder: Path,
    progress: Callable[[str, float], None],
    workers: int = 2,
) -> list[dict[str, Any]]:
    """The rows of every trial, in the order of ``trials``; those that ``folder`` has already are read from it.

    Args:
        trials: names, good as file names, and what ``work`` is called with: the name itself if nothing else is given.
        work: runs one; called in other processes if ``workers`` > 1.
        folder: gets NAME.json for each.
        progress: called with (stage, fraction done).
        workers: processes.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = list(trials)
    given = trials if isinstance(trials, Mapping) else dict(zip(names, names, strict=True))
    missing = {name: given[name] for name in names if not (folder / f"{name}.json").is_file()}
    done = len(names) - len(missing)
    progress(f"{done} of {len(names)} trials were there", done / max(len(names), 1))
    for name, rows in _worked(missing, work, min(workers, len(missing))):
        write_whole(folder / f"{name}.json", (json.dumps(rows, indent=1) + "\n").encode())
        done += 1
        progress(f"trial {name}", done / len(names))
    return [row for name in names for row in json.loads((folder / f"{name}.json").read_text())]


def _worked(trials: Mapping[str, Any], work: Work, workers: int) -> Any:
    if workers <= 1:
        yield from ((name, work(given)) for name, given in trials.items())
        return
    with process_pool(min(workers, os.cpu_count() or 1)) as pool:
        waiting = {pool.submit(work, given): name for name, given in trials.items()}
        for future in as_completed(waiting):
            yield waiting[future], future.result()
