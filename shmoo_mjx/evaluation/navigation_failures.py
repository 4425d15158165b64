"""Keeps failed runs, and writes a film of each and a list by cause."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from shmoo_mjx.base.files import write_whole
from shmoo_mjx.report.trace import load_trace, save_trace

if TYPE_CHECKING:
    from shmoo_mjx.run.episode import Episode

FPS, SPEED = 10.0, 4.0
"""Frames per second of a film, and seconds of the run per second of film."""


def keep_failure(store: Path, name: str, episode: Episode) -> None:
    """Keep the trace and result of a failed run for its film. Traces are too large to keep for every run."""
    folder = store / "failures"
    folder.mkdir(parents=True, exist_ok=True)
    save_trace(folder / f"{name}.npz", episode.trace)
    write_whole(folder / f"{name}.json", json.dumps(episode.result, default=float).encode())
    (folder / f"{name}.mp4").unlink(missing_ok=True)


def write_failures(
    folder: Path,
    rows: list[dict[str, Any]],
    store: Path,
    progress: Callable[[str, float], None] = lambda stage, fraction: None,
) -> Path:
    """Write ``folder / failures.md``, a list of failed runs by cause, with a film of each from above.

    Args:
        folder: folder of the list.
        rows: rows of all runs of one policy.
        store: folder with the runs that `keep_failure` has kept. The films are written there too.
        progress: called with (stage, fraction of the films done).

    Returns:
        The path of the list.
    """
    failed = [row for row in rows if not row["success"]]
    by_cause: dict[str, list[str]] = defaultdict(list)
    for number, row in enumerate(failed):
        name = f"{row['map']}-{row['scenario']}"
        progress(f"film of {name}", number / len(failed))
        film = _film(store / "failures", name)
        title = re.sub(r"([\[\]])", r"\\\1", name)
        if film is not None:
            title = f"[{title}]({quote(film.relative_to(folder).as_posix())})"
        by_cause[row["cause"]].append(f"- {title}, {row['kind']}, {row['time_s']:.0f} s: {row['reason']}")
    lines = [f"# {len(failed)} of {len(rows)} runs failed"]
    for cause, items in sorted(by_cause.items(), key=lambda item: -len(item[1])):
        lines += [f"## {cause} ({len(items)})", "\n".join(items)]
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / "failures.md"
    write_whole(target, ("\n\n".join(lines) + "\n").encode())
    return target


def _film(folder: Path, name: str) -> Path | None:
    """The film of a failed run; None if the run was not kept."""
    from shmoo_mjx.report.video import topdown_frames, write_video

    film = folder / f"{name}.mp4"
    if film.is_file():
        return film
    if not (folder / f"{name}.npz").is_file():
        return None
    result = json.loads((folder / f"{name}.json").read_text())
    return write_video(film, topdown_frames(result, load_trace(folder / f"{name}.npz"), fps=FPS, speed=SPEED), FPS)
