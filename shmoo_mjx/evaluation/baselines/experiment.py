"""Experiment `baselines`: predictors of an object that adapt on 25 s of its motion, compared with ours (Sec. V-B).

Every method with settings tries the same number of them on the validation conditions, with the same short budget. The
best setting is trained anew with three seeds and scored on unseen objects. All methods see the same inputs, rows and
protocol (`scoring`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.data import store
from shmoo_mjx.evaluation import replay, scoring, trainings
from shmoo_mjx.evaluation.baselines import METHODS, Budget, recordings
from shmoo_mjx.evaluation.baselines.adaptive import paper_prior, prior
from shmoo_mjx.evaluation.baselines.protocol import Method, output_scale
from shmoo_mjx.evaluation.experiment import Experiment, Setup
from shmoo_mjx.evaluation.result import ExperimentResult, over_seeds
from shmoo_mjx.evaluation.tables import Section, cell, measured, number, over_seeds_cell
from shmoo_mjx.evaluation.trainings import TrainingsConfig, job_of, rows_of, unseen_objects
from shmoo_mjx.learning.samples import samples_from_dataset
from shmoo_mjx.report.style import SERIES, blank_figure, save_figure
from shmoo_mjx.report.tables import markdown_table
from shmoo_mjx.types import DT

REPLAY = "replay"
"""Name of the replay in the plant among the methods (`replay`)."""


@dataclass(frozen=True)
class BaselinesConfig(TrainingsConfig):
    """Settings of the experiment."""

    methods: tuple[str, ...] = (*METHODS, REPLAY)
    settings: int = 4
    """Maximum number of settings that each method tries on the validation conditions, with one seed each."""
    tuning: Budget = field(default_factory=lambda: Budget(8, 150, 8))
    """Training budget of each tried setting."""
    final: Budget = field(default_factory=lambda: Budget(24, 150, 8))
    """Training budget of the chosen setting."""
    fit_seconds: float = 25.0
    """Length of the recording that a method adapts on [s]."""


class _Fit(NamedTuple):
    """One fit of one method."""

    stage: str
    """Stage of the experiment: tune or final."""
    method: str
    setting: int = 0
    """Index in the method's settings."""
    number: int = 0
    """Number of the training with this setting, which sets its seed."""

    @property
    def name(self) -> str:
        return "-".join(map(str, self))


def _methods(config: BaselinesConfig) -> list[Method]:
    return [METHODS[name] for name in config.methods if name != REPLAY]


def _tuned(setup: Setup[BaselinesConfig]) -> dict[str, _Fit]:
    """Fits of each setting of each method that has more than one to try."""
    counts = {m.name: min(setup.config.settings, len(m.settings)) for m in _methods(setup.config)}
    fits = [_Fit("tune", name, i) for name, count in counts.items() if count > 1 for i in range(count)]
    return {fit.name: fit for fit in fits}


def _final(setup: Setup[BaselinesConfig], tuning: list[dict[str, Any]]) -> dict[str, _Fit]:
    """Fits of each method with its best setting on the validation conditions."""
    fits = []
    for method in _methods(setup.config):
        tried = [row for row in tuning if row["tuned"] == method.name]
        best = min(tried, key=lambda row: row["validation_fvu"])["number"] if tried else 0
        seeds = setup.config.seeds if method.trained else 1
        fits += [_Fit("final", method.name, best, seed) for seed in range(seeds)]
    fits += [_Fit("final", REPLAY)] if REPLAY in setup.config.methods else []
    return {fit.name: fit for fit in fits}


def _scored(setup: Setup[BaselinesConfig], fit: _Fit) -> list[dict[str, Any]]:
    """The rows of one fit."""
    config, objects = setup.config, unseen_objects(setup)
    fit_samples = round(config.fit_seconds / DT)
    if fit.method == REPLAY:
        scale = output_scale(samples_from_dataset(store.of_training(setup.data.train).split("train")))
        scores = replay.score(objects, scale, fit_samples)
        return rows_of(objects, scores, {"method": REPLAY, "run": 0, "setting": {}})
    method = METHODS[fit.method]
    budget = config.tuning if fit.stage == "tune" else config.final
    setting = method.settings[fit.setting]
    job = job_of(setup, fit.name, fit.number, budget=budget, fit_samples=fit_samples, setting=setting)
    scale = output_scale(job.train.samples)
    if fit.stage == "tune":
        scores = scoring.score(method.fit(job), job.validation, scale, fit_samples)
        row = {"tuned": method.name, "setting": job.setting, "validation_fvu": float(np.mean(scores["fvu"]))}
        return [row | {"number": fit.setting}]
    rows = []
    before = {"ours": {"prior": prior}, "ours_paper": {"prior_paper": paper_prior}}
    for name, trained in ({method.name: method.fit} | before.get(method.name, {})).items():
        scores = scoring.score(trained(job), recordings(objects), scale, fit_samples)
        rows += rows_of(objects, scores, {"method": name, "run": fit.number, "setting": job.setting})
    return rows


def _metrics(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Mean of each measure over conditions and seeds, its spread over seeds, and the ratios to ours."""
    metrics: dict[str, float] = {}
    rows = [row for row in rows if "method" in row]
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


def _draw(setup: Setup[BaselinesConfig], rows: list[dict[str, Any]]) -> None:
    """Draw the fraction of variance unexplained of each method: median, spread over seeds, and a dot per condition.

    The figure shows the median over conditions and not the mean. An object that hardly moves has almost no variance, so
    its fraction can be in the hundreds.
    """
    rows = [row for row in rows if "method" in row]
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
    axes.set(
        yticks=range(len(names)),
        yticklabels=[_LABELS.get(name, _BEFORE.get(name, name)) for name in names],
        ylim=(-0.6, len(names) - 0.4),
    )
    axes.set(xlim=(0, 2), xlabel="unexplained share of the variance")
    axes.set_title("one step ahead: median, and a dot per object (at the edge: above 2)", fontsize=9)
    save_figure(setup.folder / "baselines.png", figure, 130)


_LABELS = {
    "ours": "ours",
    "ours_paper": "the paper's printed form, trained here",
    "trigonometric": "trigonometric functions of time",
    "residual": "adaptive residual, with contact model",
    "gru": "GRU, with contact model",
    "mlp": "one MLP, no adaptation",
    "constant_velocity": "constant velocity",
    "replay": "simulator with true parameters, mean wrench",
}
_BEFORE = {"prior": "ours, before contact", "prior_paper": "the paper's printed form, before contact"}
_PRIORS = {"ours": "prior", "ours_paper": "prior_paper"}
"""Name of each method's rows before contact."""


def _methods_shown(result: ExperimentResult) -> list[str]:
    """The measured methods, the one with the smallest error first."""
    mse = {name: result.metrics[f"mse_{name}"] for name in _LABELS if f"mse_{name}" in result.metrics}
    return sorted(mse, key=lambda name: math.inf if (error := mse[name]) is None else error)


def baselines_table(result: ExperimentResult) -> str:
    """Markdown table with a line per method: errors before and after adapting, ratios to ours, errors after 3 s."""
    metrics, paper = result.metrics | {"ratio_ours": 1.0}, result.paper
    rows = [
        [
            _LABELS[name],
            over_seeds_cell(metrics, "mse", _PRIORS[name]).replace("-", "") if name in _PRIORS else "",
            over_seeds_cell(metrics, "mse", name),
            cell(metrics, f"ratio_{name}", absent="-"),
            f"{paper[f'ratio_{name}']:g}" if f"ratio_{name}" in paper else "",
            *(over_seeds_cell(metrics, measure, name) for measure in trainings.AFTER_3S),
        ]
        for name in _methods_shown(result)
    ]
    if "mse_prior" in paper:
        rows.append(
            ["the paper, its own objects", *(f"{paper[n]:.3g}" for n in ("mse_prior", "mse_ours")), "", "", "", ""]
        )
    ends = (f"{label[0].upper()}{label[1:]}" for label in trainings.AFTER_3S.values())
    head = ("", "error before contact", "error after 25 s", "error relative to ours", "paper's ratio", *ends)
    return markdown_table(head, rows)


def _further_table(result: ExperimentResult) -> str:
    settings = {row["method"]: row["setting"] for row in result.rows if "method" in row}
    rows = []
    for name in _methods_shown(result):
        setting = ", ".join(f"{key} {value}" for key, value in settings.get(name, {}).items())
        shares = over_seeds_cell(result.metrics, "fvu", name), cell(result.metrics, f"fvu_median_{name}", absent="-")
        rows.append([_LABELS[name], *shares, setting or "default"])
    head = ("", "unexplained share of the variance, mean", "the same, median object", "chosen setting")
    return f"{markdown_table(head, rows)}\n\n{trainings.size_of(result)}"


def _shows(result: ExperimentResult) -> str:
    ratios = {
        _LABELS[name]: (measured(result, f"ratio_{name}"), result.paper[f"ratio_{name}"])
        for name in ("trigonometric", "residual")
        if f"ratio_{name}" in result.metrics
    }
    compared = " and ".join(f"{number(ours)} for {label} (paper: {paper:g})" for label, (ours, paper) in ratios.items())
    ours, printed = (measured(result, f"pos_rmse_3s_m_{name}") for name in ("ours", "ours_paper"))
    return (
        f"The error one step ahead, divided by ours, is {compared}. Methods that get the contact model are close to "
        f"each other one step ahead. Over 3 s, which planning needs, psi misses the position by {number(ours)} m and "
        f"the paper's printed form by {number(printed)} m."
    )


EXPERIMENT = Experiment(
    Section(
        "Comparison with other predictors",
        "Does psi predict better than other learned models with the same data and budget? (Sec. V-B of the paper)",
        (baselines_table, _further_table),
        _shows,
        {"baselines.png": "Unexplained share of the variance of each method: median, and a dot per object"},
    ),
    BaselinesConfig(),
    quick=BaselinesConfig(**trainings.QUICK, settings=1, tuning=Budget(1, 50, 1), final=Budget(3, 100, 3)),
    prepare=trainings.prepare,
    trials=_tuned,
    further_trials=_final,
    trial=_scored,
    metrics=lambda setup, rows: _metrics(rows),
    draw=_draw,
    neutral=("seeds", "methods"),
    # Sec. V-A and V-B; ratio_METHOD is a method's mse over ours.
    paper={
        "mse_ours": 0.4271,
        "mse_prior": 1.3131,
        "mse_trigonometric": 0.5720,
        "ratio_trigonometric": 1.34,
        "ratio_residual": 1.13,
    },
)
