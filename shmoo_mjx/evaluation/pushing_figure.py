"""Figure of the pushing experiment, after the paper's Fig. 7, and films of trials."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.base.npz import read_arrays
from shmoo_mjx.evaluation.pushing_measures import PAPER
from shmoo_mjx.evaluation.pushing_trials import GOALS, METHODS, Trial, scene_of_trial
from shmoo_mjx.evaluation.tables import shown_name
from shmoo_mjx.report.style import COLOURS, SERIES, beside, blank_figure, save_figure
from shmoo_mjx.sensing import Senses

_OWN = "0.45"  # Grey, for every method of the user's own.
_COLOUR = dict(zip(METHODS, (SERIES[0], SERIES[3], SERIES[5], SERIES[2], SERIES[1], SERIES[4]), strict=True))


def draw_figure(path: Path, rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw the objects' paths under our controller, one panel per family, and where every object ended."""
    from matplotlib.collections import LineCollection

    families = list(dict.fromkeys(row["family"] for row in rows))
    figure = blank_figure(3.4 * (len(families) + 1), 3.9)
    axes = figure.subplots(1, len(families) + 1)
    ours = [row for row in rows if row["method"] == "ours"]
    lines = None
    for axis, family in zip(axes, families, strict=False):
        mine = [row for row in ours if row["family"] == family]
        for row in mine:
            way = _track(folder, row["trial"])["object_pose"][:, :2]
            pieces = np.stack([way[:-1], way[1:]], axis=1)
            progress = np.linspace(0, 1, len(pieces))
            lines = axis.add_collection(LineCollection(list(pieces), array=progress, cmap="viridis", lw=0.8, alpha=0.7))
            axis.plot(*way[-1], "o", ms=4, color=_COLOUR["ours"], mec="white", mew=0.5, zorder=3)
        axis.set_title(f"{family} ({len(mine)} trials)", fontsize=10)
        _goals(axis, mine)
    if lines is not None:
        under, label = axes[: len(families)].tolist(), "share of the trial's time"
        figure.colorbar(lines, ax=under, orientation="horizontal", label=label, shrink=0.4, aspect=40)
    _offsets(axes[-1], rows)
    save_figure(path, figure, 130)


def _goals(axis: Any, rows: list[dict[str, Any]]) -> None:
    """Draw the three goals with their numbers, and around each the circle that holds all final positions."""
    from matplotlib.patches import Circle

    for number, (x, y) in enumerate(GOALS, 1):
        offsets = [row["offset_m"] for row in rows if row["goal"] == number]
        if not offsets:
            continue
        axis.plot(x, y, "+", ms=11, mew=2.0, color=COLOURS["decision"], zorder=4)
        axis.add_patch(Circle((x, y), max(offsets), fill=False, ec=COLOURS["decision"], lw=0.7, ls=":"))
        box = {"fc": "white", "ec": "none", "alpha": 0.7, "pad": 1.0}
        axis.annotate(str(number), (x, y), (9, 5), textcoords="offset points", fontsize=9, weight="bold", bbox=box)
    axis.set_aspect("equal")
    axis.set(xlabel="x [m]", ylabel="y [m]", xlim=(-0.7, 2.4), ylim=(-1.4, 1.4))


def _offsets(axis: Any, rows: list[dict[str, Any]]) -> None:
    """Draw final distances per goal and method with their means and the paper's means."""
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
    axis.set(xlabel="goal", xticks=goals)
    axis.set_title("distance from the goal [m]; bars: mean", fontsize=10)
    axis.set_yscale("symlog", linthresh=0.1)
    axis.set_yticks([0, 0.05, 0.1, 0.25, 0.5, 1.0], ["0", "0.05", "0.1", "0.25", "0.5", "1"])
    axis.legend(fontsize=7)


def _track(folder: Path, trial: str) -> dict[str, np.ndarray]:
    """The recorded track of one of our trials."""
    return read_arrays(folder / f"ours-{trial}.npz", "track")


def film(path: Path, trial: Trial, folder: Path, senses: Senses) -> Path | None:
    """Write a film of one of our trials, rendered by MuJoCo. None if MuJoCo cannot render here."""
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
