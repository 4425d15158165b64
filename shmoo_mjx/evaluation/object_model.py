"""Experiment `object_model`: what psi and 25 s of an unseen object are worth (Sec. V-A, Fig. 4).

psi is trained with several seeds, adapts to each unseen object on its first 25 s, and is scored on later rows, beside
the prior (the same psi, object not yet touched) and a constant twist. With the first psi, the online estimate is run
sample by sample: how much of the way from the prior to the adapted psi it covers after how much contact, and how long
it takes to notice a brake.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.data import store
from shmoo_mjx.evaluation import datasets, scoring
from shmoo_mjx.evaluation.baselines import METHODS, Budget, Job, Recordings, first_samples, recordings
from shmoo_mjx.evaluation.baselines.adaptive import from_fit, prior_of, trained
from shmoo_mjx.evaluation.baselines.protocol import Context, Predictor, output_scale
from shmoo_mjx.evaluation.object_model_figures import draw_curve, draw_roll_outs
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result, spread
from shmoo_mjx.evaluation.trainings import QUICK, Trainings, TrainingsConfig, prepare, rows_of
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.learning import estimate
from shmoo_mjx.learning.daiml import DaimlConfig, ObjectFit
from shmoo_mjx.learning.estimate import EstimateConfig
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.types import DT

PAPER = {"mse_before": 1.3131, "mse_after": 0.4271, "ratio_after_before": 0.325}
"""Sec. V-A."""

SECONDS = (0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0)
"""Of contact, at which the adaptation is looked at [s]."""


@dataclass(frozen=True)
class ObjectModelConfig(TrainingsConfig):
    """What is trained and measured."""

    budget: Budget = field(default_factory=lambda: Budget(DaimlConfig().epochs, 150, DaimlConfig().patience))
    """Of each training: that of the shipped psi."""
    fit_seconds: float = 25.0
    """Recording that psi adapts on [s]."""
    estimate: EstimateConfig = EstimateConfig()
    """Of the contact parameters, online."""


def run(options: ExperimentOptions, config: ObjectModelConfig | None = None) -> ExperimentResult:
    """Train, adapt and score; goes on from ``options.out`` after a stop."""
    config = config or (ObjectModelConfig(**QUICK, budget=Budget(3, 100, 3)) if options.quick else ObjectModelConfig())
    shared = prepare(__name__, "object_model", options, config, {"seeds": 1})
    trials = {f"psi-{i}": ("psi", i) for i in range(config.seeds)}
    trials["constant_velocity"] = ("constant_velocity", 0)
    rows = run_trials(trials, partial(_scored, shared, config), shared.folder, options.progress, config.workers)
    metrics = _metrics(rows)
    options.progress("online adaptation", 0.95)
    job = _job(shared, config, 0)
    fitted, daiml_settings = trained(job, DaimlConfig())
    objects, scale = shared.objects(), output_scale(job.train.samples)
    shares = gap_closed(fitted, daiml_settings, config.estimate, recordings(objects), scale)
    metrics |= _curve_metrics(shares) | _brake_metrics(options, config, fitted, daiml_settings, scale)
    curve = [
        {"curve": "gap_closed", "condition": condition, "contact_s": s, "share": shares[i, k]}
        for i, condition in enumerate(objects.names)
        for k, s in enumerate(SECONDS)
    ]
    out = options.out / "object_model"
    draw_curve(SECONDS, shares, out / "adaptation.png")
    draw_roll_outs(from_fit(fitted, daiml_settings), prior_of(fitted, daiml_settings), objects, out / "roll_outs.png")
    return make_result("object_model", options, config, metrics, PAPER, [*rows, *curve])


def _job(shared: Trainings, config: ObjectModelConfig, number: int) -> Job:
    return shared.job(f"psi-{number}", number, config.budget, round(config.fit_seconds / DT))


def _scored(shared: Trainings, config: ObjectModelConfig, trial: tuple[str, int]) -> list[dict[str, Any]]:
    """The scores of one training of psi, or of a method that needs none."""
    method, number = trial
    job, objects = _job(shared, config, number), shared.objects()
    predictors: dict[str, Predictor]
    if method == "psi":
        fitted = trained(job, DaimlConfig())
        predictors = {"after": from_fit(*fitted), "before": prior_of(*fitted)}
    else:
        predictors = {method: METHODS[method].fit(job)}
    rows: list[dict[str, Any]] = []
    for label, predictor in predictors.items():
        found = scoring.score(predictor, recordings(objects), output_scale(job.train.samples), job.fit_samples)
        rows += rows_of(objects, found, {"predictor": label, "run": number})
    return rows


def gap_closed(
    fitted: ObjectFit, config: DaimlConfig, online: EstimateConfig, recorded: Recordings, scale: np.ndarray
) -> np.ndarray:
    """Share of the way from the prior's error to that of the adapted psi that the online estimate has covered after
    SECONDS of contact.

    Errors are on the rows after those that psi adapts on. The estimate starts at the prior and sees only rows that
    count, in the order of the recording.

    Returns:
        ``[C, len(SECONDS)]``; NaN where the recording has less contact, or the adapted psi is no better than the prior.
    """
    after, before = from_fit(fitted, config), prior_of(fitted, config)
    marks = np.round(np.array(SECONDS) / DT).astype(int)
    shares = np.full((len(recorded.samples.inputs), len(SECONDS)), np.nan)
    error_of, learn = _error_of(after, scale), _online(fitted, online)
    for i in range(len(shares)):
        known = jax.tree.map(jnp.asarray, first_samples(recorded, i, config.fit_samples))
        later = _later(recorded, i, config.fit_samples)
        prior, best = (float(error_of(a, later)) for a in (before.adapt(known), after.adapt(known)))
        if best < prior:
            learned = learn(known)
            for k, mark in enumerate(marks[marks <= np.sum(known.weights > 0)]):
                error = float(error_of(_after(learned, known.weights, mark), later))
                shares[i, k] = (prior - error) / (prior - best)
    return shares


def _error_of(predictor: Predictor, scale: np.ndarray) -> Callable[[Any, Recordings], Any]:
    """(coefficients, some rows of one condition) -> fraction of variance unexplained; compiled once for all."""

    @jax.jit
    def error(a: Any, recorded: Recordings) -> Any:
        rows = recorded.samples
        weight = rows.weights[:, None]
        mean = jnp.sum(weight * rows.labels, axis=0) / jnp.maximum(jnp.sum(weight), 1.0)
        variance = jnp.sum(weight * ((rows.labels - mean) / scale) ** 2)
        left = (rows.labels - predictor.predict(a, rows.inputs, recorded.time)) / scale
        return jnp.sum(weight * left**2) / variance

    return error


def _online(fitted: ObjectFit, online: EstimateConfig) -> Callable[[Context], Any]:
    """Rows of one condition -> coefficients ``[N, m, K]`` and contact parameters ``[N, p]`` after each of them; rows
    that do not count teach nothing. Compiled once for all conditions."""
    start, coefficients = estimate.init(online, fitted.contact_prior), jnp.asarray(fitted.prior_mean)

    def one(state: Any, row: Any) -> tuple[Any, Any]:
        x, y, counts = row
        state = estimate.learn(online, state, x, y, fitted.params.label_scale, counts)
        return state, (coefficients, estimate.mean(state))

    return jax.jit(lambda known: jax.lax.scan(one, start, (known.inputs, known.labels, known.weights > 0))[1])


def _after(learned: Any, weights: Any, count: int) -> Any:
    """What was ``learned`` from ``count`` rows that count."""
    row = np.flatnonzero(weights > 0)[count - 1]
    return jax.tree.map(lambda values: values[row], learned)


def _later(recorded: Recordings, index: int, fit_samples: int) -> Recordings:
    """The rows of one condition that nothing is fitted on."""
    return jax.tree.map(lambda values: jnp.asarray(values[index, fit_samples:]), recorded)


def _metrics(rows: list[dict[str, Any]]) -> dict[str, float]:
    def of(predictor: str, measure: str, family: str | None = None, over_objects: Any = np.nanmean) -> list[float]:
        """Mean, or ``over_objects``, for each training."""
        mine = [r for r in rows if r["predictor"] == predictor and family in (None, r["family"])]
        runs = sorted({r["run"] for r in mine})
        return [float(over_objects([r[measure] for r in mine if r["run"] == k])) for k in runs]

    found: dict[str, float] = {}
    for predictor in ("before", "after", "constant_velocity"):
        for measure in ("mse", "mse_x", "mse_y", "mse_yaw", "fvu"):
            values = of(predictor, measure)
            found[f"{measure}_{predictor}"] = float(np.mean(values))
            if len(values) > 1 and measure in ("mse", "fvu"):
                found[f"{measure}_{predictor}_std"] = float(np.std(values))
        found[f"fvu_median_{predictor}"] = float(np.mean(of(predictor, "fvu", over_objects=np.nanmedian)))
        suffix = "" if predictor == "after" else f"_{predictor}"
        for name in scoring.NAMES:
            if "rmse" in name:
                found[f"{name}{suffix}"] = float(np.mean(of(predictor, name)))
    for family in dict.fromkeys(r["family"] for r in rows):
        for predictor in ("before", "after"):
            medians = of(predictor, "fvu", family, np.nanmedian)
            found[f"fvu_median_{predictor}_{family}"] = float(np.mean(medians))
    return found | {"ratio_after_before": found["mse_after"] / found["mse_before"]}


def _curve_metrics(shares: np.ndarray) -> dict[str, float]:
    found: dict[str, float] = {}
    for k, seconds in enumerate(SECONDS):
        values = spread(shares[:, k])
        found |= {f"gap_closed_{seconds:g}s_{name}": values[name] for name in ("median", "q25", "q75")}
    return found


def _brake_metrics(
    options: ExperimentOptions, config: ObjectModelConfig, fitted: ObjectFit, settings: DaimlConfig, scale: np.ndarray
) -> dict[str, float]:
    """What a brake that is put on costs: error on the braked object when it is not yet felt, and when it is known.

    And seconds of contact until the estimate has covered 60 % of the way between the two, where there is a way to go.
    """
    count = max(config.unseen.get("wheelchair", 0), 1)
    seeds = range(options.first_unseen + 500, options.first_unseen + 500 + count)
    free = {"locked": (False, False, False, False)}
    braked = {"locked": (True, False, False, False)}
    rows = [
        (f"test-{state}-{seed}", "test", draw_condition("wheelchair", seed, properties))
        for state, properties in (("free", free), ("braked", braked))
        for seed in seeds
    ]
    directory = datasets.collect_rows(options, f"brake-{seeds[0]}-{count}", rows)
    recorded = recordings(store.read(directory, splits=("test",)))
    after = from_fit(fitted, settings)
    error_of, learn = _error_of(after, scale), _online(fitted, config.estimate)
    times, unaware, known = [], [], []
    # Names are read in alphabetical order: the braked ones come first.
    for i in range(count):
        new, old = (jax.tree.map(jnp.asarray, first_samples(recorded, k, settings.fit_samples)) for k in (i, i + count))
        both = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), old, new)
        later, learned = _later(recorded, i, settings.fit_samples), learn(both)
        begun, counted = (int(np.sum(rows.weights > 0)) for rows in (old, both))
        wrong, best = (float(error_of(a, later)) for a in (_after(learned, both.weights, begun), after.adapt(new)))
        enough = wrong - 0.6 * (wrong - best)
        marks = [
            k
            for k in range(1, counted - begun, 2)
            if float(error_of(_after(learned, both.weights, begun + k), later)) <= enough
        ]
        times.append(marks[0] * DT if marks and best < wrong else np.nan)
        unaware.append(wrong)
        known.append(best)
    return {
        "brake_fvu_unaware_median": spread(unaware)["median"],
        "brake_fvu_known_median": spread(known)["median"],
        "brake_with_a_way_to_go": float(np.sum(np.asarray(known) < np.asarray(unaware))),
        "brake_readapt_s_median": spread(times)["median"],
        "brake_readapted": float(np.sum(np.isfinite(times))),
    }
