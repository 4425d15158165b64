"""Progress on the terminal: what is being done, how far, how long yet."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["counter", "stages", "training"]


@contextmanager
def _bar() -> Iterator[Any]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
    # To stderr, so that what a command prints can be piped.
    console = Console(stderr=True)
    with Progress(*columns, TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(), console=console) as bar:
        try:
            yield bar
        except BaseException:
            # Wiped: an error is told by its one sentence alone.
            bar.live.transient, console.quiet = True, not console.is_terminal
            raise


@contextmanager
def stages() -> Iterator[Callable[[str, float], None]]:
    """A bar for work in named stages: call with (stage, fraction done)."""
    with _bar() as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda stage, fraction: bar.update(task, description=stage[:60], completed=fraction)


@contextmanager
def counter(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar for countable work: call with (done, total)."""
    with _bar() as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def training(what: str) -> Iterator[Callable[[Any], None]]:
    """A bar for a training: call with a learning.training.Progress."""
    with _bar() as bar:
        task = bar.add_task(what, total=None)

        def report(p: Any) -> None:
            text = f"{what}: loss {p.train_loss:.4f}, validation {p.validation:.4f}, best {p.best:.4f}"
            bar.update(task, description=text, completed=p.chunk, total=p.chunks)

        yield report
