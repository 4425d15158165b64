"""Experiment real_pushing: a quasi-static model identified from recorded pushes of other robots.

One condition (a pair of shape and surface, or a support) is left out. The outline and the model's parameters are fitted
to a random 20 % of its pushes, with a prior from the other conditions. The other pushes are predicted. Published models
are scored on the same pushes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.data import real_pushes
from shmoo_mjx.data.real_pushes import RealPushCondition
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation import push_outline, push_physics
from shmoo_mjx.evaluation.experiment import Experiment, ExperimentConfig, Prepared, Setup
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult
from shmoo_mjx.evaluation.tables import Line, Section, SummaryValue, Table, measured, number
from shmoo_mjx.geometry import se2
from shmoo_mjx.report.style import SERIES, blank_figure, save_figure

PREFIXES = {
    ("mit_push", "pair_out"): "",
    ("mit_push", "shape_out"): "shape_out_",
    ("mlab_triangle", "pair_out"): "mlab_",
}
"""Prefix of the metrics by data set and protocol. With pair_out, other recordings of the shape are known; with
shape_out, none are."""
_NAMES = {"ours": "", "poly4": "published_", "quadratic": "published_quadratic_"}

_BARS = (
    ("pair_out", "ours", "ours, pair left out", SERIES[0]),
    ("shape_out", "ours", "ours, shape left out", SERIES[4]),
    ("pair_out", "poly4", "published 4th-order polynomial", SERIES[1]),
    ("pair_out", "quadratic", "published quadratic", SERIES[7]),
)
"""Bars of the figure: protocol, predictor, label and colour."""


@dataclass(frozen=True)
class RealPushing(ExperimentConfig):
    """Size of the experiment."""

    seeds: int = 3
    """Number of seeds. Each draws other pushes for fitting."""
    share: float = 0.2
    """Share of a condition's pushes that are used for fitting, as for the published models."""


def measure(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Mean error over conditions, with mean and standard deviation over seeds."""
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


def linear(condition: RealPushCondition, chosen: Array) -> np.ndarray:
    """Motions ``[N, 3]`` by least squares on start and end of the pusher, its ridge chosen by leaving one out."""
    raw = np.concatenate([condition.start, condition.end], axis=1)
    x = np.concatenate([np.ones((len(raw), 1)), (raw - raw[chosen].mean(axis=0)) / raw[chosen].std(axis=0)], axis=1)
    candidates = []
    for strength in np.geomspace(1e-3, 1e2, 11):
        penalty = strength * np.diag([0.0] + [1.0] * (x.shape[1] - 1))
        solve = np.linalg.solve(x[chosen].T @ x[chosen] + penalty, x[chosen].T)
        leverage = np.sum(x[chosen] * solve.T, axis=1)
        weights = solve @ condition.motion[chosen]
        missed = (condition.motion[chosen] - x[chosen] @ weights) / (1.0 - leverage)[:, None]
        candidates.append(
            (float(np.sum(np.mean(missed**2, axis=0) / np.var(condition.motion[chosen], axis=0))), weights)
        )
    return np.asarray(x @ min(candidates, key=lambda f: f[0])[1])


def credible(condition: RealPushCondition) -> np.ndarray:
    """False ``[N]`` where the touched point moved much farther than the pusher, because the object's pose was lost.

    This uses the outcome, so it may select pushes for fitting but not for scoring.
    """
    carried = np.linalg.norm(se2.transform_point(condition.motion, condition.start) - condition.start, axis=1)
    return np.asarray(carried < 1.3 * np.linalg.norm(condition.end - condition.start, axis=1))


def fit(
    condition: RealPushCondition,
    chosen: Array,
    same_shape: Sequence[RealPushCondition] = (),
    prior: tuple[Array, Array] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Outline and quasi-static model from the credible ones of the pushes ``chosen [n]`` (indices).

    Touches of ``same_shape``, other recordings of this shape, may be used for the outline.

    Returns:
        motions ``[N, 3]`` of all pushes [m, m, rad] and the model's parameters ``[7]``, of which ``prior`` is mean and
        standard deviation.
    """
    chosen = chosen[credible(condition)[chosen]]
    touched = condition.touch[chosen]
    others = [push_outline.align(o.touch[credible(o)], touched) for o in same_shape]
    corners = push_outline.estimate(np.concatenate([touched, *others]), condition.tip_radius)
    start, end, radius = condition.start, condition.end, condition.tip_radius
    if condition.touching_at_start:
        start, end = push_physics.start_of_push(start, end, corners, radius)
    parameters = push_physics.identify(
        start[chosen], end[chosen], condition.motion[chosen], corners=corners, radius=radius, prior=prior
    )
    return push_physics.push(start, end, corners, radius, parameters=parameters[None])[0], parameters


def _prepare(options: ExperimentOptions, cfg: RealPushing, folder: Path) -> Prepared:
    """The names of the data sets.

    Raises:
        ShmooError: no --data, or no data set of a known layout in it.
    """
    if options.data is None:
        raise ShmooError("real_pushing needs --data: give the folder that holds mit_push or mlab_triangle.")
    return Prepared(tuple(real_pushes.load(options.data)), tuple(sorted(options.data.glob("m*/pushes*.csv"))))


def _trials(setup: Setup[RealPushing]) -> dict[str, tuple[str, str, int]]:
    seeds = range(setup.options.seed, setup.options.seed + setup.config.seeds)
    sets = [(name, protocol) for name, protocol in PREFIXES if name in setup.data]
    return {f"{name}-{how}-{seed}": (name, how, seed) for name, how in sets for seed in seeds}


def _trial(setup: Setup[RealPushing], trial: tuple[str, str, int]) -> list[dict[str, Any]]:
    """One row per condition that is left out."""
    data_set, protocol, seed = trial
    directory, condition_seed = setup.options.data, setup.options.condition_seed
    assert directory is not None
    data, parameters = real_pushes.load(directory)[data_set], _parameters(directory, data_set)
    rows = []
    for i, (left_out, condition) in enumerate(data.items()):
        train = [
            n for n, c in data.items() if n != left_out and not (protocol == "shape_out" and c.shape == condition.shape)
        ]
        same = [n for n in train if data[n].shape == condition.shape]
        order = np.random.default_rng([condition_seed, seed, i]).permutation(len(condition.start))
        count = round(setup.config.share * len(order))
        fitted, scored = order[:count], order[count:]
        predicted = {
            "ours": fit(condition, fitted, [data[n] for n in same], _prior([parameters[n] for n in train]))[0],
            **condition.published,
            "linear": linear(condition, fitted[credible(condition)[fitted]]),
            "no_motion": np.zeros_like(condition.motion),
        }
        row: dict[str, Any] = {"trial": f"{data_set}-{protocol}", "seed": seed, "condition": left_out}
        row |= {
            "adapted_on": len(fitted),
            "scored": len(scored),
            "trained_on": train,
            "outline_from": [left_out, *same],
        }
        for name, motion in predicted.items():
            names = f"{name}_pos_error_mm", f"{name}_angle_error_deg"
            row |= dict(zip(names, errors(motion[scored], condition.motion[scored]), strict=True))
        rows.append(row)
    return rows


@cache
def _parameters(directory: Path, data_set: str) -> dict[str, np.ndarray]:
    """Parameters of each condition, fitted to all of its own pushes alone."""
    data = real_pushes.load(directory)[data_set]
    return {n: fit(c, np.arange(len(c.start)))[1] for n, c in data.items()}


def _prior(parameters: list[Array]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of the other conditions' parameters."""
    others = np.stack(parameters)
    # The spread over few conditions underestimates the true spread.
    spread = np.sqrt(others.var(axis=0, ddof=1) + (0.2 * push_physics.SPREAD) ** 2)
    return others.mean(axis=0), spread


def _draw(setup: Setup[RealPushing], rows: list[dict[str, Any]]) -> None:
    """Draw the mean error by condition, with the range over seeds."""
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
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    save_figure(setup.folder / "real_pushing.png", figure)


def _summary(result: ExperimentResult) -> SummaryValue:
    ours, published = (measured(result, f"shape_out_{name}pos_error_mm") for name in ("", "published_"))
    pushes = [row["scored"] for row in result.rows if row["trial"] == "mit_push-shape_out" and row["seed"] == 0]
    return f"{ours:.1f} mm (published model of the same data: {published:.1f} mm)", sum(pushes), ""


_PLACES = {
    "": "other recordings of the shape known",
    "shape_out_": "unseen shape",
    "mlab_": "triangle, unseen support",
}


def _lines(prefixes: Sequence[str]) -> tuple[Line, ...]:
    return tuple(
        Line(
            f"{name} error [{unit}], {_PLACES[prefix]}",
            tuple(f"{prefix}{model}{error}" for model in (*_NAMES.values(), "linear_", "no_motion_")),
        )
        for prefix in prefixes
        for error, name, unit in (("pos_error_mm", "Position", "mm"), ("angle_error_deg", "Angle", "deg"))
    )


_COLUMNS = ("ours", "4th-order, published", "quadratic, published", "linear", "no motion")


def _shows(result: ExperimentResult) -> str:
    known, ours, published = (
        number(measured(result, f"{name}pos_error_mm")) for name in ("", "shape_out_", "shape_out_published_")
    )
    return (
        f"The model misses the position by {known} mm if it has other recordings of the same shape, because it then "
        f"knows the outline. For an unseen shape it has to estimate the outline from touches and misses by {ours} mm. "
        f"The published model of the same data, which was given the outline, misses by {published} mm."
    )


EXPERIMENT = Experiment(
    Section(
        "Recorded pushes of other robots",
        "Does the contact physics behind the system predict real pushes?",
        (Table(_COLUMNS, _lines(("", "shape_out_"))), Table(_COLUMNS, _lines(tuple(_PLACES)))),
        _shows,
        {"real_pushing.png": "Errors on each shape and surface, with the range over seeds"},
        arguments=lambda config: "--data DIR",
        without_weights=True,
        summary=(("Position error on recorded pushes of unseen shapes", _summary),),
    ),
    RealPushing(),
    quick=RealPushing(seeds=1),
    prepare=_prepare,
    trials=_trials,
    trial=_trial,
    metrics=lambda setup, rows: measure(rows),
    draw=_draw,
    neutral=("seeds",),
)
