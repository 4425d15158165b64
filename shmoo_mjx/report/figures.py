"""Figures of one run, made from its result and trace. The functions return matplotlib Figures and do not use pyplot."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from shmoo_mjx.arrays import Array, Numbers
from shmoo_mjx.geometry.hands import CONTACT_FORCE
from shmoo_mjx.report.style import COLOURS, SERIES, blank_figure, object_colour, outline, show_cells, window
from shmoo_mjx.report.trace import Trace, is_number, object_index, telling_decisions
from shmoo_mjx.report.words import evidence, object_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LABELS = {"friction_x": "along x", "friction_y": "along y"}
WIDE, NARROW = 9.0, 4.4
"""Widths of figures for a desk and for a phone [inches]."""
_COLUMN = 1.8
"""Minimum width of a push in the figure of the learned properties [inches]."""
_ROOM = 1.25
"""Upper limit of an axis as a multiple of the largest value that it must show."""


def map_figure(result: dict[str, Any], trace: Trace, width: float = WIDE) -> Figure:
    """The map with planned paths, driven path, initial and final poses of the objects, and the key decisions."""
    from matplotlib.patheffects import withStroke

    halo: dict[str, Any] = {"path_effects": [withStroke(linewidth=2.5, foreground="white")], "zorder": 6}
    box = window(result, trace)
    tall = width * (box[3] - box[2]) / (box[1] - box[0])
    figure = blank_figure(width, min(max(tall, 3.0), 11.0) + (0.0 if width == WIDE else 1.2))
    axes = figure.subplots()
    _draw_map(axes, trace, box)
    for number, path in enumerate(trace.plans):
        label = f"plan {number + 1}, {float(trace.plan_times[number]):.0f} s"
        shade = 0.25 + 0.6 * (number + 1) / len(trace.plans)
        axes.plot(*path.T[:2], "--", color=COLOURS["plan"], alpha=shade, lw=1.6, label=label if number < 6 else None)
    _draw_driven(figure, axes, trace)
    for number, item in enumerate(result["objects"]):
        colour = object_colour(item, number)
        _polygon(axes, item["start_pose"], item["half_extents"], edge=colour, style=":")
        _polygon(axes, item["final_pose"], item["half_extents"], edge=colour, fill=0.75)
        start, final = np.asarray(item["start_pose"]), np.asarray(item["final_pose"])
        if np.linalg.norm(final[:2] - start[:2]) > 0.05:
            axes.annotate(
                "",
                (final[0], final[1]),
                (start[0], start[1]),
                arrowprops={"arrowstyle": "->", "color": colour, "lw": 1.5},
            )
        text = object_name(result, item["id"]) + (", can't be moved" if item.get("registered") else "")
        foot = outline(final, item["half_extents"])[:, 1].min()
        place = (float(final[0]), float(foot))
        axes.annotate(text, place, (0, -4), textcoords="offset points", ha="center", va="top", fontsize=8, **halo)
    for number in telling_decisions(result):
        _mark_decision(axes, result, trace, number, decision=result["decisions"][number])
    _mark_ends(axes, result, trace)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower left", ncols=8 if width == WIDE else 3, fontsize=8, frameon=False)
    return figure


def decision_figure(result: dict[str, Any], trace: Trace, number: int) -> Figure:
    """Roll-outs, candidate goals and the chosen goal of decision ``number``, around the object."""
    figure = blank_figure(5.6, 5.2)
    draw_decision(figure.subplots(), result, trace, number)
    return figure


def draw_decision(axes: Axes, result: dict[str, Any], trace: Trace, number: int) -> None:
    """Draw the content of :func:`decision_figure` in ``axes``."""
    decision = result["decisions"][number]
    index = object_index(result, decision["object"])
    item = result["objects"][index] if index is not None else None
    pose = _pose_at(result, trace, index, decision["t"])
    rollouts = trace.decision_rollouts[number] if number < len(trace.decision_rollouts) else np.zeros((0, 0, 2))
    candidates = trace.decision_candidates[number] if number < len(trace.decision_candidates) else np.zeros((0, 3))
    reach = np.concatenate([np.reshape(rollouts, (-1, 2)), candidates[:, :2], pose[None, :2]])
    radius = float(np.clip(np.nanmax(np.abs(reach - pose[:2])) + 0.6, 1.4, 6.0))
    _draw_map(axes, trace, (pose[0] - radius, pose[0] + radius, pose[1] - radius, pose[1] + radius))
    path = _plan_at(trace, decision["t"])
    if path is not None:
        axes.plot(*path.T[:2], "--", color=COLOURS["plan"], lw=1.6, label="path")
    for k, line in enumerate(rollouts):
        axes.plot(*line.T, color=COLOURS["rollout"], alpha=0.35, lw=0.8, label="predicted pushes" if k == 0 else None)
    if len(rollouts):
        axes.plot(*rollouts[:, -1].T, ".", color=COLOURS["rollout"], ms=3)
    if len(candidates):
        axes.plot(*candidates.T[:2], "o", color=COLOURS["candidate"], ms=3.5, mew=0, label="where options end")
    colour = object_colour(item, index or 0) if item else COLOURS["object"]
    half = item["half_extents"] if item else (0.3, 0.3)
    _polygon(axes, pose, half, edge=colour, fill=0.6)
    if decision.get("goal") is not None:
        # Only the position of this goal counts, so it has no outline, which would have a yaw.
        axes.plot(*decision["goal"][:2], "*", color=COLOURS["goal"], ms=15, mec="white", zorder=6, label="place chosen")
    robot = trace.robot_pose[_sample(trace, decision["t"])]
    axes.plot(*robot[:2], "o", color=COLOURS["robot"], ms=9, label="robot")
    told = is_number(decision.get("K")) or is_number(decision.get("probability"))
    says = evidence(decision) if told else "first goal, dynamics not known yet"
    name = object_name(result, decision["object"])
    axes.set_title(f"Decision {number + 1}, at {float(decision['t']):.1f} s, {name}: {says}", fontsize=10)
    axes.legend(loc="best", fontsize=7, framealpha=0.9)


def learned_figure(result: dict[str, Any], trace: Trace, width: float = WIDE) -> Figure:
    """The learned properties of each object during its pushes.

    Each push is a column, with one row per property. Pushes that do not fit side by side follow below.
    """
    panels = _panels(trace)
    pushes = _pushes(trace) or [slice(0, len(trace.t))]
    columns = min(len(pushes), int(width / _COLUMN))
    bands = [pushes[i : i + columns] for i in range(0, len(pushes), columns)]
    figure = blank_figure(width, 0.8 + 2.5 * len(panels) * len(bands))
    grid = figure.subplots(len(panels) * len(bands), columns, squeeze=False)
    for band, shown in enumerate(bands):
        rows = grid[band * len(panels) : (band + 1) * len(panels)]
        for column in range(columns):
            if column < len(shown):
                _draw_push(rows[:, column], result, trace, panels=panels, push=shown[column])
            else:
                for axes in rows[:, column]:
                    axes.remove()
        for row, (name, curves) in zip(rows, panels, strict=True):
            row[0].set_ylabel(name, fontsize=9)
            if len(curves) > 1:
                names = (_LABELS.get(curve, curve) for curve in curves)
                last = row[len(shown) - 1]
                last.legend(*_named_once([last], *names), fontsize=7, framealpha=0.8)
    marks = _named_once(figure.axes, "contact begins", "decision", "true value")
    figure.legend(*marks, loc="outside upper center", ncols=3, fontsize=8, frameon=False)
    return figure


def _draw_push(
    column: Iterable[Axes],
    result: dict[str, Any],
    trace: Trace,
    *,
    panels: list[tuple[str, dict[str, np.ndarray]]],
    push: slice,
) -> None:
    index = int(trace.learned_object[push.start])
    item = result["objects"][index] if 0 <= index < len(result["objects"]) else {}
    panes = list(column)
    panes[0].set_title(object_name(result, item["id"]) if item else "", fontsize=10)
    panes[-1].set_xlabel("time [s]")
    for axes, (_, curves) in zip(panes, panels, strict=True):
        _draw_learned(axes, result, trace, curves=curves, push=push, true=item.get("true", {}))


def timeline_figure(result: dict[str, Any], trace: Trace, width: float = WIDE) -> Figure:
    """State of the navigator, speed, lean with its command, and force of the hands over time."""
    # Logs of other robots may have no lean or no pose.
    leans, velocity = int(np.isfinite(trace.lean).any()), _speed(trace)
    drives = int(np.isfinite(velocity).any())
    figure = blank_figure(width, 2.6 + 1.6 * (1 + leans + drives))
    panels = list(figure.subplots(2 + leans + drives, 1, sharex=True, height_ratios=[1.4] + [1] * (1 + leans + drives)))
    states, force, t = panels[0], panels[-1], trace.t
    _draw_states(states, trace)
    if drives:
        panels[1].plot(t, velocity, color=COLOURS["robot"], lw=1.3)
        panels[1].set_ylabel("speed [m/s]")
    if leans:
        lean = panels[-2]
        for axis, name, colour in ((0, "x", SERIES[0]), (1, "y", SERIES[1])):
            lean.plot(t, np.degrees(trace.lean[:, axis]), color=colour, lw=1.3, label=f"lean {name}")
            lean.plot(t, np.degrees(trace.u[:, axis]), color=colour, lw=0.9, ls=":", label=f"command {name}")
        lean.set_ylabel("lean [deg]")
        lean.legend(ncols=4 if width == WIDE else 2, fontsize=7, loc="upper right", framealpha=0.8)
    for axis, name, colour in ((0, "forward", SERIES[0]), (1, "sideways", SERIES[1])):
        force.plot(t, trace.force[:, axis], color=colour, lw=1.2, label=name)
    force.set_ylabel("force of hands [N]")
    force.legend(ncols=2, fontsize=7, loc="upper right", framealpha=0.8)
    force.set_xlabel("time [s]")
    for axes in panels[1:]:
        axes.grid(alpha=0.25)
    for axes in panels:
        for decision in result["decisions"]:
            axes.axvline(decision["t"], color=COLOURS["decision"], lw=1.0, alpha=0.8)
    return figure


def _draw_map(axes: Axes, trace: Trace, box: tuple[float, float, float, float]) -> None:
    from matplotlib.colors import ListedColormap

    cells = np.asarray(trace.map_cells)
    kind = np.where(cells >= 65, 2, np.where(cells == 0, 0, 1))
    palette = ListedColormap([COLOURS["free"], COLOURS["unknown"], COLOURS["wall"]])
    show_cells(axes, kind, trace.map_resolution, trace.map_origin, cmap=palette, vmin=0, vmax=2)
    axes.set(xlim=box[:2], ylim=box[2:], aspect="equal", xlabel="x [m]", ylabel="y [m]")


def _draw_driven(figure: Figure, axes: Axes, trace: Trace) -> None:
    from matplotlib.collections import LineCollection

    points = np.asarray(trace.robot_pose)[:, :2]
    if len(points) < 2 or not np.isfinite(points).any():
        return
    lines = LineCollection(list(np.stack([points[:-1], points[1:]], axis=1)), cmap="viridis", lw=2.6, zorder=3)
    lines.set_array(np.asarray(trace.t)[1:])
    axes.add_collection(lines)
    side = {"pad": 0.02} if figure.get_figwidth() == WIDE else {"location": "bottom", "pad": 0.01}
    figure.colorbar(lines, ax=axes, label="driven path: time [s]", shrink=0.8, **side)


def _polygon(
    axes: Axes,
    pose: Array,
    half: Numbers | Array,
    *,
    edge: str,
    fill: float = 0.0,
    style: str = "-",
    width: float = 1.4,
) -> None:
    from matplotlib.colors import to_rgba
    from matplotlib.patches import Polygon

    face = to_rgba(edge, fill) if fill else "none"
    axes.add_patch(Polygon(outline(pose, half), ec=edge, fc=face, ls=style, lw=width, zorder=4))


def _mark_decision(axes: Axes, result: dict[str, Any], trace: Trace, number: int, *, decision: dict[str, Any]) -> None:
    index = object_index(result, decision["object"])
    pose = _pose_at(result, trace, index, decision["t"])
    top = pose[1] if index is None else outline(pose, result["objects"][index]["half_extents"])[:, 1].max()
    colour = COLOURS["goal"] if decision["manipulable"] else COLOURS["decision"]
    told = is_number(decision.get("K")) or is_number(decision.get("probability"))
    text = f"{number + 1}: {evidence(decision) if told else 'first goal'}"
    axes.annotate(
        text if result.get("push_to") is None else f"push {number + 1}",
        (float(pose[0]), float(top)),
        (8, 12 + 15 * (number % 3)),
        textcoords="offset points",
        fontsize=8,
        zorder=6,
        bbox={"boxstyle": "round,pad=0.25", "fc": "white", "ec": colour},
        arrowprops={"arrowstyle": "-", "color": colour},
    )
    if decision.get("goal") is not None:
        axes.plot(*decision["goal"][:2], "x", color=COLOURS["goal"], ms=7, mew=2, zorder=5)


def _mark_ends(axes: Axes, result: dict[str, Any], trace: Trace) -> None:
    start = result.get("start") or trace.robot_pose[0]
    if np.isfinite(np.asarray(start, dtype=float)).all():
        axes.plot(*np.asarray(start, dtype=float)[:2], "o", color=COLOURS["robot"], ms=9, zorder=5, label="start")
    if result.get("goal") is not None and result.get("push_to") is None:
        goal = np.asarray(result["goal"], dtype=float)
        axes.plot(*goal[:2], "*", color=COLOURS["goal"], ms=16, mec="white", zorder=5, label="goal")
    if result.get("push_to") is not None:
        half = result["objects"][0]["half_extents"]
        _polygon(axes, np.asarray(result["push_to"], dtype=float), half, edge=COLOURS["goal"], style="--", width=2.0)


def _draw_states(axes: Axes, trace: Trace) -> None:
    used = list(dict.fromkeys(int(s) for s in trace.state))
    step = float(trace.t[1] - trace.t[0]) if len(trace.t) > 1 else 0.1
    for samples in np.split(np.arange(len(trace.t)), np.flatnonzero(np.diff(trace.state)) + 1):
        row, begin = used.index(int(trace.state[samples[0]])), float(trace.t[samples[0]])
        span = (begin, float(trace.t[samples[-1]]) + step - begin)
        axes.broken_barh([span], (row - 0.4, 0.8), color=SERIES[row % len(SERIES)])
    axes.set_yticks(range(len(used)), [trace.state_names[s] for s in used], fontsize=8)
    axes.invert_yaxis()
    axes.grid(alpha=0.25, axis="x")


def _band(curves: dict[str, np.ndarray], name: str) -> np.ndarray:
    """Lower limit, median and upper limit ``[T, 3]``."""
    return np.stack([curves[f"{name}{end}"] for end in ("_low", "", "_high")], axis=-1)


def _panels(trace: Trace) -> list[tuple[str, dict[str, np.ndarray]]]:
    """Rows of the figure: name with unit, and curves by name, ``[T]``, or ``[T, 3]`` with an 80 % interval."""
    values = np.asarray(trace.learned, dtype=float)
    curves = dict(zip(trace.learned_names, values.T, strict=True))
    if "mass" in curves:
        friction = {name: _band(curves, name) for name in ("friction_x", "friction_y")}
        return [("friction [N]", friction), ("mass [kg]", {"mass": _band(curves, "mass")})]
    most = np.max(np.abs(np.nan_to_num(values)), axis=0, initial=0.0)
    shown = values / np.where(most > 0, most, 1.0)
    thirds = np.array_split(np.arange(values.shape[1]), 3)
    return [
        (f"{name} axis\n(normalised)", {trace.learned_names[k]: shown[:, k] for k in third})
        for name, third in zip(("x", "y", "yaw"), thirds, strict=True)
    ]


def _draw_learned(
    axes: Axes,
    result: dict[str, Any],
    trace: Trace,
    *,
    curves: dict[str, np.ndarray],
    push: slice,
    true: dict[str, float],
) -> None:
    for k, (name, values) in enumerate(curves.items()):
        colour = SERIES[k % len(SERIES)]
        if values.ndim == 2:
            axes.fill_between(trace.t[push], values[push, 0], values[push, 2], color=colour, alpha=0.2, lw=0)
            values = values[:, 1]
        axes.plot(trace.t[push], values[push], lw=1.4, color=colour, label=_LABELS.get(name, name))
        if name in true:
            axes.axhline(true[name], lw=0.9, color=colour, ls="--", label="true value")
    begin, end = float(trace.t[push][0]), float(trace.t[push][-1])
    for t in _contact_begins(trace):
        if begin - 0.2 <= t <= end:
            axes.axvline(t, color=COLOURS["contact"], lw=1.2, ls=":", label="contact begins")
    for decision in result["decisions"]:
        if begin <= decision["t"] <= end:
            axes.axvline(decision["t"], color=COLOURS["decision"], lw=0.8, alpha=0.7, label="decision")
    # The band before the first touch is many times as wide as the later ones, which would be flat lines beside it.
    late = slice((push.start + push.stop) // 2, push.stop)
    known = [true[name] for name in curves if name in true]
    upper = [np.ravel(band[late, 1:]) for band in curves.values() if band.ndim == 2]
    shown = np.concatenate([*upper, known]) if upper else np.zeros(0)
    if np.isfinite(shown).any():
        axes.set_ylim(0.0, _ROOM * float(np.nanmax(shown)))
    axes.grid(alpha=0.25)


def _named_once(panels: Iterable[Axes], *names: str) -> tuple[list[Any], list[str]]:
    """Handles and labels of one legend for all panels, for the curves with these names."""
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            if label in names:
                handles.setdefault(label, handle)
    return list(handles.values()), list(handles)


def _pushes(trace: Trace) -> list[slice]:
    """Slices of consecutive samples in which one object is pushed."""
    which = np.asarray(trace.learned_object).astype(int)
    edges = [0, *(np.flatnonzero(np.diff(which)) + 1).tolist(), len(which)]
    return [slice(a, b) for a, b in pairwise(edges) if which[a] >= 0 and b - a > 1]


def _contact_begins(trace: Trace) -> np.ndarray:
    touching = np.linalg.norm(np.nan_to_num(np.asarray(trace.force, dtype=float)), axis=-1) > CONTACT_FORCE
    begins = np.flatnonzero(touching & ~np.r_[False, touching[:-1]])
    # Keep at most one line per second, because intermittent contact would fill the figure with lines.
    kept: list[float] = []
    for t in np.asarray(trace.t, dtype=float)[begins]:
        if not kept or t - kept[-1] > 1.0:
            kept.append(float(t))
    return np.array(kept)


def _speed(trace: Trace) -> np.ndarray:
    points, t = np.asarray(trace.robot_pose, dtype=float)[:, :2], np.asarray(trace.t, dtype=float)
    return np.linalg.norm(np.gradient(points, t, axis=0), axis=-1) if len(t) > 1 else np.zeros(len(t))


def _sample(trace: Trace, t: float) -> int:
    return int(np.clip(np.searchsorted(trace.t, float(t)), 0, len(trace.t) - 1))


def _pose_at(result: dict[str, Any], trace: Trace, index: int | None, t: float) -> np.ndarray:
    sample = _sample(trace, t)
    pose = np.asarray(trace.robot_pose[sample] if index is None else trace.object_pose[sample, index], dtype=float)
    if index is not None and not np.isfinite(pose).all():  # not observed at that time
        pose = np.asarray(result["objects"][index]["start_pose"], dtype=float)
    return pose


def _plan_at(trace: Trace, t: float) -> np.ndarray | None:
    count = np.searchsorted(trace.plan_times, float(t) + 1e-6, side="right")
    return np.asarray(trace.plans[count - 1]) if count else None
