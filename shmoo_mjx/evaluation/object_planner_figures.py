"""Figures of the experiment object_planner."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.behavior.state import NavigatorConfig
from shmoo_mjx.evaluation.manipulable import STRATA
from shmoo_mjx.evaluation.movability import (
    FITTED,
    LEAST_K,
    navigator_config,
    open_floor,
    open_floor_scenario,
    probability_by,
)
from shmoo_mjx.evaluation.result import ExperimentOptions
from shmoo_mjx.evaluation.trials import controller_of
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.report.figures import draw_decision
from shmoo_mjx.report.style import SERIES, blank_figure, draw_reliability, save_figure
from shmoo_mjx.report.words import evidence


def draw_figures(folder: Path, rows: list[dict[str, Any]], options: ExperimentOptions) -> None:
    """Write reliability.png, confusion.png and planned_goals.png (the paper's Fig. 5) into ``folder``."""
    touched = [r for r in rows if "probabilities" in r]
    save_figure(folder / "reliability.png", _reliability(touched))
    save_figure(folder / "confusion.png", _confusion(touched))
    save_figure(folder / "planned_goals.png", _planned_goals(options))


def _reliability(rows: list[dict[str, Any]]) -> Any:
    """Left: how often what is said comes true, by stratum. Right: both criteria after a second, by truth."""
    figure = blank_figure(9.6, 3.6)
    left, right = figure.subplots(1, 2)
    for (stratum, name), colour in zip(STRATA.items(), SERIES, strict=False):
        of = [r for r in rows if r["stratum"] == stratum]
        truth = np.array([r["manipulable"] for r in of], dtype=bool)
        draw_reliability(left, probability_by("reach", of), truth, colour=colour, label=name)
    left.set_xlabel("predicted probability of being movable, 1 s of contact")
    left.set_ylabel("observed share")
    left.legend(fontsize=8, title="number of objects at the points", title_fontsize=8)
    for value, label, colour in ((False, "immovable", SERIES[5]), (True, "movable", SERIES[0])):
        for stratum, marker in zip(STRATA, "ox", strict=True):
            of = [r for r in rows if r["manipulable"] == value and r["stratum"] == stratum]
            k = np.clip([r["K_first"] for r in of], LEAST_K, 1e2)
            name = f"{label}, {STRATA[stratum]} ({len(of)})"
            right.plot(probability_by("reach", of), k, marker, ms=4, alpha=0.7, color=colour, label=name)
    limit, (bias, slope) = NavigatorConfig().planner.threshold, FITTED["K"]
    right.axhline(limit, color="black", lw=1.4, ls="--", label=f"K = {limit:g} m², the paper's rule")
    fitted = float(np.exp(-bias / slope))
    right.axhline(fitted, color="black", lw=1.0, ls=":", label=f"K = {fitted:.2g} m², fitted")
    right.axvline(0.5, color="black", lw=1.0)
    right.set_yscale("log")
    right.set_xlabel("predicted probability after 1 s of contact")
    right.set_ylabel("K after 1 s of contact [m²]")
    right.legend(fontsize=7)
    return figure


def _confusion(rows: list[dict[str, Any]]) -> Any:
    names = ("immovable", "movable")
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
        axes.set_xlabel("decision after 1 s of contact")
        axes.set_ylabel("ground truth")
    return figure


FIG5: dict[str, tuple[str, dict[str, Any]]] = {
    "wheelchair, right wheel locked": ("wheelchair", {"locked": [False, True, False, False], "payload": 10.0}),
    "cart, front-left wheel locked": ("cart", {"locked": [True, False, False, False], "payload": 5.0}),
    "box": ("box", {"mass": 2.8, "payload": 0.0, "friction": 0.4}),
}
"""The objects of the paper's Fig. 5, by title: family and properties."""


def _planned_goals(options: ExperimentOptions) -> Any:
    """A probe of each object of `FIG5`, ended at its decision."""
    from shmoo_mjx.run.episode import Hooks, run_episode

    controller = controller_of(options.weights_file)
    over = Hooks(over=lambda navigator: any(d.manipulable for d in navigator.decisions))
    # The figure shows the planning stage of Algorithm 1, which takes place where K decides.
    config = replace(navigator_config(), decides_by="K")
    figure = blank_figure(5.2 * len(FIG5), 5.4)
    for axes, (title, (family, properties)) in zip(figure.subplots(1, len(FIG5)), FIG5.items(), strict=True):
        scenario = open_floor_scenario(draw_condition(family, 5, properties), 0, options.seed, 40.0)
        episode = run_episode(open_floor(), scenario, controller, config=config, hooks=over, senses=options.senses)
        decisions, decision = episode.result["decisions"], "no decision"
        if decisions:
            draw_decision(axes, episode.result, episode.trace, len(decisions) - 1)
            decision = evidence(decisions[-1])
        axes.set_title(f"{title}: {decision}", fontsize=11)
    return figure
