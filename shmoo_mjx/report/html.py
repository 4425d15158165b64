"""The report of a run: one self-contained HTML page with figures, tables and the video."""

from __future__ import annotations

import base64
import json
import re
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.base.files import write_whole
from shmoo_mjx.report import figures
from shmoo_mjx.report.style import to_png
from shmoo_mjx.report.trace import (
    Trace,
    is_number,
    load_result,
    load_trace,
    object_index,
    object_name,
    telling_decisions,
)
from shmoo_mjx.report.video import SPEED

MAX_VIDEO_BYTES = 12_000_000
"""Size from which on a video is linked instead of embedded [bytes]."""
_FILM = f"{SPEED:g} times as fast as the run."
_SUCCESS = ("success", "reached", "goal_reached", "goal reached", "done")


def write_report(run_dir: str | Path) -> Path:
    """Write ``report.html`` for a run.

    It reads ``result.json``, ``trace.npz`` and, if it exists, ``episode.mp4``.

    Args:
        run_dir: folder of the run, in which the report is written.

    Returns:
        Path of the report.

    Raises:
        ShmooError: a file is missing or damaged.
    """
    folder = Path(run_dir)
    result, trace = load_result(folder / "result.json"), load_trace(folder / "trace.npz")
    video = folder / "episode.mp4"
    page = render_report(result, trace, video if video.is_file() else None)
    return write_whole(folder / "report.html", page.encode("utf-8"))


def render_report(result: dict[str, Any], trace: Trace, video: Path | None = None) -> str:
    """The HTML page. ``video`` is embedded if it is smaller than ``MAX_VIDEO_BYTES``, and linked otherwise."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["number"] = _number
    environment.filters["pose"] = _pose
    environment.filters["object_name"] = lambda name: object_name(result, name)
    environment.filters["by_name"] = lambda text: _by_name(result, text)
    recorded = "summary" in result  # log of another robot (custom_log.py)
    source = resources.files("shmoo_mjx.report").joinpath("report.html.j2").read_text(encoding="utf-8")
    return environment.from_string(source).render(
        title=result.get("name") or "run",
        good=succeeded(result) or recorded,
        recorded=recorded,
        pushing=result.get("push_to") is not None,
        outcome=str(result["outcome"]).replace("_", " "),
        summary=result.get("summary") or summary(result),
        tiles=_tiles(result),
        result=result,
        objects=[_object_row(item) for item in result["objects"]],
        map_png=_embed(to_png(figures.map_figure(result, trace))),
        decision_pngs=[
            (i, _embed(to_png(figures.decision_figure(result, trace, i), dpi=100)))
            for i in telling_decisions(result)
            if not recorded and result.get("push_to") is None
        ],
        learned_png=_learned(result, trace),
        timeline_png=_embed(to_png(figures.timeline_figure(result, trace))),
        video=_video(video),
        command=_command(result),
        versions=result.get("versions") or {},
        config=json.dumps(result["config"], indent=2, sort_keys=True) if result.get("config") else "",
    )


def _by_name(result: dict[str, Any], text: Any) -> str:
    """A reason in which "object 0" is replaced by the object's name on the page."""
    return re.sub(r"\bobject (\d+)", lambda match: object_name(result, int(match[1])), str(text))


def succeeded(result: dict[str, Any]) -> bool:
    """True if the outcome is one of the words for success."""
    return str(result["outcome"]).lower() in _SUCCESS


def summary(result: dict[str, Any]) -> str:
    """Summary of the run in one paragraph."""
    pushed = result.get("push_to") is not None
    first = f"The robot brought {_name(result['objects'][0])} to its goal" if pushed else "The robot reached its goal"
    if not succeeded(result):
        why = str(result.get("reason") or result["outcome"]).replace("_", " ").rstrip(".")
        first = f"The run ended without success ({why})"
    if is_number(result.get("time_s")):
        first += f" after {result['time_s']:.0f} s"
    if is_number(result.get("path_length_m")):
        first += f", having driven {result['path_length_m']:.1f} m"
    if is_number(result.get("goal_distance_m")):
        first += f", and {'left it' if pushed else 'ended'} {result['goal_distance_m']:.2f} m from the goal"
    sentences = [first + "."]
    sentences += [_object_sentence(result, item) for item in result["objects"]]
    falls, contacts = result.get("falls"), result.get("wall_contacts")
    if is_number(falls) and is_number(contacts):
        fell = f"It fell {_times(falls)} and touched a wall {_times(contacts)}."
        sentences.append(fell if falls or contacts else "It never fell and never touched a wall.")
    return " ".join(sentences)


def _object_sentence(result: dict[str, Any], item: dict[str, Any]) -> str:
    index = object_index(result, item["id"])
    mine = [d for d in result["decisions"] if object_index(result, d["object"]) == index]
    decided = [d for d in mine if is_number(d.get("K")) or is_number(d.get("probability"))]
    # Show the last decision for a registered object, and the first decision for a pushed one.
    told = f" ({figures.evidence(decided[-1 if item.get('registered') else 0])})" if decided else ""
    name, moved = _name(item), _moved(item)
    if item.get("toppled"):
        return f"It knocked {name} over{told}."
    if item.get("registered"):
        return f"It concluded that {name} can't be moved{told} and went on with it as an obstacle in the map."
    if moved > 0.05:
        return f"It pushed {name} by {moved:.2f} m{told}."
    return f"It left {name} where it was{told}."


def _name(item: dict[str, Any]) -> str:
    return f"{item['family']} {item['id']}"


def _times(count: Any) -> str:
    return {0: "not once", 1: "once", 2: "twice"}.get(count, f"{count:.0f} times")


def _tiles(result: dict[str, Any]) -> list[tuple[str, str]]:
    measures = (
        ("time", "time_s", "{:.1f} s"),
        ("driven", "path_length_m", "{:.2f} m"),
        ("from the goal", "goal_distance_m", "{:.2f} m"),
        ("falls", "falls", "{:.0f}"),
        ("wall contacts", "wall_contacts", "{:.0f}"),
        ("seed", "seed", "{:.0f}"),
    )
    tiles = [(label, form.format(result[key])) for label, key, form in measures if is_number(result.get(key))]
    return [*tiles, ("senses", str(result["senses"]))] if result.get("senses") else tiles


def _object_row(item: dict[str, Any]) -> dict[str, Any]:
    return {"description": "", **item, "moved": _moved(item), "registered": bool(item.get("registered"))}


def _moved(item: dict[str, Any]) -> float:
    start, final = np.asarray(item["start_pose"], dtype=float), np.asarray(item["final_pose"], dtype=float)
    return float(np.linalg.norm(final[:2] - start[:2]))


def _learned(result: dict[str, Any], trace: Trace) -> str:
    if not (np.asarray(trace.learned_object) >= 0).any():
        return ""
    return _embed(to_png(figures.learned_figure(result, trace)))


def _command(result: dict[str, Any]) -> str:
    """The command that repeats the run, from the parent of the run's folder; empty for a result without a name."""
    name = str(result.get("name") or "")
    if result.get("command"):
        return str(result["command"])
    return f"uv run shmoo navigate --scenario {name}/scenario.yaml --out {name}-again" if name else ""


def _video(path: Path | None) -> dict[str, str] | None:
    if path is None:
        return None
    if path.stat().st_size >= MAX_VIDEO_BYTES:
        note = f"{_FILM} It is too large to embed and lies beside this page as {path.name}."
        return {"source": path.name, "note": note}
    return {"source": _embed(path.read_bytes(), "video/mp4"), "note": _FILM}


def _embed(data: bytes, kind: str = "image/png") -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"


def _number(value: Any, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if is_number(value) else "–"  # noqa: RUF001 (an en dash for "no value")


def _pose(value: Any) -> str:
    """A pose as text (x, y, yaw in degrees), or a point as (x, y)."""
    if value is None:
        return "–"  # noqa: RUF001
    text = ", ".join(f"{float(v):.2f}" for v in value[:2])
    return f"({text}, {round(np.degrees(float(value[2]))):d}°)" if len(value) > 2 else f"({text})"
