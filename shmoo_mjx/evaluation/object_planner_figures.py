"""Figures of the experiment object_planner."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.behavior.state import NavigatorConfig
from shmoo_mjx.evaluation.manipulable import STRATA
from shmoo_mjx.evaluation.object_planner import FITTED, LEAST_K, told_by
from shmoo_mjx.report.figures import draw_decision, evidence
from shmoo_mjx.report.style import SERIES, blank_figure, draw_reliability, save_figure


def draw_figures(folder: Path, rows: list[dict[str, Any]], episodes: list[tuple[str, Any, Any]]) -> None:
    """Write reliability.png, confusion.png and planned_goals.png (the paper's Fig. 5) into ``folder``."""
    touched = [r for r in rows if "probabilities" in r]
    save_figure(folder / "reliability.png", _reliability(touched))
    save_figure(folder / "confusion.png", _confusion(touched))
    save_figure(folder / "planned_goals.png", _planned_goals(episodes))


def _reliability(rows: list[dict[str, Any]]) -> Any:
    """Left: how often what is said comes true, by stratum. Right: both criteria after a second, by truth."""
    figure = blank_figure(9.6, 3.6)
    left, right = figure.subplots(1, 2)
    for (stratum, name), colour in zip(STRATA.items(), SERIES, strict=False):
        of = [r for r in rows if r["stratum"] == stratum]
        truth = np.array([r["manipulable"] for r in of], dtype=bool)
        draw_reliability(left, told_by("reach", of), truth, colour=colour, label=name)
    left.set_xlabel("probability of being manipulable, after 1 s of contact")
    left.set_ylabel("share that is")
    left.legend(fontsize=8, title="objects, and how many", title_fontsize=8)
    for value, label, colour in ((False, "not manipulable", SERIES[5]), (True, "manipulable", SERIES[0])):
        for stratum, marker in zip(STRATA, "ox", strict=True):
            of = [r for r in rows if r["manipulable"] == value and r["stratum"] == stratum]
            k = np.clip([r["K_first"] for r in of], LEAST_K, 1e2)
            name = f"{label}, {STRATA[stratum]} ({len(of)})"
            right.plot(told_by("reach", of), k, marker, ms=4, alpha=0.7, color=colour, label=name)
    limit, (bias, slope) = NavigatorConfig().planner.threshold, FITTED["K"]
    right.axhline(limit, color="black", lw=1.4, ls="--", label=f"K = {limit:g} m², the paper's rule")
    fitted = float(np.exp(-bias / slope))
    right.axhline(fitted, color="black", lw=1.0, ls=":", label=f"K = {fitted:.2g} m², fitted")
    right.axvline(0.5, color="black", lw=1.0)
    right.set_yscale("log")
    right.set_xlabel("probability after 1 s of contact")
    right.set_ylabel("K after 1 s of contact [m²]")
    right.legend(fontsize=7)
    return figure


def _confusion(rows: list[dict[str, Any]]) -> Any:
    names = ("not manipulable", "manipulable")
    figure = blank_figure(8.4, 3.6)
    for axes, (stratum, title) in zip(figure.subplots(1, len(STRATA)), STRATA.items(), strict=True):
        table = np.zeros((2, 2), dtype=int)
        for r in rows:
            table[int(r["manipulable"]), int(r["probabilities"][0] >= 0.5)] += r["stratum"] == stratum
        most = max(int(table.sum()) / 2, 1)
        axes.imshow(table, cmap="Blues", vmin=0, vmax=most)
        for (i, j), count in np.ndenumerate(table):
            colour = "white" if count > most / 2 else "black"
            axes.text(j, i, str(count), ha="center", va="center", fontsize=15, color=colour)
        axes.set_title(title)
        axes.set_xticks((0, 1), names)
        axes.set_yticks((0, 1), names, rotation=90, va="center")
        axes.set_xlabel("the robot's decision after 1 s of contact")
        axes.set_ylabel("the plant's truth")
    return figure


def _planned_goals(episodes: list[tuple[str, Any, Any]]) -> Any:
    figure = blank_figure(5.2 * len(episodes), 5.4)
    for axes, (title, result, trace) in zip(figure.subplots(1, len(episodes)), episodes, strict=True):
        if result["decisions"]:
            last = len(result["decisions"]) - 1
            draw_decision(axes, result, trace, last)
            axes.set_title(f"{title}: {evidence(result['decisions'][last])}", fontsize=11)
        else:
            axes.set_title(f"{title}: no decision", fontsize=11)
    return figure
