"""Figures of the experiment object_planner."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.files import write_whole
from shmoo_mjx.navigation.records import NavigatorConfig
from shmoo_mjx.report.figures import draw_decision, to_png
from shmoo_mjx.report.style import SERIES

__all__ = ["draw_figures"]


def draw_figures(folder: Path, rows: list[dict[str, Any]], episodes: Callable[[], list[tuple[str, Any, Any]]]) -> None:
    """Write K.png, confusion.png and planned_goals.png (the paper's Fig. 5) into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    found = [r for r in rows if r["decided"] is not None]
    write_whole(folder / "K.png", to_png(_histogram(found)))
    write_whole(folder / "confusion.png", to_png(_confusion(found)))
    write_whole(folder / "planned_goals.png", to_png(_planned_goals(episodes())))


def _histogram(rows: list[dict[str, Any]]) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.subplots()
    bins = np.geomspace(1e-4, 1e2, 37).tolist()
    for truth, label, colour in ((False, "not manipulable", SERIES[5]), (True, "manipulable", SERIES[0])):
        values = [r["K"] for r in rows if r["manipulable"] == truth]
        axes.hist(np.clip(values, bins[0], bins[-1]), bins, alpha=0.65, color=colour, label=f"{label} ({len(values)})")
    limit = NavigatorConfig().planner.threshold
    axes.axvline(limit, color="black", lw=1.4, ls="--", label=f"K = {limit:g} m²")
    axes.set_xscale("log")
    axes.set_xlabel("K when the verdict fell [m²]; the plant says which objects are manipulable")
    axes.set_ylabel("objects")
    axes.legend(fontsize=8)
    return figure


def _confusion(rows: list[dict[str, Any]]) -> Any:
    from matplotlib.figure import Figure

    names = ("not manipulable", "manipulable")
    table = np.zeros((2, 2), dtype=int)
    for r in rows:
        table[int(r["manipulable"]), int(r["decided"])] += 1
    figure = Figure(figsize=(4.4, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.imshow(table, cmap="Blues", vmin=0, vmax=max(int(table.sum()) / 2, 1))
    for (i, j), count in np.ndenumerate(table):
        axes.text(j, i, str(count), ha="center", va="center", fontsize=15, color="white" if i == j else "black")
    axes.set_xticks((0, 1), names)
    axes.set_yticks((0, 1), names, rotation=90, va="center")
    axes.set_xlabel("the robot's decision (K)")
    axes.set_ylabel("the plant's truth")
    return figure


def _planned_goals(episodes: list[tuple[str, Any, Any]]) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2 * len(episodes), 5.4), layout="constrained")
    for axes, (title, result, trace) in zip(figure.subplots(1, len(episodes)), episodes, strict=True):
        if result["decisions"]:
            last = len(result["decisions"]) - 1
            draw_decision(axes, result, trace, last)
            axes.set_title(f"{title}: K = {result['decisions'][last]['K']:.2f} m²", fontsize=11)
        else:
            axes.set_title(f"{title}: no decision", fontsize=11)
    return figure
