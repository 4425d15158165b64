"""Experiment `baselines`: ours beside every other way to predict an object from 25 s of it (Sec. V-B).

Every method tries the same number of settings on the validation conditions with the same short budget; the best is
trained anew with three seeds and scored on unseen objects. All see the same inputs, rows and protocol (`scoring`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.data import store
from shmoo_mjx.evaluation import replay, scoring, trainings
from shmoo_mjx.evaluation.baselines import METHODS, Budget, recordings
from shmoo_mjx.evaluation.baselines.adaptive import prior
from shmoo_mjx.evaluation.baselines.protocol import Method, output_scale
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result, over_seeds
from shmoo_mjx.evaluation.trainings import Trainings, TrainingsConfig, prepare, rows_of
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.learning.samples import samples_from_dataset
from shmoo_mjx.report.style import SERIES, blank_figure, save_figure
from shmoo_mjx.types import DT

PAPER = {
    "mse_ours": 0.4271,
    "mse_prior": 1.3131,
    "mse_trigonometric": 0.5720,
    "ratio_trigonometric": 1.34,
    "ratio_residual": 1.13,
}
"""Sec. V-A and V-B; ratio_<name> is a method's mse over ours."""


REPLAY = "replay"
"""Name of the plant itself among the methods (`replay`)."""


@dataclass(frozen=True)
class BaselinesConfig(TrainingsConfig):
    """What is compared and how hard each is tried."""

    methods: tuple[str, ...] = (*METHODS, REPLAY)
    settings: int = 4
    """Settings that each method tries on the validation conditions, with seed 0 and the tuning budget."""
    tuning: Budget = field(default_factory=lambda: Budget(8, 150, 8))
    final: Budget = field(default_factory=lambda: Budget(24, 150, 8))
    """For the chosen setting."""
    fit_seconds: float = 25.0
    """Recording that a method adapts on [s]."""


QUICK = BaselinesConfig(**trainings.QUICK, settings=1, tuning=Budget(1, 50, 1), final=Budget(3, 100, 3))


class _Fit(NamedTuple):
    """One fit of one method."""

    stage: str
    """tune or final."""
    method: str
    setting: int = 0
    """Place among the method's settings."""
    number: int = 0
    """Training with this setting."""

    @property
    def name(self) -> str:
        return "-".join(map(str, self))


def run(options: ExperimentOptions, config: BaselinesConfig | None = None) -> ExperimentResult:
    """Tune, train and score every method; goes on from ``options.out`` after a stop."""
    config = config or (QUICK if options.quick else BaselinesConfig())
    # How many there are, of what, changes neither what a fit gives nor what it is compared with.
    shared = prepare(__name__, "baselines", options, config, {"seeds": 1, "methods": ()})
    methods = [METHODS[name] for name in config.methods if name != REPLAY]
    tried = _tune(methods, shared, config, options)
    chosen = {
        name: min(rows, key=lambda row: row["validation_fvu"])["number"] if rows else 0 for name, rows in tried.items()
    }
    fits = [
        _Fit("final", m.name, chosen[m.name], seed) for m in methods for seed in range(config.seeds if m.trained else 1)
    ]
    fits += [_Fit("final", REPLAY)] if REPLAY in config.methods else []
    rows = _run(fits, shared, config, options)
    tuning = [row for name in tried for row in tried[name]]
    result = make_result("baselines", options, config, _metrics(rows), PAPER, [*tuning, *rows])
    _figure(result, options.out / "baselines" / "baselines.png")
    return result


def _tune(
    methods: list[Method], shared: Trainings, config: BaselinesConfig, options: ExperimentOptions
) -> dict[str, list[dict[str, Any]]]:
    """What each setting of each method gave on the validation conditions; nothing where there is only one to try."""
    counts = {m.name: min(config.settings, len(m.settings)) for m in methods}
    fits = [_Fit("tune", name, i) for name, count in counts.items() if count > 1 for i in range(count)]
    rows = _run(fits, shared, config, options)
    numbered = [row | {"number": fit.setting} for fit, row in zip(fits, rows, strict=True)]
    return {m.name: [row for row in numbered if row["tuned"] == m.name] for m in methods}


def _run(
    fits: list[_Fit], shared: Trainings, config: BaselinesConfig, options: ExperimentOptions
) -> list[dict[str, Any]]:
    named = {fit.name: fit for fit in fits}
    return run_trials(named, partial(_scored, shared, config), shared.folder, options.progress, config.workers)


def _scored(shared: Trainings, config: BaselinesConfig, fit: _Fit) -> list[dict[str, Any]]:
    """The rows of one fit."""
    fit_samples = round(config.fit_seconds / DT)
    if fit.method == REPLAY:
        scale = output_scale(samples_from_dataset(store.of_training(shared.train).split("train")))
        found = replay.score(shared.objects(), scale, fit_samples)
        return rows_of(shared.objects(), found, {"method": REPLAY, "run": 0, "setting": {}})
    method = METHODS[fit.method]
    budget = config.tuning if fit.stage == "tune" else config.final
    job = shared.job(fit.name, fit.number, budget, fit_samples, method.settings[fit.setting])
    scale = output_scale(job.train.samples)
    if fit.stage == "tune":
        found = scoring.score(method.fit(job), job.validation, scale, fit_samples)
        return [{"tuned": method.name, "setting": job.setting, "validation_fvu": float(np.mean(found["fvu"]))}]
    rows, recorded = [], recordings(shared.objects())
    for name, trained in ({method.name: method.fit} | ({"prior": prior} if method.name == "ours" else {})).items():
        found = scoring.score(trained(job), recorded, scale, fit_samples)
        rows += rows_of(shared.objects(), found, {"method": name, "run": fit.number, "setting": job.setting})
    return rows


def _metrics(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Mean over conditions and seeds of each measure, the spread over seeds, and the ratios to ours."""
    metrics: dict[str, float] = {}
    for method in dict.fromkeys(row["method"] for row in rows):
        mine = [row for row in rows if row["method"] == method]
        runs = sorted({row["run"] for row in mine})
        for measure in scoring.NAMES:
            of_runs = (np.array([row[measure] for row in mine if row["run"] == run]) for run in runs)
            of_seeds = [np.nan if np.isnan(values).all() else np.nanmean(values) for values in of_runs]
            metrics |= over_seeds(measure, method, of_seeds)
        medians = [np.nanmedian([row["fvu"] for row in mine if row["run"] == run]) for run in runs]
        metrics[f"fvu_median_{method}"] = float(np.mean(medians))
        for family in dict.fromkeys(row["family"] for row in mine):
            metrics[f"fvu_{family}_{method}"] = float(np.mean([r["fvu"] for r in mine if r["family"] == family]))
    if "mse_ours" in metrics:
        others = [name for name in dict.fromkeys(row["method"] for row in rows) if name != "ours"]
        metrics |= {f"ratio_{name}": metrics[f"mse_{name}"] / metrics["mse_ours"] for name in others}
    return metrics


def _figure(result: ExperimentResult, path: Path) -> None:
    """Fraction of variance unexplained of each method: median over conditions, spread of seeds, a dot per condition.

    Not the mean: a condition that hardly moves has next to no variance, and may leave hundreds of times as much.
    """
    rows = [row for row in result.rows if "method" in row]
    medians: dict[str, list[float]] = {}
    for name in dict.fromkeys(row["method"] for row in rows):
        runs = sorted({row["run"] for row in rows if row["method"] == name})
        of_runs = [[row["fvu"] for row in rows if row["method"] == name and row["run"] == run] for run in runs]
        medians[name] = [float(np.nanmedian(values)) for values in of_runs]
    names = sorted(medians, key=lambda name: -np.mean(medians[name]))
    figure = blank_figure(7.0, 0.32 * len(names) + 1.2)
    axes = figure.subplots()
    for place, name in enumerate(names):
        spread = np.std(medians[name])
        colour = SERIES[0] if name.startswith("ours") else "#999999"
        axes.barh(place, np.mean(medians[name]), xerr=spread, color=colour, height=0.62, error_kw={"elinewidth": 1.2})
        dots = [row["fvu"] for row in rows if row["method"] == name and row["run"] == 0]
        axes.plot(np.clip(dots, 0, 2), np.full(len(dots), place), "k.", markersize=3, alpha=0.5)
    axes.axvline(1.0, color="black", linewidth=0.8, linestyle=":")
    axes.set(yticks=range(len(names)), yticklabels=names, ylim=(-0.6, len(names) - 0.4))
    axes.set(xlim=(0, 2), xlabel="fraction of variance unexplained")
    axes.set_title("unseen objects, one step, after 25 s: median, a dot per object (over 2: at the edge)", fontsize=9)
    save_figure(path, figure, 130)
