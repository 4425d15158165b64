"""The picture of the pushing experiment, after the paper's Fig. 7, and its films."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.base.npz import read_arrays
from shmoo_mjx.evaluation.pushing_measures import PAPER
from shmoo_mjx.evaluation.pushing_trials import GOALS, METHODS, Trial, scene_of_trial
from shmoo_mjx.evaluation.tables import shown_name
from shmoo_mjx.report.style import COLOURS, SERIES, beside, blank_figure, outline, save_figure
from shmoo_mjx.sensing import Senses

_OWN = "0.45"  # Grey, for every method of the user's own.
_COLOUR = dict(zip(METHODS, (SERIES[0], SERIES[3], SERIES[5], SERIES[2], SERIES[1], SERIES[4]), strict=True))


def draw_figure(path: Path, rows: list[dict[str, Any]], folder: Path) -> None:
    """One panel per family with the objects' ways under our controller, one with where every object ended."""
    from matplotlib.collections import LineCollection

    families = list(dict.fromkeys(row["family"] for row in rows))
    figure = blank_figure(4.4 * (len(families) + 1), 4.4)
    axes = figure.subplots(1, len(families) + 1)
    ours = [row for row in rows if row["method"] == "ours"]
    lines = None
    for axis, family in zip(axes, families, strict=False):
        mine = [row for row in ours if row["family"] == family]
        for row in mine:
            way = _track(folder, row["trial"])["object_pose"][:, :2]
            pieces = np.stack([way[:-1], way[1:]], axis=1)
            progress = np.linspace(0, 1, len(pieces))
            lines = axis.add_collection(LineCollection(list(pieces), array=progress, cmap="viridis", lw=1.2))
            axis.plot(*way[-1], "o", ms=4, color=_COLOUR["ours"], mec="white", mew=0.5)
        axis.set_title(f"{family}: ways of the object")
        _goals(axis, mine)
    if lines is not None:
        figure.colorbar(lines, ax=axes[: len(families)].tolist(), label="share of the trial's time", shrink=0.7)
    _offsets(axes[-1], rows)
    save_figure(path, figure, 130)


def _goals(axis: Any, rows: list[dict[str, Any]]) -> None:
    """The three goals, and round each the circle that holds all final positions."""
    from matplotlib.patches import Circle, Polygon

    for number, (x, y) in enumerate(GOALS, 1):
        offsets = [row["offset_m"] for row in rows if row["goal"] == number]
        if not offsets:
            continue
        pose = np.array([x, y, 2 * np.arctan2(y, x)])
        axis.add_patch(Polygon(outline(pose, np.array([0.3, 0.25])), fill=False, ec=COLOURS["goal"], lw=0.8, ls=":"))
        axis.plot(x, y, "+", ms=9, mew=1.5, color=COLOURS["goal"])
        axis.add_patch(Circle((x, y), max(offsets), fill=False, ec=COLOURS["decision"], lw=1.0))
        label = f"goal {number}\nmean {np.mean(offsets):.3f} m\ncircle {max(offsets):.2f} m"
        axis.annotate(label, (x, y), (8, 8), textcoords="offset points", fontsize=7)
    axis.set_aspect("equal")
    axis.set(xlabel="x [m]", ylabel="y [m]", xlim=(-0.7, 2.4), ylim=(-1.3, 1.3))


def _offsets(axis: Any, rows: list[dict[str, Any]]) -> None:
    """Final offsets per goal and method beside the paper's means."""
    methods, goals = list(dict.fromkeys(row["method"] for row in rows)), sorted({row["goal"] for row in rows})
    width = 0.8 / len(methods)
    for k, method in enumerate(methods):
        colour = _COLOUR.get(method, _OWN)
        for goal in goals:
            offsets = np.array([r["offset_m"] for r in rows if r["method"] == method and r["goal"] == goal])
            x = beside(goal, k, len(methods))
            jitter = np.linspace(-0.3, 0.3, len(offsets)) * width
            axis.plot(x + jitter, np.minimum(offsets, 1.5), ".", ms=3, alpha=0.6, color=colour)
            label = shown_name(method) if goal == goals[0] else None
            axis.bar(x, offsets.mean(), 0.9 * width, color=colour, alpha=0.45, label=label)
    for goal in goals:
        label = "paper" if goal == 1 else None
        axis.hlines(PAPER[f"offset_goal{goal}_m"], goal - 0.45, goal + 0.45, color="black", lw=1.2, label=label)
    axis.axhline(0.25, color="grey", lw=0.8, ls=":")
    axis.set(xlabel="goal", ylabel="final offset [m]", xticks=goals, title="final offsets (bars: mean)")
    axis.set_yscale("symlog", linthresh=0.1)
    axis.legend(fontsize=7)


def _track(folder: Path, trial: str) -> dict[str, np.ndarray]:
    """What was recorded of one of our trials."""
    return read_arrays(folder / f"ours-{trial}.npz", "track")


def film(path: Path, trial: Trial, folder: Path, senses: Senses) -> Path | None:
    """The film of one of our trials, drawn by MuJoCo; None where that can't draw."""
    from shmoo_mjx.plant.render import can_render, frames
    from shmoo_mjx.report.video import compose, write_video

    if can_render():
        return None
    track = _track(folder, trial.name)
    scene = scene_of_trial(trial, trial.condition, senses)
    stride = 2
    views = frames(scene, track["qpos"][::stride].astype(float))
    captions = (
        (f"{t:5.1f} s   {p}", trial.condition.describe())
        for t, p in zip(track["t"][::stride], track["phase"][::stride], strict=True)
    )
    return write_video(path, (compose(v, c) for v, c in zip(views, captions, strict=True)), fps=15.0)
