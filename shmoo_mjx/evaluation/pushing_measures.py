"""Metrics and tables of pushing trials: scores by method, stratum and family, and paired differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from shmoo_mjx.evaluation.paired import OURS, difference_metrics, metrics_by_method
from shmoo_mjx.evaluation.pushing_trials import EVERYTHING, KINDS
from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.evaluation.tables import cell, differences_table, lines_of, percent, shown_name
from shmoo_mjx.plant.objects import FAMILIES
from shmoo_mjx.report.tables import markdown_table

PAPER = {"offset_goal1_m": 0.067, "offset_goal2_m": 0.124, "offset_goal3_m": 0.164}
"""Sec. VI-A: mean final distance from the goal. The circles of Fig. 7 are given only in the figure."""
COMPARED = {
    "offset_m": ("Distance from the goal [m]", False),
    "success": ("Success rate", True),
    "yaw_error_deg": ("Yaw error [deg]", False),
    "time_s": ("Time [s]", False),
    "pushes": ("Number of pushes", False),
}
"""Measures by which methods are compared: label, and whether a larger value is better."""

_GROUP_LABELS = {
    "movable": "movable objects",
    "demanding": "demanding objects",
    "change_none": "no change on the way",
    "change_mass": "mass added on the way",
    "change_brake": "brake pressed on the way",
    **{f"kind_{kind}": label for kind, label in KINDS.items()},
}

_PREFIX = f"{EVERYTHING}_"
_EVERYTHING = {
    "success_rate": "Success rate",
    **{f"success_rate_{family}": f"Success rate, {family}" for family in FAMILIES},
    **{f"success_rate_kind_{kind}": f"Success rate, {label}" for kind, label in KINDS.items()},
    "offset_median_m": "Median distance from the goal [m]",
    "yaw_error_median_deg": "Median yaw error [deg]",
    "falls": "Falls",
    "toppled": "Objects toppled",
    "time_s": "Mean time [s]",
    "trials": "Trials",
}
"""Lines of the table of the stratum "everything"."""

_SCORES: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "success_rate": ("success", np.mean),
    "offset_m": ("offset_m", np.mean),
    "offset_median_m": ("offset_m", np.median),
    "yaw_error_deg": ("yaw_error_deg", np.mean),
    "yaw_error_median_deg": ("yaw_error_deg", np.median),
    "falls": ("fell", np.sum),
    "toppled": ("toppled", np.sum),
    "worst_lean_rad": ("worst_lean_rad", np.max),
    "least_arm_margin_rad": ("arm_margin_rad", np.min),
    "time_s": ("time_s", np.mean),
    "pushes": ("pushes", np.mean),
}
"""Metrics over all rows: field of a row and statistic."""

Rows = list[dict[str, Any]]


def metrics_of(rows: Rows) -> dict[str, Any]:
    """Metrics of all methods: ours by name, those of others as ``baseline_METHOD_*``.

    ``difference_METHOD_NAME`` with ``_low``, ``_high`` and ``_pairs`` is the mean of ours minus theirs over the trials
    that both ran, with its 95 % interval. In front of NAME there may be a group, such as a stratum or a family.
    ``way_to_oracle`` is the reduction of the mean offset by ours as a share of the reduction by oracle coefficients,
    both compared with the frozen prior. Metrics of the stratum "everything" begin with ``everything_``.
    """
    chosen, all_drawn = _parts(rows)
    return _metrics(chosen) | {_PREFIX + name: value for name, value in _metrics(all_drawn).items()}


def _parts(rows: Rows) -> tuple[Rows, Rows]:
    """The rows of the strata that leave objects out, and of the stratum that does not."""
    return [r for r in rows if r["stratum"] != EVERYTHING], [r for r in rows if r["stratum"] == EVERYTHING]


def _metrics(rows: Rows) -> dict[str, Any]:
    of = {method: {r["trial"]: r for r in rows if r["method"] == method} for method in _values(rows, "method")}
    return metrics_by_method(of, _scores, _differences) | _way_to_oracle(of)


def _values(rows: Rows, key: str) -> list[Any]:
    return list(dict.fromkeys(row[key] for row in rows if row.get(key, "")))


def _groups(rows: Rows) -> dict[str, tuple[str, Any]]:
    """Name of each group to the field and value that its rows have."""
    named = {"stratum": "", "family": "", "change": "change_", "kind": "kind_"}
    return {prefix + value: (key, value) for key, prefix in named.items() for value in _values(rows, key)}


def _differences(method: str, pairs: list[tuple[dict[str, Any], dict[str, Any]]]) -> dict[str, float]:
    parts = {"": pairs}
    for group, (key, value) in _groups([ours for ours, _ in pairs]).items():
        parts[f"{group}_"] = [pair for pair in pairs if pair[0].get(key) == value]
    metrics: dict[str, float] = {}
    for group, there in parts.items():
        for name in COMPARED:
            metrics |= difference_metrics(f"difference_{method}_{group}{name}", name, there)
    return metrics


def _way_to_oracle(of: dict[str, dict[str, Any]]) -> dict[str, float]:
    """(prior - ours) / (prior - oracle) of the mean offsets, over the trials that all three ran."""
    if not {OURS, "frozen_prior", "oracle_coefficients"} <= set(of):
        return {}
    common = set(of[OURS]) & set(of["frozen_prior"]) & set(of["oracle_coefficients"])
    if not common:
        return {}
    ours, prior, best = (
        float(np.mean([of[m][t]["offset_m"] for t in common])) for m in (OURS, "frozen_prior", "oracle_coefficients")
    )
    return {"way_to_oracle": (prior - ours) / (prior - best)} if prior > best else {}


def _scores(rows: Rows) -> dict[str, Any]:
    scores: dict[str, Any] = {}
    for goal in sorted(_values(rows, "goal")):
        there = [row for row in rows if row["goal"] == goal]
        offsets = np.array([row["offset_m"] for row in there])
        scores[f"offset_goal{goal}_m"] = float(offsets.mean())
        scores[f"offset_goal{goal}_std_m"] = float(offsets.std())
        scores[f"circle_goal{goal}_m"] = float(offsets.max())
        scores[f"radius_goal{goal}_m"] = enclosing_circle(np.array([[r["final_x"], r["final_y"]] for r in there]))[1]
    for name, (key, value) in _groups(rows).items():
        there = [row for row in rows if row.get(key) == value]
        scores[f"trials_{name}"] = len(there)
        scores[f"success_rate_{name}"] = float(np.mean([row["success"] for row in there]))
        scores[f"offset_{name}_m"] = float(np.mean([row["offset_m"] for row in there]))
    scores |= {name: statistic([row[key] for row in rows]).item() for name, (key, statistic) in _SCORES.items()}
    return scores | {"trials": len(rows)}


def enclosing_circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre ``[2]`` and radius [m] of the smallest circle round ``points [N, 2]``."""
    import shapely

    points = np.asarray(points, dtype=float)
    if not np.ptp(points, axis=0).any():
        return points[0], 0.0
    cloud = shapely.MultiPoint(points)
    centre = shapely.minimum_bounding_circle(cloud).centroid
    return np.array([centre.x, centre.y]), float(shapely.minimum_bounding_radius(cloud))


def pushing_tables(result: ExperimentResult) -> str:
    """Tables of the differences between methods, and of the stratum "everything"."""
    own = {name.removeprefix(_PREFIX): v for name, v in result.metrics.items() if name.startswith(_PREFIX)}
    chosen, all_drawn = _parts(result.rows)
    tables = [pushing_differences(result.model_copy(update={"rows": chosen}))]
    if all_drawn:
        everything = result.model_copy(update={"rows": all_drawn, "metrics": own})
        tables += ["## Objects as drawn, none left out", _about_everything(everything), pushing_differences(everything)]
    return "\n\n".join(table for table in tables if table)


def _about_everything(result: ExperimentResult) -> str:
    """The composition of the stratum "everything" and the scores of each method."""
    trials = result.metrics["trials"] or 0.0
    counts = {kind: result.metrics.get(f"trials_kind_{kind}") or 0.0 for kind in KINDS}
    held = "; ".join(f"{percent(counts[kind] / trials)} {label}" for kind, label in KINDS.items())
    methods = _values(result.rows, "method")
    lines = lines_of(_EVERYTHING, *("{}" if method == OURS else f"baseline_{method}_{{}}" for method in methods))
    rows = [[line.label, *(cell(result.metrics, name, infinite="") for name in line.metrics)] for line in lines]
    table = markdown_table(["", *map(shown_name, methods)], rows)
    return f"Trials: {held}.\n\n{table}"


def pushing_differences(result: ExperimentResult) -> str:
    """Table of ours minus each other method: every measure over all trials, offset and success by group."""
    others = [m for m in result.config.get("methods", []) if f"difference_{m}_offset_m" in result.metrics]
    if not others:
        return ""
    lines = [(label, name, better) for name, (label, better) in COMPARED.items()]
    for group, (key, _) in _groups(result.rows).items():
        if len(_values(result.rows, key)) < 2:
            continue
        for name in ("offset_m", "success"):
            label, better = COMPARED[name]
            lines.append((f"{label}, {_GROUP_LABELS.get(group, group)}", f"{group}_{name}", better))
    return differences_table(result.metrics, others, lines)
