"""Figures of the experiment `object_model`: roll-outs before and after (like Fig. 4), and the adaptation's progress."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.data import store
from shmoo_mjx.evaluation.baselines import first_samples, recordings
from shmoo_mjx.evaluation.baselines.protocol import Predictor
from shmoo_mjx.evaluation.scoring import FIT_SAMPLES, roll_out
from shmoo_mjx.geometry import se2
from shmoo_mjx.report.style import SERIES, blank_figure, outline, save_figure

BEFORE, AFTER = SERIES[1], SERIES[0]

STEPS = 30
"""Length of the drawn roll-outs [samples]."""


def draw_roll_outs(after: Predictor, before: Predictor, objects: store.Dataset, path: Path, *, count: int = 8) -> None:
    """Draw recorded and predicted motion of ``count`` objects over 3 s, after 25 s of adaptation."""
    recorded = recordings(objects)
    # Families take turns, so that the figure shows all of them.
    by_family: dict[str, list[int]] = {}
    for i, condition in enumerate(objects.conditions):
        by_family.setdefault(condition["family"], []).append(i)
    most = max(len(v) for v in by_family.values())
    chosen = [v[k] for k in range(most) for v in by_family.values() if k < len(v)][:count]
    figure = blank_figure(12.5, 6.2)
    axes = figure.subplots(2, (len(chosen) + 1) // 2, squeeze=False)
    for axis, i in zip(axes.flat, chosen, strict=False):
        _draw_one(axis, after, before, recorded=recorded, i=i, objects=objects)
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    for axis in axes.flat[len(chosen) :]:
        axis.axis("off")
    save_figure(path, figure, 130)


def _draw_one(axis: Any, after: Predictor, before: Predictor, *, recorded: Any, i: int, objects: store.Dataset) -> None:
    start = _liveliest(recorded, i)
    rows = slice(start, start + STEPS)
    x, time, pose = recorded.samples.inputs[i, rows], recorded.time[i, rows], recorded.pose[i]
    context = first_samples(recorded, i, FIT_SAMPLES)
    truth = se2.relative(pose[start], pose[start : start + STEPS + 1])
    axis.plot(truth[:, 0], truth[:, 1], color="black", linewidth=2.2, label="recorded")
    for predictor, label, colour in (
        (before, "predicted before contact", BEFORE),
        (after, "predicted after 25 s", AFTER),
    ):
        path = np.asarray(roll_out(predictor, predictor.adapt(context), x, time))
        axis.plot(path[:, 0], path[:, 1], color=colour, linewidth=1.6, label=label)
        _outline(axis, path[-1], objects.conditions[i], colour)
    _outline(axis, truth[-1], objects.conditions[i], "black")
    force = np.asarray(se2.rotate(x[::3, 3:5], truth[:-1:3, 2]))
    axis.quiver(*truth[:-1:3, :2].T, *force.T, color="0.55", scale=400, width=0.005, zorder=0)
    about = objects.conditions[i]
    axis.set_title(f"{about['family']}, {about['mass'] + about['payload']:.0f} kg", fontsize=9)
    axis.set_aspect("equal")
    axis.tick_params(labelsize=7)


def _liveliest(recorded: Any, i: int) -> int:
    """First of the STEPS rows after the adaptation, within one episode, over which the object moves most."""
    starts = np.arange(FIT_SAMPLES, recorded.samples.inputs.shape[1] - STEPS)
    inside = recorded.samples.run[i, starts] > STEPS
    moved = np.linalg.norm(recorded.pose[i, starts + STEPS, :2] - recorded.pose[i, starts, :2], axis=1) * inside
    return int(starts[np.argmax(moved)])


def _outline(axis: Any, pose: np.ndarray, condition: dict[str, Any], colour: str) -> None:
    corners = outline(pose, np.array(condition["size"][:2]) / 2)
    axis.plot(*corners[[0, 1, 2, 3, 0]].T, color=colour, linewidth=0.8, alpha=0.7)


def draw_curve(seconds: Sequence[float], shares: np.ndarray, path: Path) -> None:
    """Draw the share of the gap closed over time in contact: median and quartiles."""
    q25, median, q75 = np.nanquantile(shares, [0.25, 0.5, 0.75], axis=0)
    figure = blank_figure(5.5, 3.4)
    axis = figure.subplots()
    axis.fill_between(seconds, q25, q75, color=AFTER, alpha=0.2, label="quartiles")
    axis.plot(seconds, median, color=AFTER, marker="o", label="median over the objects")
    axis.set(xscale="log", xlabel="time in contact [s]", ylabel="share of the gap closed", ylim=(-0.3, 1.1))
    axis.set_xticks(list(seconds), [f"{s:g}" for s in seconds])
    axis.minorticks_off()
    axis.legend(fontsize=8)
    save_figure(path, figure, 130)
