"""Experiment real_pushing: a quasi-static model identified from real pushes that other people's robots recorded.

A condition (a shape-surface pair, or a support) is left out. The outline and the model's parameters are fitted on 20 %
of its pushes, drawn at random, with what the other conditions say as prior; the other pushes are predicted. Published
models are scored on exactly those rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.data import real_pushes
from shmoo_mjx.data.real_pushes import RealPushCondition
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation import push_outline, push_physics
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.geometry import se2
from shmoo_mjx.report.style import SERIES, blank_figure, save_figure

PREFIXES = {
    ("mit_push", "pair_out"): "",
    ("mit_push", "shape_out"): "shape_out_",
    ("mlab_triangle", "pair_out"): "mlab_",
}
"""Of the metrics, by data set and protocol. Pair out: other recordings of the same shape are known; shape out: none."""
_NAMES = {"ours": "", "poly4": "published_", "quadratic": "published_quadratic_"}

_BARS = (
    ("pair_out", "ours", "ours, pair left out", SERIES[0]),
    ("shape_out", "ours", "ours, shape left out", SERIES[4]),
    ("pair_out", "poly4", "published 4th-order polynomial", SERIES[1]),
    ("pair_out", "quadratic", "published quadratic", SERIES[7]),
)
"""Of the figure: protocol, predictor, label and colour."""


@dataclass(frozen=True)
class RealPushing:
    """What is tried."""

    seeds: int = 3
    """Each draws the pushes to fit on anew."""
    share: float = 0.2
    """Of a condition's pushes that are fitted on, as the published models were."""
    workers: int = 2


QUICK = RealPushing(seeds=1)


def run(options: ExperimentOptions) -> ExperimentResult:
    """Run the experiment; the figure goes to ``options.out / real_pushing``.

    Raises:
        ShmooError: no --data, or no data set of a known layout in it.
    """
    if options.data is None:
        raise ShmooError("real_pushing needs --data: give the folder that holds mit_push or mlab_triangle.")
    cfg = QUICK if options.quick else RealPushing()
    data = real_pushes.load(options.data)
    folder = options.out / "real_pushing"
    settings = asdict(replace(cfg, seeds=0)) | {"condition_seed": options.condition_seed}
    pushes = sorted(options.data.glob("m*/pushes*.csv"))
    store = folder / f"trials-{fingerprint(__name__, settings, *pushes)}"
    seeds = range(options.seed, options.seed + cfg.seeds)
    trials = {f"{name}-{how}-{seed}": (name, how, seed) for name, how in PREFIXES if name in data for seed in seeds}
    work = partial(_trial, cfg, options.data, options.condition_seed)
    rows = run_trials(trials, work, store, options.progress, cfg.workers)
    _figure(folder / "real_pushing.png", rows)
    return make_result("real_pushing", options, cfg, measure(rows), {}, rows)


def measure(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Mean over the conditions of the mean error; then mean and standard deviation over the seeds."""
    metrics: dict[str, float] = {}
    for trial, prefix in PREFIXES.items():
        own = [row for row in rows if row["trial"] == "-".join(trial)]
        predictors = [key.removesuffix("_pos_error_mm") for row in own[:1] for key in row if key.endswith("_mm")]
        for name in predictors:
            for unit in ("pos_error_mm", "angle_error_deg"):
                seeds = sorted({row["seed"] for row in own})
                means = [np.mean([r[f"{name}_{unit}"] for r in own if r["seed"] == seed]) for seed in seeds]
                key = prefix + _NAMES.get(name, f"{name}_") + unit
                metrics[key] = float(np.mean(means))
                if name == "ours":
                    metrics[f"{key}_std"] = float(np.std(means))
    return metrics


def errors(predicted: Array, motion: Array) -> tuple[float, float]:
    """Mean position error [mm] and mean angle error [deg] of motions ``[N, 3]``."""
    position = np.linalg.norm(predicted[:, :2] - motion[:, :2], axis=1)
    angle = np.abs(se2.wrap(predicted[:, 2] - motion[:, 2]))
    return float(1e3 * position.mean()), float(np.degrees(angle).mean())


def linear(condition: RealPushCondition, known: Array) -> np.ndarray:
    """Motions ``[N, 3]`` by least squares on start and end of the pusher, its ridge chosen by leaving one out."""
    raw = np.concatenate([condition.start, condition.end], axis=1)
    x = np.concatenate([np.ones((len(raw), 1)), (raw - raw[known].mean(axis=0)) / raw[known].std(axis=0)], axis=1)
    fitted = []
    for strength in np.geomspace(1e-3, 1e2, 11):
        penalty = strength * np.diag([0.0] + [1.0] * (x.shape[1] - 1))
        solve = np.linalg.solve(x[known].T @ x[known] + penalty, x[known].T)
        leverage = np.sum(x[known] * solve.T, axis=1)
        weights = solve @ condition.motion[known]
        missed = (condition.motion[known] - x[known] @ weights) / (1.0 - leverage)[:, None]
        fitted.append((float(np.sum(np.mean(missed**2, axis=0) / np.var(condition.motion[known], axis=0))), weights))
    return np.asarray(x @ min(fitted, key=lambda f: f[0])[1])


def credible(condition: RealPushCondition) -> np.ndarray:
    """``[N]`` False where the point touched moved much farther than the pusher: the object's pose was lost.

    It needs the outcome, so it may pick what is fitted on, never what is scored.
    """
    carried = np.linalg.norm(se2.transform_point(condition.motion, condition.start) - condition.start, axis=1)
    return np.asarray(carried < 1.3 * np.linalg.norm(condition.end - condition.start, axis=1))


def fit(
    condition: RealPushCondition,
    known: Array,
    same_shape: Sequence[RealPushCondition] = (),
    prior: tuple[Array, Array] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Outline and quasi-static model from the credible ones of the pushes ``known [n]`` (indices).

    Touches of ``same_shape``, other recordings of this shape, may be used for the outline.

    Returns:
        motions ``[N, 3]`` of all pushes [m, m, rad] and the model's parameters ``[7]``, of which ``prior`` is mean and
        standard deviation.
    """
    known = known[credible(condition)[known]]
    touched = condition.touch[known]
    others = [push_outline.align(o.touch[credible(o)], touched) for o in same_shape]
    corners = push_outline.estimate(np.concatenate([touched, *others]), condition.tip_radius)
    start, end, radius = condition.start, condition.end, condition.tip_radius
    if condition.touching_at_start:
        start, end = push_physics.start_of_push(start, end, corners, radius)
    parameters = push_physics.identify(start[known], end[known], condition.motion[known], corners, radius, prior)
    return push_physics.push(start, end, corners, radius, parameters[None])[0], parameters


def _trial(cfg: RealPushing, directory: Path, condition_seed: int, trial: tuple[str, str, int]) -> list[dict[str, Any]]:
    """Every condition left out once: one row each."""
    data_set, protocol, seed = trial
    data, parameters = real_pushes.load(directory)[data_set], _parameters(directory, data_set)
    rows = []
    for i, (left_out, condition) in enumerate(data.items()):
        train = [
            n for n, c in data.items() if n != left_out and not (protocol == "shape_out" and c.shape == condition.shape)
        ]
        same = [n for n in train if data[n].shape == condition.shape]
        order = np.random.default_rng([condition_seed, seed, i]).permutation(len(condition.start))
        count = round(cfg.share * len(order))
        known, scored = order[:count], order[count:]
        predicted = {
            "ours": fit(condition, known, [data[n] for n in same], _prior([parameters[n] for n in train]))[0],
            **condition.published,
            "linear": linear(condition, known[credible(condition)[known]]),
            "no_motion": np.zeros_like(condition.motion),
        }
        row: dict[str, Any] = {"trial": f"{data_set}-{protocol}", "seed": seed, "condition": left_out}
        row |= {"adapted_on": len(known), "scored": len(scored), "trained_on": train, "outline_from": [left_out, *same]}
        for name, motion in predicted.items():
            found = errors(motion[scored], condition.motion[scored])
            row |= dict(zip((f"{name}_pos_error_mm", f"{name}_angle_error_deg"), found, strict=True))
        rows.append(row)
    return rows


@cache
def _parameters(directory: Path, data_set: str) -> dict[str, np.ndarray]:
    """Of each condition, from all of its own pushes and no other's."""
    data = real_pushes.load(directory)[data_set]
    return {n: fit(c, np.arange(len(c.start)))[1] for n, c in data.items()}


def _prior(parameters: list[Array]) -> tuple[np.ndarray, np.ndarray]:
    """What the other conditions' parameters say about the next one's."""
    known = np.stack(parameters)
    # A few conditions show less than the true spread.
    spread = np.sqrt(known.var(axis=0, ddof=1) + (0.2 * push_physics.SPREAD) ** 2)
    return known.mean(axis=0), spread


def _figure(path: Path, rows: list[dict[str, Any]]) -> None:
    """Bars of the mean error by condition, with the range over the seeds."""
    conditions = list(dict.fromkeys(row["condition"] for row in rows))
    figure = blank_figure(10.0, 6.0)
    panels = figure.subplots(2, 1, sharex=True)
    for axes, unit, label in zip(
        panels, ("pos_error_mm", "angle_error_deg"), ("position error [mm]", "angle error [deg]"), strict=True
    ):
        for j, (protocol, predictor, name, colour) in enumerate(_BARS):
            key = f"{predictor}_{unit}"
            values = [
                [r[key] for r in rows if r["condition"] == c and r["trial"].endswith(protocol) and key in r]
                for c in conditions
            ]
            place = [i for i, v in enumerate(values) if v]
            means = np.array([np.mean(values[i]) for i in place])
            reach = np.array([[means[k] - min(values[i]), max(values[i]) - means[k]] for k, i in enumerate(place)])
            where = np.array(place) + 0.2 * (j - 1.5)
            axes.bar(
                where, means, 0.19, yerr=reach.T if place else None, color=colour, label=name, error_kw={"lw": 0.8}
            )
        axes.set_ylabel(label)
    panels[1].set_xticks(range(len(conditions)), conditions, rotation=45, ha="right", fontsize=8)
    panels[0].legend(fontsize=8, ncols=2)
    save_figure(path, figure)
