"""Experiment `ablations`: what each choice in learning psi brings, one changed at a time, and how much psi gives away.

Trainings of psi as long as the shipped one, a few seeds each, scored on unseen objects by the protocol of `scoring`.
"""

from __future__ import annotations

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
from shmoo_mjx.evaluation.tables import Section, cell, over_seeds_cell
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
_MEASURES = {"mse": "MSE", "fvu": "FVU", "fvu_median": "FVU, median object", **AFTER_3S, "probe_psi": "probe on psi"}
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


def ablations_table(result: ExperimentResult) -> str:
    """One line per variant: error on unseen objects, and how well a fresh probe tells the condition from psi."""
    metrics = result.metrics
    names = [key.removeprefix("mse_") for key in metrics if key.startswith("mse_") and not key.startswith("mse_std_")]
    rows = [[name, *(over_seeds_cell(metrics, measure, name) for measure in _MEASURES)] for name in names]
    inputs, without_size, chance = (
        cell(metrics, name) for name in ("probe_inputs", "probe_inputs_without_size", "chance")
    )
    probes = f"The same probe on the raw inputs: {inputs}; without the size: {without_size}; chance: {chance}."
    return "\n\n".join([markdown_table(("variant", *_MEASURES.values()), rows), probes, trainings.size_of(result)])


EXPERIMENT = Experiment(
    Section(
        "One choice at a time",
        "Trainings that differ in one choice; a fresh probe measures how well the condition can be read from psi.",
        table=ablations_table,
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
