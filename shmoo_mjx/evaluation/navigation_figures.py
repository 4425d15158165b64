"""Figures of the experiment navigation."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.evaluation.paired import OURS
from shmoo_mjx.evaluation.scenarios import KINDS
from shmoo_mjx.evaluation.tables import shown_name
from shmoo_mjx.planning.maps import OccupancyGrid, load_map
from shmoo_mjx.report.style import (
    COLOURS,
    SERIES,
    beside,
    blank_figure,
    legend_above,
    object_colour,
    outline,
    save_figure,
    show_cells,
)

SHOWN = 8
"""Scenarios in the picture of a map."""


def draw_figures(folder: Path, rows: list[dict[str, Any]], maps: dict[str, Path]) -> None:
    """Write success.png, causes.png and one picture of the runs per map; time_over_extra.png too for certificates."""
    if not rows:
        return
    save_figure(folder / "success.png", _success(rows))
    save_figure(folder / "causes.png", _causes(rows))
    if any(r.get("reference_s") is not None for r in rows):
        save_figure(folder / "time_over_extra.png", _time_over_extra(rows))
    for name in dict.fromkeys(r["map"] for r in rows):
        of = [r for r in rows if r["map"] == name]
        save_figure(folder / f"runs-{name}.png", _runs(of, load_map(maps[name])))


def _policies(rows: list[dict[str, Any]]) -> list[str]:
    return list(dict.fromkeys(r["policy"] for r in rows))


def _success(rows: list[dict[str, Any]]) -> Any:
    """Share of successes by policy, a group of bars per kind of scenario."""
    figure = blank_figure(7.5, 3.6)
    axes = figure.subplots()
    policies = _policies(rows)
    groups = [kind for kind in KINDS if any(r["kind"] == kind for r in rows)]
    for k, policy in enumerate(policies):
        for g, kind in enumerate(groups):
            of = [r["success"] for r in rows if r["policy"] == policy and r["kind"] == kind]
            place = beside(g, k, len(policies))
            label = shown_name(policy) if g == 0 else None
            axes.bar(place, np.mean(of), 0.75 / len(policies), color=SERIES[k], label=label)
            axes.text(place, float(np.mean(of)), str(sum(of)), ha="center", va="bottom", fontsize=7)
    counts = [len({(r["map"], r["scenario"]) for r in rows if r["kind"] == kind}) for kind in groups]
    axes.set_xticks(range(len(groups)), [f"{kind} ({n} scenarios)" for kind, n in zip(groups, counts, strict=True)])
    axes.set(ylabel="share of runs that reach the goal", ylim=(0, 1.12))
    legend_above(figure)
    return figure


def _time_over_extra(rows: list[dict[str, Any]]) -> Any:
    """Time of each run over the extra length of the way round, with a running mean per policy, and the reference.

    Scenarios without a way round stand at the right, with a diamond for the mean.
    """
    figure = blank_figure(8.0, 4.2)
    axes = figure.subplots()
    certified = [r for r in rows if r.get("reference_s") is not None]
    nowhere = 120.0  # where the scenarios without a way round stand on the axis [m]
    policies = [*_policies(certified), "reference"]
    for k, policy in enumerate(policies):
        reference = policy == "reference"
        of = list({(r["map"], r["scenario"]): r for r in certified if reference or r["policy"] == policy}.values())
        beside = nowhere * 1.07 ** (k - len(policies) / 2)
        extra = np.array([beside if r["extra_m"] is None else max(r["extra_m"], 0.5) for r in of])
        good = np.array([reference or r["success"] for r in of])
        time = np.array([r["reference_s"] if reference else r["regret_s"] + r["reference_s"] for r in of])
        colour = "black" if reference else SERIES[k % len(SERIES)]
        axes.plot(extra[good], time[good], ".", color=colour, ms=4, alpha=0.6)
        axes.plot(extra[~good], time[~good], "x", color=colour, ms=4, alpha=0.6)
        parts = [(extra >= a) & (extra < b) for a, b in pairwise([0.0, 2.5, 5.0, 10.0, 20.0, 60.5])]
        means = [(np.exp(np.log(extra[p]).mean()), time[p].mean()) for p in parts if p.any()]
        axes.plot(
            *np.array(means).reshape(-1, 2).T,
            color=colour,
            label="best certified option" if reference else shown_name(policy),
            lw=1.2 + 0.8 * reference,
        )
        if (extra == beside).any():
            axes.plot(beside, time[extra == beside].mean(), "D", color=colour, ms=6, markeredgecolor="white")
    axes.set(
        xlabel="extra length of the way round [m]",
        ylabel="time [s]",
    )
    axes.set_xscale("log")
    axes.set_xticks([1, 3, 10, 30, nowhere], ["1", "3", "10", "30", "none"])
    legend_above(figure)
    return figure


def _causes(rows: list[dict[str, Any]]) -> Any:
    """Failures by cause, a colour per policy."""
    from matplotlib.ticker import MaxNLocator

    policies = _policies(rows)
    counts = Counter((r["cause"], r["policy"]) for r in rows if not r["success"])
    causes = [c for c, _ in Counter(r["cause"] for r in rows if not r["success"]).most_common()][::-1]
    figure = blank_figure(8.0, 1.2 + 0.4 * max(len(causes), 1))
    axes = figure.subplots()
    left = np.zeros(len(causes))
    for k, policy in enumerate(policies):
        width = np.array([counts[cause, policy] for cause in causes], dtype=float)
        axes.barh(range(len(causes)), width, left=left, color=SERIES[k], label=shown_name(policy))
        left += width
    axes.set_yticks(range(len(causes)), causes, fontsize=8)
    axes.set_xlabel("failed runs")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    legend_above(figure)
    return figure


def _runs(rows: list[dict[str, Any]], grid: OccupancyGrid) -> Any:
    """A row per scenario, a column per policy: driven path, objects before (dotted) and after.

    Of many scenarios those are shown that ours failed, then those that others failed.
    """
    failed = Counter[int]()
    for row in rows:
        failed[row["scenario"]] += (not row["success"]) * (100 if row["policy"] == OURS else 1)
    numbers = sorted(sorted(failed, key=lambda n: (-failed[n], n))[:SHOWN])
    rows = [r for r in rows if r["scenario"] in numbers]
    policies = _policies(rows)
    figure = blank_figure(3.2 * len(policies), 3.2 * len(numbers))
    panels = figure.subplots(len(numbers), len(policies), squeeze=False)
    for axes in panels.ravel():
        axes.set_axis_off()
    for row in rows:
        axes = panels[numbers.index(row["scenario"]), policies.index(row["policy"])]
        _draw_run(axes, row, grid)
    return figure


def _draw_run(axes: Any, row: dict[str, Any], grid: OccupancyGrid) -> None:
    shade = np.full((*grid.cells.shape, 3), 0.85)
    shade[grid.free], shade[grid.occupied] = 1.0, 0.25
    show_cells(axes, shade, grid.resolution, np.array(grid.origin))
    driven = np.array(row["driven"])
    axes.plot(*driven.T, color=COLOURS["robot"], lw=1.5)
    goal = np.array(row["goal"])
    axes.plot(*goal, "*", color=COLOURS["goal"], ms=11)
    axes.plot(*driven[0], "o", color=COLOURS["robot"], ms=5)
    corners = [driven, goal[None]]
    for number, item in enumerate(row["objects"]):
        colour = object_colour(item, number)
        for key, style in (("start_pose", ":"), ("final_pose", "-")):
            shape = outline(item[key], item["half_extents"])
            corners.append(shape)
            axes.fill(*shape.T, facecolor="none" if style == ":" else colour, edgecolor=colour, ls=style, alpha=0.8)
    low, high = np.concatenate(corners).min(axis=0) - 1.0, np.concatenate(corners).max(axis=0) + 1.0
    half, middle = 0.5 * max(high - low), 0.5 * (low + high)
    axes.set(xlim=middle[0] + np.array([-half, half]), ylim=middle[1] + np.array([-half, half]))
    verdict = f"{row['time_s']:.0f} s" if row["success"] else row["cause"]
    axes.set_title(f"{shown_name(row['policy'])}, {row['kind']}\n{verdict}", fontsize=8)
