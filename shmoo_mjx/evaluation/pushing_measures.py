"""What is measured of pushing trials: scores by method, stratum and family, and paired differences between methods."""

from __future__ import annotations

from typing import Any

import numpy as np

from shmoo_mjx.evaluation.paired import difference_cell, difference_metrics
from shmoo_mjx.evaluation.result import ExperimentResult

__all__ = ["COMPARED", "OURS", "PAPER", "differences_table", "enclosing_circle", "metrics_of"]

PAPER = {"offset_goal1_m": 0.067, "offset_goal2_m": 0.124, "offset_goal3_m": 0.164}
"""Sec. VI-A: mean final distance from the goal. The circles of Fig. 7 are printed as a picture only."""
OURS = "ours"
COMPARED = {
    "offset_m": ("final offset [m]", False),
    "success": ("success", True),
    "yaw_error_deg": ("yaw error [deg]", False),
    "time_s": ("time [s]", False),
    "pushes": ("pushes", False),
}
"""What methods are compared by, trial by trial: label, and whether more of it is better."""

Rows = list[dict[str, Any]]


def metrics_of(rows: Rows) -> dict[str, Any]:
    """Flat metrics: ours by their names, the other methods as ``baseline_<name>_*``.

    ``difference_<name>_<what>`` with ``_low``, ``_high`` and ``_pairs`` is the mean of ours - theirs over the trials
    that both ran, with its 95 % interval; a group (stratum or family) stands in front of ``what``. ``way_to_hindsight``
    is how much of the frozen prior's offset that hindsight saves is saved by ours.
    """
    metrics: dict[str, Any] = {}
    of = {method: {r["trial"]: r for r in rows if r["method"] == method} for method in _values(rows, "method")}
    for method, mine in of.items():
        prefix = "" if method == OURS else f"baseline_{method}_"
        metrics |= {prefix + name: value for name, value in _scores(list(mine.values())).items()}
        if method != OURS and OURS in of:
            metrics |= _differences(method, of[OURS], mine)
    return metrics | _way_to_hindsight(of)


def _values(rows: Rows, key: str) -> list[Any]:
    return list(dict.fromkeys(row[key] for row in rows))


def _groups(rows: Rows) -> dict[str, tuple[str, Any]]:
    """Name of each group that is looked at by itself, and the field and value that its rows have."""
    named = {"stratum": "", "family": "", "change": "change_"}
    return {prefix + value: (key, value) for key, prefix in named.items() for value in _values(rows, key)}


def _differences(method: str, ours: dict[str, Any], theirs: dict[str, Any]) -> dict[str, float]:
    pairs = [(ours[trial], theirs[trial]) for trial in ours if trial in theirs]
    metrics: dict[str, float] = {}
    parts = {"": pairs}
    for group, (key, value) in _groups([a for a, _ in pairs]).items():
        parts[f"{group}_"] = [(a, b) for a, b in pairs if a[key] == value]
    for group, there in parts.items():
        for name in COMPARED:
            metric = f"difference_{method}_{group}{name}"
            metrics |= difference_metrics(metric, [a[name] for a, _ in there], [b[name] for _, b in there])
    return metrics


def _way_to_hindsight(of: dict[str, dict[str, Any]]) -> dict[str, float]:
    """(prior - ours) / (prior - hindsight) of the mean offsets, over the trials that all three ran."""
    if not {OURS, "frozen_prior", "hindsight"} <= set(of):
        return {}
    common = set(of[OURS]) & set(of["frozen_prior"]) & set(of["hindsight"])
    if not common:
        return {}
    ours, prior, best = (
        float(np.mean([of[m][t]["offset_m"] for t in common])) for m in (OURS, "frozen_prior", "hindsight")
    )
    return {"way_to_hindsight": (prior - ours) / (prior - best)} if prior > best else {}


def _scores(rows: Rows) -> dict[str, Any]:
    scores: dict[str, Any] = {}
    for goal in sorted({row["goal"] for row in rows}):
        there = [row for row in rows if row["goal"] == goal]
        offsets = np.array([row["offset_m"] for row in there])
        scores[f"offset_goal{goal}_m"] = float(offsets.mean())
        scores[f"offset_goal{goal}_std_m"] = float(offsets.std())
        scores[f"circle_goal{goal}_m"] = float(offsets.max())
        finals = np.array([[row["final_x"], row["final_y"]] for row in there])
        scores[f"radius_goal{goal}_m"] = enclosing_circle(finals)[1]
    for name, (key, value) in _groups(rows).items():
        there = [row for row in rows if row[key] == value]
        scores[f"success_rate_{name}"] = float(np.mean([row["success"] for row in there]))
        scores[f"offset_{name}_m"] = float(np.mean([row["offset_m"] for row in there]))
    scores["success_rate"] = float(np.mean([row["success"] for row in rows]))
    scores["offset_m"] = float(np.mean([row["offset_m"] for row in rows]))
    scores["offset_median_m"] = float(np.median([row["offset_m"] for row in rows]))
    scores["yaw_error_deg"] = float(np.mean([row["yaw_error_deg"] for row in rows]))
    scores["falls"] = int(sum(row["fell"] for row in rows))
    scores["worst_lean_rad"] = max(row["worst_lean_rad"] for row in rows)
    scores["least_arm_margin_rad"] = min(row["arm_margin_rad"] for row in rows)
    scores["time_s"] = float(np.mean([row["time_s"] for row in rows]))
    scores["pushes"] = float(np.mean([row["pushes"] for row in rows]))
    scores["trials"] = len(rows)
    return scores


def enclosing_circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre ``[2]`` and radius [m] of the smallest circle round ``points [N, 2]``."""
    import shapely

    points = np.asarray(points, dtype=float)
    if not np.ptp(points, axis=0).any():
        return points[0], 0.0
    cloud = shapely.MultiPoint(points)
    centre = shapely.minimum_bounding_circle(cloud).centroid
    return np.array([centre.x, centre.y]), float(shapely.minimum_bounding_radius(cloud))


def differences_table(result: ExperimentResult) -> str:
    """Ours minus each other method: every measure over all trials, and offset and success by stratum and family."""
    others = [m for m in result.config.get("methods", []) if f"difference_{m}_offset_m" in result.metrics]
    if not others:
        return ""
    lines = [
        "Ours minus each other method over the same trials, with 95 % bootstrap intervals over trials; better and "
        "worse are said where the interval excludes zero.",
        "",
        f"| | {' | '.join('- ' + m.replace('_', ' ') for m in others)} |",
        "|---" * (len(others) + 1) + "|",
    ]
    wanted = [("", name) for name in COMPARED]
    wanted += [(group, name) for group in _groups(result.rows) for name in ("offset_m", "success")]
    for group, name in wanted:
        label, more_is_better = COMPARED[name]
        keys = [f"difference_{m}_{group}{'_' * bool(group)}{name}" for m in others]
        cells = [difference_cell(result.metrics, key, more_is_better) for key in keys]
        lines.append(f"| {label}{', ' * bool(group)}{group.replace('_', ' ')} | {' | '.join(cells)} |")
    return "\n".join(lines)
