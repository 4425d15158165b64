"""Experiment `ablations`: what each choice in learning psi brings, one changed at a time, and how much psi gives away.

Trainings of psi as long as the shipped one, a few seeds each, scored on unseen objects by the protocol of `scoring`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from shmoo_mjx.data import store
from shmoo_mjx.evaluation import probe, scoring, trainings
from shmoo_mjx.evaluation.baselines import Budget, recordings
from shmoo_mjx.evaluation.baselines.adaptive import daiml_config, from_fit
from shmoo_mjx.evaluation.baselines.protocol import output_scale
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result, over_seeds
from shmoo_mjx.evaluation.trainings import Trainings, TrainingsConfig, prepare
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.learning import daiml
from shmoo_mjx.learning.daiml import DaimlConfig
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


QUICK = AblationsConfig(
    **trainings.QUICK,
    variants=("default", "functions_3", "no_adversary"),
    budget=Budget(2, 100, 2),
    probes=1,
    probe_updates=300,
)


def run(options: ExperimentOptions, config: AblationsConfig | None = None) -> ExperimentResult:
    """Train and score every variant; goes on from ``options.out`` after a stop."""
    config = config or (QUICK if options.quick else AblationsConfig())
    shared = prepare(__name__, "ablations", options, config, {"seeds": 1, "variants": ()})
    trials = {f"{variant}-{i}": (variant, i) for variant in config.variants for i in range(config.seeds)}
    trials = {"raw-0": ("raw", 0)} | trials
    rows = run_trials(trials, partial(_trained, shared, config), shared.folder, options.progress, config.workers)
    return make_result("ablations", options, config, _metrics(rows, config), {}, rows)


def _trained(shared: Trainings, config: AblationsConfig, trial: tuple[str, int]) -> list[dict[str, Any]]:
    """One variant with one seed; ``raw`` stands for probes on the inputs themselves."""
    variant, number = trial
    label = {"variant": variant, "run": number}
    fit_samples = round(max(config.fit_seconds) / DT)
    job = shared.job(f"{variant}-{number}", number, config.budget, fit_samples, VARIANTS.get(variant))
    rows = job.train.samples
    if variant == "raw":
        raw = {"inputs": rows.inputs, "inputs_without_size": probe.raw_without_size(rows)}
        found = {f"probe_{what}": _probe(config, values, rows.weights) for what, values in raw.items()}
        return [label | found | {"chance": 1 / len(rows.inputs)}]
    settings = daiml_config(job, DaimlConfig())
    fitted = daiml.fit_samples(rows, job.validation.samples, settings, job.directory)
    predictor, unseen = from_fit(fitted, settings), recordings(shared.objects())
    scale = output_scale(recordings(store.of_training(shared.train).split("train")).samples)
    found_rows = []
    for seconds in config.fit_seconds if variant == "default" else (max(config.fit_seconds),):
        scores = scoring.score(predictor, unseen, scale, round(seconds / DT), fit_samples)
        # The mean hangs on objects that hardly move.
        median = {"fvu_median": float(np.nanmedian(scores["fvu"]))}
        found_rows.append(label | {"fit_seconds": seconds} | scoring.average(scores) | median)
    if variant in PROBED:
        found_rows[-1]["probe_psi"] = _probe(config, probe.psi_of(fitted, settings, rows), rows.weights)
    return found_rows


def _probe(config: AblationsConfig, values: Any, weights: Any) -> float:
    probes = range(config.probes)
    return float(np.mean([probe.accuracy(values, weights, seed, config.probe_updates) for seed in probes]))


def _metrics(rows: list[dict[str, Any]], config: AblationsConfig) -> dict[str, float]:
    """Mean and spread over the seeds; the names of the variants with 5 s and 10 s to adapt end so."""
    metrics: dict[str, float] = {}
    measures = ("mse", "fvu", "fvu_median", "pos_rmse_3s_m", "yaw_rmse_3s_deg", "probe_psi")
    longest = max(config.fit_seconds)
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        seconds = row.get("fit_seconds", longest)
        groups.setdefault(row["variant"] + (f"_{seconds:g}s" if seconds != longest else ""), []).append(row)
    raw = groups.pop("raw")[0]
    for name, mine in groups.items():
        for measure in measures:
            metrics |= over_seeds(measure, name, [row.get(measure, np.nan) for row in mine])
    return metrics | {name: raw[name] for name in ("chance", "probe_inputs", "probe_inputs_without_size")}
