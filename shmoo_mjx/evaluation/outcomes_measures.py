"""Metrics of predicted pushes (errors, coverage, probabilities), with tables and a figure."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.arrays import Float
from shmoo_mjx.evaluation.tables import Table, lines_of
from shmoo_mjx.geometry import se2
from shmoo_mjx.report.style import SERIES, blank_figure, draw_reliability, save_figure

STRATA = {"free": "all wheels free, and boxes", "locked": "one locked wheel"}
"""Strata of objects: name to description."""
PREDICTIONS = {"posterior": "posterior", "prior": "prior", "robots": "another robot"}
"""Predictions: samples of the posterior, samples of the family's prior, and the same push by another robot, which shows
how much of the outcome is chance."""
SHARE = 0.8
"""Share of the samples in the region that is tested for coverage."""
_LINES = {
    "position_m": "After 0.8 m: median position error [m]",
    "yaw_deg": "After 0.8 m: median yaw error [deg]",
    "covered": "After 0.8 m: share of ends in the 80 % region",
    "compared": "After 0.8 m: pushes compared",
    "stop_position_m": "After 0.8 m or 12 s: median position error [m]",
    "stop_yaw_deg": "After 0.8 m or 12 s: median yaw error [deg]",
    "stop_covered": "After 0.8 m or 12 s: share of ends in the 80 % region",
    "brier_moves": "Whether it moves 0.8 m: Brier score",
    "right_moves": "Whether it moves 0.8 m: share of right predictions",
    "brier_comes": "Whether it comes 0.8 m along the push: Brier score",
    "right_comes": "Whether it comes 0.8 m along the push: share of right predictions",
    "pushes": "Pushes",
    "moves": "Pushes that move the object 0.8 m",
    "comes": "Pushes on which it comes 0.8 m along the push",
}
_OF_ENDS: dict[str, Callable[[Any], Any]] = {"position_m": np.median, "yaw_deg": np.median, "covered": np.mean}
"""Measures of ends and their statistics."""
_RESAMPLES = 2000

Rows = list[dict[str, Any]]


def errors(end: Float[np.ndarray, "3"], other: Float[np.ndarray, "3"]) -> dict[str, float]:
    """Distance and angle between two poses of an object."""
    turned = abs(float(se2.wrap(end[2] - other[2])))
    return {"position_m": float(np.hypot(*(end - other)[:2])), "yaw_deg": float(np.rad2deg(turned))}


def median_pose(poses: Float[np.ndarray, "S 3"]) -> Float[np.ndarray, "3"]:
    """Median of each coordinate, of yaw about the mean direction."""
    mean = np.arctan2(np.sin(poses[:, 2]).mean(), np.cos(poses[:, 2]).mean())
    return np.array([*np.median(poses[:, :2], axis=0), mean + np.median(se2.wrap(poses[:, 2] - mean))])


def covered(poses: Float[np.ndarray, "S 3"], end: Float[np.ndarray, "3"]) -> bool:
    """Whether ``end`` lies in the ellipsoid about the median of the ``poses`` that holds `SHARE` of them."""
    middle = median_pose(poses)

    def beside(pose: np.ndarray) -> np.ndarray:
        return np.concatenate([pose[..., :2] - middle[:2], se2.wrap(pose[..., 2:] - middle[2])], axis=-1)

    around = beside(poses)
    # Samples that agree would have no inverse.
    inverse = np.linalg.inv(around.T @ around / len(around) + np.diag([1e-6, 1e-6, 3e-6]))
    far = np.einsum("...i,ij,...j->...", around, inverse, around)
    return bool(beside(end) @ inverse @ beside(end) <= np.quantile(far, SHARE))


def measure(rows: Rows) -> dict[str, float]:
    """``NAME_STRATUM_PREDICTION`` for each of the lines of the table, with ``_low`` and ``_high`` of a 95 % interval:
    a bootstrap over objects, as pushes of one object are alike."""
    metrics: dict[str, float] = {}
    for stratum, name in itertools.product(STRATA, PREDICTIONS):
        mine, suffix = [r for r in rows if r["stratum"] == stratum], f"{stratum}_{name}"
        predicted = [r for r in mine if f"{name}_moves" in r]
        metrics[f"pushes_{suffix}"] = len(predicted)
        metrics[f"compared_{suffix}"] = sum(f"{name}_position_m" in r for r in mine)
        for prefix, (key, statistic) in itertools.product(("", "stop_"), _OF_ENDS.items()):
            ends = [r for r in mine if f"{name}_{prefix}{key}" in r]
            values = np.array([r[f"{name}_{prefix}{key}"] for r in ends])
            metrics |= _with_interval(f"{prefix}{key}_{suffix}", ends, values, statistic)
        for event in ("moves", "comes"):
            p, true = (np.array([r[key] for r in predicted]) for key in (f"{name}_{event}", event))
            metrics[f"{event}_{suffix}"] = float(true.sum())
            metrics |= _with_interval(f"right_{event}_{suffix}", predicted, (p >= 0.5) == (true > 0.5), np.mean)
            if name != "robots":
                metrics |= _with_interval(f"brier_{event}_{suffix}", predicted, (p - true) ** 2, np.mean)
    return metrics


def _with_interval(key: str, rows: Rows, values: np.ndarray, statistic: Callable[[Any], Any]) -> dict[str, float]:
    """A statistic of the rows' values; nothing without rows."""
    if not rows:
        return {}
    numbers, objects = values.astype(float), np.array([r["object"] for r in rows])
    groups, rng = [numbers[objects == one] for one in np.unique(objects)], np.random.default_rng(0)
    drawn = rng.integers(len(groups), size=(_RESAMPLES, len(groups)))
    again = [statistic(np.concatenate([groups[i] for i in which])) for which in drawn]
    low, high = np.quantile(again, (0.025, 0.975))
    return {key: float(statistic(numbers)), f"{key}_low": float(low), f"{key}_high": float(high)}


def outcomes_tables() -> tuple[Table, Table]:
    """The main measures, and all of them, by stratum and by what predicts."""
    columns = [(stratum, name) for stratum in STRATA for name in PREDICTIONS]
    heads = tuple(f"{'free' if stratum == 'free' else 'locked wheel'}: {PREDICTIONS[n]}" for stratum, n in columns)

    def table(names: Iterable[str]) -> Table:
        return Table(heads, lines_of({n: _LINES[n] for n in names}, *(f"{{}}_{s}_{name}" for s, name in columns)))

    return table(("position_m", "yaw_deg", "compared", "stop_covered", "right_moves", "pushes")), table(_LINES)


def draw_figure(file: Path, rows: Rows, distance: float) -> None:
    """Draw predicted and true ends of some pushes per stratum along the push, and a reliability diagram."""
    figure = blank_figure(12.0, 4.6)
    *fans, reliability = figure.subplots(1, 3)
    for axes, (stratum, title) in zip(fans, STRATA.items(), strict=True):
        _draw_ends(axes, [r for r in rows if r["stratum"] == stratum])
        axes.set_title(f"{title}, after {distance:g} m or 12 s", fontsize=11)
    _draw_reliability(reliability, rows, distance)
    figure.legend(*fans[0].get_legend_handles_labels(), loc="outside lower left", ncols=3, fontsize=9)
    save_figure(file, figure)


def _draw_ends(axes: Any, rows: Rows) -> None:
    # One push of each of some objects, in the order in which they were drawn.
    first = {row["object"]: row for row in reversed(rows)}
    for colour, row in zip(SERIES[:6], reversed(first.values()), strict=False):
        along = row["start"][2] + row["ahead"]
        ends, end = (
            se2.rotate(np.atleast_2d(row[key])[:, :2] - row["start"][:2], -along) for key in ("posterior_stops", "stop")
        )
        axes.plot(*ends.T, ".", color=colour, ms=5, alpha=0.6)
        axes.plot(*end.T, "*", color=colour, ms=13, markeredgecolor="black", markeredgewidth=0.6)
    axes.plot([], [], ".", color="grey", label="predicted positions, by samples of the posterior")
    axes.plot([], [], "*", color="grey", ms=11, markeredgecolor="black", label="true position")
    axes.plot(0, 0, "k+", ms=10, label="start")
    axes.set_aspect("equal", "datalim")
    axes.set_xlabel("along the push at its start [m]")
    axes.set_ylabel("to its left [m]")


def _draw_reliability(axes: Any, rows: Rows, distance: float) -> None:
    for name, colour, marker in (("posterior", SERIES[0], "o"), ("prior", SERIES[5], "s")):
        p, came = (np.array([r[key] for r in rows]) for key in (f"{name}_comes", "comes"))
        draw_reliability(axes, p, came, colour=colour, label=name, marker=marker)
    axes.set_xlabel(f"predicted probability of {distance:g} m along the push")
    axes.set_ylabel("observed share")
    axes.legend(fontsize=8, title="number of pushes at the points", title_fontsize=8)
    axes.set_title("predicted and observed frequency", fontsize=11)
