"""The report of a run: one self-contained HTML page with figures, tables and the video."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from shmoo_mjx.base.files import write_whole
from shmoo_mjx.report import figures, words
from shmoo_mjx.report.style import to_png
from shmoo_mjx.report.trace import Trace, is_number, load_result, load_trace, telling_decisions
from shmoo_mjx.report.video import SPEED

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_VIDEO_BYTES = 12_000_000
"""Size from which on a video is linked instead of embedded [bytes]."""
_FILM = f"{SPEED:g} times as fast as the run."


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
    environment.filters["object_name"] = lambda name: words.object_name(result, name)
    environment.filters["by_name"] = lambda text: words.by_name(result, text)
    environment.filters["percent"] = lambda p: words.percent(p) if is_number(p) else _number(p)
    environment.filters["options"] = _options
    recorded = "summary" in result  # log of another robot (custom_log.py)
    source = resources.files("shmoo_mjx.report").joinpath("report.html.j2").read_text(encoding="utf-8")
    return environment.from_string(source).render(
        title=result.get("name") or "run",
        good=words.succeeded(result) or recorded,
        recorded=recorded,
        pushing=result.get("push_to") is not None,
        outcome=str(result["outcome"]).replace("_", " "),
        summary=result.get("summary") or words.summary(result),
        tiles=_tiles(result),
        result=result,
        objects=[_object_row(item) for item in result["objects"]],
        map_png=_both(figures.map_figure, result, trace),
        decision_pngs=[
            (i, _embed(to_png(figures.decision_figure(result, trace, i), dpi=100)))
            for i in telling_decisions(result)
            if not recorded and result.get("push_to") is None
        ],
        learned_png=_learned(result, trace),
        known=any(item.get("true") for item in result["objects"]),
        timeline_png=_both(figures.timeline_figure, result, trace),
        video=_video(video),
        command=_command(result),
        versions=result.get("versions") or {},
        config=json.dumps(result["config"], indent=2, sort_keys=True) if result.get("config") else "",
    )


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
    return [*tiles, ("sensing", str(result["senses"]))] if result.get("senses") else tiles


def _object_row(item: dict[str, Any]) -> dict[str, Any]:
    return {"description": "", **item, "moved": words.moved(item), "registered": bool(item.get("registered"))}


def _options(decision: dict[str, Any]) -> list[dict[str, Any]]:
    """The options of a decision with expected times and probabilities as text."""
    options = decision.get("options") or ()
    # Without a way round the mean contains the assumed cost of giving up, which says little.
    round_ = any(option["text"] == words.GO_ROUND for option in options)
    return [
        {
            "text": option["text"],
            "seconds": f"{option['mean_s']:.0f} s" if round_ else f"{option['works_s']:.0f} s if it works",
            "chance": "" if option["text"] == words.GO_ROUND else words.percent(option["probability"]),
        }
        for option in options
    ]


def _learned(result: dict[str, Any], trace: Trace) -> dict[str, str] | None:
    if not (np.asarray(trace.learned_object) >= 0).any():
        return None
    return _both(figures.learned_figure, result, trace)


def _both(figure: Callable[..., Figure], result: dict[str, Any], trace: Trace) -> dict[str, str]:
    """A figure for a desk and for a phone."""
    widths = {"wide": figures.WIDE, "narrow": figures.NARROW}
    return {name: _embed(to_png(figure(result, trace, width))) for name, width in widths.items()}


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
