"""The numbers that the page of results and the README begin with, at most ten, each from an experiment's metrics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from statistics import fmean
from typing import NamedTuple

from shmoo_mjx.evaluation.result import ExperimentResult

Value = tuple[str, int, str]
"""The value with its interval, the number of trials, and the paper's number ("" without one)."""


class SummaryRow(NamedTuple):
    """One number of the summary."""

    experiment: str
    label: str
    value: str
    """With its unit, and its 95 % interval where there is one."""
    trials: int
    paper: str
    """The paper's number; "" where it has none."""


def summary(results: Mapping[str, ExperimentResult]) -> list[SummaryRow]:
    """The rows whose experiment is among ``results`` and has measured what they show."""
    rows = []
    for experiment, label, value in _ROWS:
        if experiment in results:
            try:
                rows.append(SummaryRow(experiment, label, *value(results[experiment])))
            except _NotMeasured:
                continue
    return rows


class _NotMeasured(Exception):
    """The result lacks a number that a row shows."""


def _metric(result: ExperimentResult, name: str) -> float:
    value = result.metrics.get(name)
    if value is None:
        raise _NotMeasured
    return value


def _number(value: float, sign: str = "") -> str:
    return f"{value + 0.0:{sign}.{0 if abs(value) >= 10 else 1}f}"


def _rate(name: str, trials: Callable[[ExperimentResult], float]) -> Callable[[ExperimentResult], Value]:
    """A share of independent trials in per cent, with its Wilson interval."""

    def value(result: ExperimentResult) -> Value:
        from scipy.stats import binomtest

        rate, n = _metric(result, name), round(trials(result))
        if n < 1:
            raise _NotMeasured
        low, high = binomtest(round(rate * n), n).proportion_ci(method="wilson")
        return f"{100 * rate:.0f} % ({100 * low:.0f} to {100 * high:.0f})", n, ""

    return value


def _difference(name: str, unit: str, scale: float = 1.0) -> Callable[[ExperimentResult], Value]:
    """A mean difference over the same trials, with its bootstrap interval."""

    def value(result: ExperimentResult) -> Value:
        mean, low, high = (scale * _metric(result, name + end) for end in ("", "_low", "_high"))
        interval = f"{_number(low)} to {_number(high)}"
        return f"{_number(mean, '+')} {unit} ({interval})", round(_metric(result, f"{name}_pairs")), ""

    return value


def _offset(result: ExperimentResult) -> Value:
    mean, median = (100 * _metric(result, name) for name in ("offset_m", "offset_median_m"))
    goals = [result.paper[name] for name in sorted(result.paper) if name.startswith("offset_goal")]
    paper = f"{_number(100 * fmean(goals))} cm" if goals else ""
    return f"{_number(mean)} cm (median {_number(median)} cm)", round(_metric(result, "trials")), paper


def _adapted(result: ExperimentResult) -> Value:
    paper = result.paper.get("ratio_after_before")
    unseen = result.config.get("unseen", {})
    return (
        f"{_metric(result, 'ratio_after_before'):.2f}",
        sum(unseen.values()) if isinstance(unseen, dict) else int(unseen),
        "" if paper is None else f"{paper:.2f}",
    )


def _real_pushes(result: ExperimentResult) -> Value:
    ours, published = (_metric(result, f"shape_out_{name}pos_error_mm") for name in ("", "published_"))
    pushes = [row["scored"] for row in result.rows if row["trial"] == "mit_push-shape_out" and row["seed"] == 0]
    return f"{ours:.1f} mm (published model of the same data: {published:.1f} mm)", sum(pushes), ""


_ROWS: tuple[tuple[str, str, Callable[[ExperimentResult], Value]], ...] = (
    (
        "navigation",
        "Success rate of navigation, solvable scenarios",
        _rate("success_rate_certified", lambda r: _metric(r, "certified")),
    ),
    (
        "navigation",
        "Success rate compared with never pushing",
        _difference("difference_always_avoid_success", "points", 100.0),
    ),
    (
        "navigation",
        "Time lost compared with going round if possible",
        _difference("difference_lazy_regret_s", "s"),
    ),
    (
        "pushing",
        "Success rate of pushing movable objects to a pose",
        _rate("success_rate", lambda r: _metric(r, "trials")),
    ),
    (
        "pushing",
        "Success rate compared with no adaptation",
        _difference("difference_frozen_prior_success", "points", 100.0),
    ),
    ("pushing", "Mean distance from the goal after pushing", _offset),
    (
        "pushing",
        "Distance from the goal compared with no adaptation",
        _difference("difference_frozen_prior_offset_m", "cm", 100.0),
    ),
    (
        "object_planner",
        "Accuracy of the decision whether an object can be moved",
        _rate("accuracy", lambda r: float(r.config.get("objects", 0))),
    ),
    ("object_model", "Prediction error after adaptation, as a share of the error before", _adapted),
    ("real_pushing", "Position error on recorded pushes of unseen shapes", _real_pushes),
)
"""Experiment, label, and what the row shows of the experiment's result."""
