"""Progress display: current stage, fraction done and remaining time, as a bar, as log lines, or not at all."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from shmoo_mjx.base.verbosity import LOG, is_quiet, is_verbose

_EVERY = 10.0
"""Shortest time between two log lines that differ only in their numbers [s]."""


class _Lines:
    """Log replacement for rich's Progress: one line per new stage, and further lines at intervals."""

    def __init__(self) -> None:
        self._began = self._last = time.monotonic()
        self._what, self._total, self._said = "", 1.0, ""

    def add_task(self, what: str, total: float | None) -> int:
        self._what, self._total = what, total or 1.0
        return 0

    def update(self, task: int, completed: float, description: str | None = None, total: float | None = None) -> None:
        self._what, self._total = description or self._what, total or self._total
        now, new = time.monotonic(), re.sub(r"[\d.]+", "", self._what)
        if new == self._said and now - self._last < _EVERY:
            return
        self._said, self._last = new, now
        share, spent = min(completed / self._total, 1.0), now - self._began
        left = f", about {spent * (1 / share - 1):.0f} s left" if 0.02 < share < 1.0 else ""
        LOG.info("%s: %.0f %%%s", self._what, 100 * share, left)


@contextmanager
def _bar() -> Iterator[Any]:
    if is_verbose():
        yield _Lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
    times = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
    # Progress goes to stderr, so that a command's output can be piped.
    console = Console(stderr=True)
    with Progress(*columns, *times, console=console, disable=is_quiet()) as bar:
        try:
            yield bar
        except BaseException:
            # Remove the bar, so that only the error message remains.
            bar.live.transient, console.quiet = True, not console.is_terminal
            raise


@contextmanager
def stages() -> Iterator[Callable[[str, float], None]]:
    """Progress of work in named stages; the yielded function takes (stage, fraction done)."""
    with _bar() as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage[:60], completed=fraction)


@contextmanager
def counter(what: str) -> Iterator[Callable[[int, int], None]]:
    """Progress of countable work; the yielded function takes (done, total)."""
    with _bar() as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def training(what: str) -> Iterator[Callable[[Any], None]]:
    """Progress of a training; the yielded function takes a learning.training.Progress."""
    with _bar() as bar:
        task = bar.add_task(what, total=None)

        def report(p: Any) -> None:
            text = f"{what}: loss {p.train_loss:.4f}, validation {p.validation:.4f}, best {p.best:.4f}"
            bar.update(task, description=text, completed=p.epoch, total=p.epochs)

        yield report
