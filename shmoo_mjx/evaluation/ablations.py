"""Experiment `ablations`: what each choice in learning psi brings, one changed at a time, and how much psi gives away.

Trainings of psi as long as the shipped one, a few seeds each, scored on unseen objects by the protocol of `scoring`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from shmoo_mjx.data import store
from shmoo_mjx.evaluation import probe, scoring, trainings
from shmoo_mjx.evaluation.baselines import Budget, recordings
from shmoo_mjx.evaluation.baselines.adaptive import daiml_config, from_fit
from shmoo_mjx.evaluation.baselines.protocol import output_scale
from shmoo_mjx.evaluation.experiment import Experiment, Setup
from shmoo_mjx.evaluation.result import ExperimentResult, over_seeds
from shmoo_mjx.evaluation.tables import SNAPSHOT, Section, cell, number, over_seeds_cell
from shmoo_mjx.evaluation.trainings import AFTER_3S, TrainingsConfig, job_of, unseen_objects
from shmoo_mjx.learning import daiml
from shmoo_mjx.learning.daiml import DaimlConfig
from shmoo_mjx.report.tables import markdown_table
from shmoo_mjx.types import DT

VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "horizon_1": {"horizon": 1},
    "plain_ridge": {"coupled": False},
    "shared_functions": {"per_axis": False},
    "no_linear_terms": {"linear_terms": False},
    "no_contact_model": {"contact_model": False},
    "no_last_wrench": {"last_wrench": False},
    "functions_3": {"functions": 3},
    "no_adversary": {"alpha": 0.0},
}
"""Name -> what differs from the shipped settings of DAIML."""

PROBED = ("default", "no_adversary")
"""Variants whose psi a fresh probe looks at."""
_MEASURES = {
    "mse": "mean squared error",
    "fvu": "unexplained share of the variance, mean",
    "fvu_median": "unexplained share, median object",
    **AFTER_3S,
    "probe_psi": "probe: share of conditions told from psi",
}
"""With their heads in the table."""


@dataclass(frozen=True)
class AblationsConfig(TrainingsConfig):
    """What is varied and how long each variant trains."""

    variants: tuple[str, ...] = tuple(VARIANTS)
    budget: Budget = field(default_factory=lambda: Budget(24, 150, 12))
    """As long as the shipped training: shorter ones prefer settings that a long one does not."""
    seeds: int = 2
    fit_seconds: tuple[float, ...] = (5.0, 10.0, 25.0)
    """Recording that the default variant adapts on [s]; the others take the longest. All are scored on later rows."""
    probes: int = 3
    """Probes with seeds of their own, for each psi."""
    probe_updates: int = 1500


def _trials(setup: Setup[AblationsConfig]) -> dict[str, tuple[str, int]]:
    """``raw`` stands for probes on the inputs themselves."""
    config = setup.config
    variants = {f"{variant}-{i}": (variant, i) for variant in config.variants for i in range(config.seeds)}
    return {"raw-0": ("raw", 0)} | variants


def _trained(setup: Setup[AblationsConfig], trial: tuple[str, int]) -> list[dict[str, Any]]:
    """One variant with one seed."""
    config, (variant, number) = setup.config, trial
    label = {"variant": variant, "run": number}
    fit_samples, setting = round(max(config.fit_seconds) / DT), VARIANTS.get(variant)
    job = job_of(setup, f"{variant}-{number}", number, budget=config.budget, fit_samples=fit_samples, setting=setting)
    samples = job.train.samples
    if variant == "raw":
        raw = {"inputs": samples.inputs, "inputs_without_size": probe.raw_without_size(samples)}
        shares = {f"probe_{what}": _probe(config, values, samples.weights) for what, values in raw.items()}
        return [label | shares | {"chance": 1 / len(samples.inputs)}]
    settings = daiml_config(job, DaimlConfig())
    fitted = daiml.fit_samples(samples, job.validation.samples, settings, out_dir=job.directory)
    predictor, unseen = from_fit(fitted, settings), recordings(unseen_objects(setup))
    scale = output_scale(recordings(store.of_training(setup.data.train).split("train")).samples)
    rows = []
    for seconds in config.fit_seconds if variant == "default" else (max(config.fit_seconds),):
        scores = scoring.score(predictor, unseen, scale, round(seconds / DT), from_sample=fit_samples)
        # The mean hangs on objects that hardly move.
        median = {"fvu_median": float(np.nanmedian(scores["fvu"]))}
        rows.append(label | {"fit_seconds": seconds} | scoring.average(scores) | median)
    if variant in PROBED:
        rows[-1]["probe_psi"] = _probe(config, probe.psi_of(fitted, settings, samples), samples.weights)
    return rows


def _probe(config: AblationsConfig, values: Any, weights: Any) -> float:
    probes = range(config.probes)
    return float(np.mean([probe.accuracy(values, weights, seed, config.probe_updates) for seed in probes]))


def _metrics(rows: list[dict[str, Any]], config: AblationsConfig) -> dict[str, float]:
    """Mean and spread over the seeds; the names of the variants with 5 s and 10 s to adapt end so."""
    metrics: dict[str, float] = {}
    longest = max(config.fit_seconds)
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        seconds = row.get("fit_seconds", longest)
        groups.setdefault(row["variant"] + (f"_{seconds:g}s" if seconds != longest else ""), []).append(row)
    raw = groups.pop("raw")[0]
    for name, mine in groups.items():
        for measure in _MEASURES:
            metrics |= over_seeds(measure, name, [row.get(measure, np.nan) for row in mine])
    return metrics | {name: raw[name] for name in ("chance", "probe_inputs", "probe_inputs_without_size")}


_LABELS = {
    "default": "the shipped form",
    "default_5s": "the shipped form, adapted on 5 s",
    "default_10s": "the shipped form, adapted on 10 s",
    "horizon_1": "trained one step ahead",
    "plain_ridge": "a ridge in place of the learned prior",
    "shared_functions": "functions shared by x, y and yaw",
    "no_linear_terms": "without linear terms",
    "no_contact_model": "without the contact model",
    "no_last_wrench": "without the last wrench",
    "functions_3": "3 functions in place of 12",
    "no_adversary": "without the adversary",
}
_MAIN = ("mse", "fvu_median", *AFTER_3S)


def _table(result: ExperimentResult, measures: Sequence[str]) -> str:
    metrics = result.metrics
    names = [key.removeprefix("mse_") for key in metrics if key.startswith("mse_") and not key.startswith("mse_std_")]
    rows = [[_LABELS.get(n, n), *(over_seeds_cell(metrics, measure, n) for measure in measures)] for n in names]
    return markdown_table(("", *(_MEASURES[measure] for measure in measures)), rows)


def ablations_table(result: ExperimentResult) -> str:
    """One line per variant: errors on unseen objects."""
    return _table(result, _MAIN)


def _further_table(result: ExperimentResult) -> str:
    """All measures, and how well a fresh probe tells the condition from psi."""
    inputs, without_size, chance = (
        cell(result.metrics, name) for name in ("probe_inputs", "probe_inputs_without_size", "chance")
    )
    probes = f"The same probe on the raw inputs: {inputs}; without the size: {without_size}; chance: {chance}."
    return "\n\n".join([_table(result, tuple(_MEASURES)), probes, trainings.size_of(result)])


def _shows(result: ExperimentResult) -> str:
    errors = {n: result.metrics.get(f"pos_rmse_3s_m_{n}") for n in _LABELS if not n.startswith("default_")}
    known = {n: value for n, value in errors.items() if value is not None}
    if "default" not in known or len(known) < 3:
        return ""
    best, *_, second, worst = sorted(known, key=lambda n: known[n])
    return (
        f"Over 3 s the smallest error is that of {_LABELS[best]} ({number(known[best])} m; the shipped form: "
        f"{number(known['default'])} m), the largest are those of {_LABELS[worst]} ({number(known[worst])} m) and "
        f"{_LABELS[second]} ({number(known[second])} m)."
    )


COST_TERMS = {
    "running": "cost of the mean pose distance over the roll-out",
    "lateral": "cost of hands beside the middle of the face",
    "heading": "cost of a heading off the face's normal",
    "aim": "cost of a goal beside the line or arc of the push",
    "speed": "cost of the object's final speed",
    "overspeed": "cost of robot speed, and slowing down before the goal",
    "heading_and_overspeed": "both: heading and robot speed",
    "governor": "governor of the lean",
    "governor_room": "lower bound of the governor",
    "foresees_governor": "governor in the roll-outs",
    "running_lateral_foresees": "three: mean distance, hands, governor in the roll-outs",
}
"""Parts of the pushing controller, by their names in `benchmarks.without`."""
_EFFECTS = {
    "success": "success rate",
    "offset_m": "distance [m]",
    "yaw_error_deg": "yaw error [deg]",
    "time_s": "time [s]",
}


def cost_terms_table(result: ExperimentResult) -> str:
    """Change of pushing to a pose without one part of the controller, from a result of the experiment pushing.

    The result's methods are ours and those of `benchmarks.without`.
    """

    def change(part: str, name: str) -> str:
        key = f"difference_benchmarks.without:{part}_{name}"
        mean, low, high = (result.metrics.get(key + end) for end in ("", "_low", "_high"))
        # The metrics are ours minus the variant. The table shows what removing the part changes.
        if mean is None or low is None or high is None:
            return "-"
        return f"{number(-mean, '+')} ({number(-high)} to {number(-low)})"

    pairs = {p: result.metrics.get(f"difference_benchmarks.without:{p}_success_pairs") for p in COST_TERMS}
    rows = [
        [label, *(change(part, name) for name in _EFFECTS), f"{pairs[part]:.0f}"]
        for part, label in COST_TERMS.items()
        if pairs[part] is not None
    ]
    seed = result.config.get("condition_seed", 0)
    return (
        "## Parts of the pushing controller\n\n"
        "Change of pushing to a pose when one part is removed, with 95 % intervals, on development seeds "
        f"(`shmoo experiment pushing --condition-seed {seed} --policies ours benchmarks.without:NAME`)."
        f"{'' if result.versions else f' {SNAPSHOT}'}\n\n"
    ) + markdown_table(("removed", *_EFFECTS.values(), "n"), rows)


EXPERIMENT = Experiment(
    Section(
        "Ablations",
        "What does each choice in the learning of psi bring?",
        (ablations_table, _further_table),
        _shows,
    ),
    AblationsConfig(),
    quick=AblationsConfig(
        **trainings.QUICK,
        variants=("default", "functions_3", "no_adversary"),
        budget=Budget(2, 100, 2),
        probes=1,
        probe_updates=300,
    ),
    prepare=trainings.prepare,
    trials=_trials,
    trial=_trained,
    metrics=lambda setup, rows: _metrics(rows, setup.config),
    neutral=("seeds", "variants"),
)
