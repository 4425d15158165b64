"""Experiment `object_model`: prediction of unseen objects before and after adaptation (Sec. V-A, Fig. 4).

psi is trained with several seeds. It adapts to each unseen object on the first 25 s and is scored on later rows. The
prior (the same psi before contact) and a constant twist are scored too. With the first psi, the online estimate runs
sample by sample. This shows which share of the gap between prior and adapted psi it closes over time in contact, and
how long it takes to follow a brake.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.data import store
from shmoo_mjx.evaluation import datasets, scoring, trainings
from shmoo_mjx.evaluation.baselines import METHODS, Budget, Job, Recordings, first_samples, recordings
from shmoo_mjx.evaluation.baselines.adaptive import from_fit, prior_of, trained
from shmoo_mjx.evaluation.baselines.protocol import Context, Predictor, output_scale
from shmoo_mjx.evaluation.experiment import Experiment, Prepared, Setup
from shmoo_mjx.evaluation.object_model_figures import draw_curve, draw_roll_outs
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, spread
from shmoo_mjx.evaluation.tables import (
    Line,
    Section,
    SummaryValue,
    Table,
    lines_of,
    measured,
    number,
    percent,
)
from shmoo_mjx.evaluation.trainings import TrainingsConfig, job_of, rows_of, unseen_objects
from shmoo_mjx.learning import estimate
from shmoo_mjx.learning.daiml import DaimlConfig, ObjectFit
from shmoo_mjx.learning.estimate import EstimateConfig
from shmoo_mjx.plant.objects import FAMILIES, draw_condition
from shmoo_mjx.types import DT

SECONDS = (0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0)
"""Times in contact at which the adaptation is scored [s]."""


class _Data(NamedTuple):
    """Data sets of the experiment."""

    train: Path
    unseen: Path
    brakes: Path
    """Wheelchairs with a brake, and the same wheelchairs without."""


@dataclass(frozen=True)
class ObjectModelConfig(TrainingsConfig):
    """Settings of the experiment."""

    budget: Budget = field(default_factory=lambda: Budget(DaimlConfig().epochs, 150, DaimlConfig().patience))
    """Budget of each training, equal to that of the shipped psi."""
    fit_seconds: float = 25.0
    """Length of the recording that psi adapts on [s]."""
    estimate: EstimateConfig = EstimateConfig()
    """Settings of the online estimate of the contact parameters."""


def _prepare(options: ExperimentOptions, config: ObjectModelConfig, folder: Path) -> Prepared:
    """Data sets that all trainings share, and of wheelchairs with and without a brake."""
    shared = trainings.prepare(options, config, folder)
    count = max(config.unseen.get("wheelchair", 0), 1)
    seeds = range(options.first_unseen + 500, options.first_unseen + 500 + count)
    free = {"locked": (False, False, False, False)}
    braked = {"locked": (True, False, False, False)}
    rows = [
        (f"test-{state}-{seed}", "test", draw_condition("wheelchair", seed, properties))
        for state, properties in (("free", free), ("braked", braked))
        for seed in seeds
    ]
    brakes = datasets.collect_rows(options, f"brake-{seeds[0]}-{count}", rows)
    return shared._replace(data=_Data(shared.data.train, shared.data.unseen, brakes))


def _trials(setup: Setup[ObjectModelConfig]) -> dict[str, tuple[str, int]]:
    psi = {f"psi-{i}": ("psi", i) for i in range(setup.config.seeds)}
    return psi | {"constant_velocity": ("constant_velocity", 0)}


def _trial(setup: Setup[ObjectModelConfig], trial: tuple[str, int]) -> list[dict[str, Any]]:
    """Scores of one training of psi or of a method without training, or of psi's online estimate."""
    method, number = trial
    if method == "online":
        return _online_rows(setup)
    job, objects = _job(setup, number), unseen_objects(setup)
    predictors: dict[str, Predictor]
    if method == "psi":
        fitted = trained(job, DaimlConfig())
        predictors = {"after": from_fit(*fitted), "before": prior_of(*fitted)}
    else:
        predictors = {method: METHODS[method].fit(job)}
    rows: list[dict[str, Any]] = []
    for label, predictor in predictors.items():
        scores = scoring.score(predictor, recordings(objects), output_scale(job.train.samples), job.fit_samples)
        rows += rows_of(objects, scores, {"predictor": label, "run": number})
    return rows


def _job(setup: Setup[ObjectModelConfig], number: int) -> Job:
    fit_samples = round(setup.config.fit_seconds / DT)
    return job_of(setup, f"psi-{number}", number, budget=setup.config.budget, fit_samples=fit_samples)


def _online_rows(setup: Setup[ObjectModelConfig]) -> list[dict[str, Any]]:
    """Rows of the first psi's online estimate: share of the gap closed by object and time, and error with a brake."""
    job, objects = _job(setup, 0), unseen_objects(setup)
    (fitted, settings), scale = trained(job, DaimlConfig()), output_scale(job.train.samples)
    shares = gap_closed(fitted, settings, recordings(objects), online=setup.config.estimate, scale=scale)
    curve = [
        {"curve": "gap_closed", "condition": condition, "contact_s": s, "share": shares[i, k]}
        for i, condition in enumerate(objects.names)
        for k, s in enumerate(SECONDS)
    ]
    recorded = recordings(store.read(setup.data.brakes, splits=("test",)))
    return curve + _brake_rows(setup.config, recorded, fitted, settings, scale=scale)


def gap_closed(
    fitted: ObjectFit, config: DaimlConfig, recorded: Recordings, *, online: EstimateConfig, scale: np.ndarray
) -> np.ndarray:
    """Share of the gap between the errors of the prior and of the adapted psi that the online estimate closes.

    Errors are those of the rows after the adaptation. The estimate starts at the prior and sees the rows that count in
    the order of the recording.

    Returns:
        ``[C, len(SECONDS)]``; NaN where the recording has less contact, or the adapted psi is no better than the prior.
    """
    after, before = from_fit(fitted, config), prior_of(fitted, config)
    marks = np.round(np.array(SECONDS) / DT).astype(int)
    shares = np.full((len(recorded.samples.inputs), len(SECONDS)), np.nan)
    error_of, learn = _error_of(after, scale), _online(fitted, online)
    for i in range(len(shares)):
        context = jax.tree.map(jnp.asarray, first_samples(recorded, i, config.fit_samples))
        later = _later(recorded, i, config.fit_samples)
        prior, best = (float(error_of(a, later)) for a in (before.adapt(context), after.adapt(context)))
        if best < prior:
            learned = learn(context)
            for k, mark in enumerate(marks[marks <= np.sum(context.weights > 0)]):
                error = float(error_of(_after(learned, context.weights, mark), later))
                shares[i, k] = (prior - error) / (prior - best)
    return shares


def _error_of(predictor: Predictor, scale: np.ndarray) -> Callable[[Any, Recordings], Any]:
    """A compiled function: (coefficients, rows of one condition) -> fraction of variance unexplained."""

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
    """A compiled function: rows of one condition -> coefficients ``[N, m, K]`` and contact parameters ``[N, p]`` after
    each row. Rows that do not count do not change them."""
    start, coefficients = estimate.init(online, fitted.contact_prior), jnp.asarray(fitted.prior_mean)

    def one(state: Any, row: Any) -> tuple[Any, Any]:
        x, y, counts = row
        state = estimate.learn(online, state, x, y, scale=fitted.params.label_scale, valid=counts)
        return state, (coefficients, estimate.mean(state))

    return jax.jit(lambda rows: jax.lax.scan(one, start, (rows.inputs, rows.labels, rows.weights > 0))[1])


def _after(learned: Any, weights: Any, count: int) -> Any:
    """The estimate after ``count`` rows that count."""
    row = np.flatnonzero(weights > 0)[count - 1]
    return jax.tree.map(lambda values: values[row], learned)


def _later(recorded: Recordings, index: int, fit_samples: int) -> Recordings:
    """The rows of one condition after those for fitting."""
    return jax.tree.map(lambda values: jnp.asarray(values[index, fit_samples:]), recorded)


def _shares(rows: list[dict[str, Any]]) -> np.ndarray:
    """Shares ``[C, len(SECONDS)]`` as `gap_closed` returned them."""
    return np.array([row["share"] for row in rows if "curve" in row]).reshape(-1, len(SECONDS))


def _metrics(rows: list[dict[str, Any]]) -> dict[str, float]:
    shares, brakes = _shares(rows), [row for row in rows if "brake" in row]
    rows = [row for row in rows if "predictor" in row]

    def of(predictor: str, measure: str, family: str | None = None, over_objects: Any = np.nanmean) -> list[float]:
        """Mean, or ``over_objects``, for each training."""
        mine = [r for r in rows if r["predictor"] == predictor and family in (None, r["family"])]
        runs = sorted({r["run"] for r in mine})
        return [float(over_objects([r[measure] for r in mine if r["run"] == k])) for k in runs]

    metrics: dict[str, float] = {}
    for predictor in ("before", "after", "constant_velocity"):
        for measure in ("mse", "mse_x", "mse_y", "mse_yaw", "fvu"):
            values = of(predictor, measure)
            metrics[f"{measure}_{predictor}"] = float(np.mean(values))
            if len(values) > 1 and measure in ("mse", "fvu"):
                metrics[f"{measure}_{predictor}_std"] = float(np.std(values))
        metrics[f"fvu_median_{predictor}"] = float(np.mean(of(predictor, "fvu", over_objects=np.nanmedian)))
        suffix = "" if predictor == "after" else f"_{predictor}"
        for name in scoring.NAMES:
            if "rmse" in name:
                metrics[f"{name}{suffix}"] = float(np.mean(of(predictor, name)))
    for family in dict.fromkeys(r["family"] for r in rows):
        for predictor in ("before", "after"):
            medians = of(predictor, "fvu", family, np.nanmedian)
            metrics[f"fvu_median_{predictor}_{family}"] = float(np.mean(medians))
    metrics["ratio_after_before"] = metrics["mse_after"] / metrics["mse_before"]
    return metrics | _curve_metrics(shares) | _brake_metrics(brakes)


def _curve_metrics(shares: np.ndarray) -> dict[str, float]:
    metrics: dict[str, float] = {}
    for k, seconds in enumerate(SECONDS):
        values = spread(shares[:, k])
        metrics |= {f"gap_closed_{seconds:g}s_{name}": values[name] for name in ("median", "q25", "q75")}
    return metrics


def _brake_rows(
    config: ObjectModelConfig, recorded: Recordings, fitted: ObjectFit, settings: DaimlConfig, *, scale: np.ndarray
) -> list[dict[str, Any]]:
    """Effect of a brake on each wheelchair: error before and after adapting to the brake, and time in contact until the
    estimate has closed 60 % of this gap (NaN if there is no gap)."""
    after = from_fit(fitted, settings)
    error_of, learn = _error_of(after, scale), _online(fitted, config.estimate)
    count, rows = len(recorded.samples.inputs) // 2, []
    # Names are read in alphabetical order: the braked ones come first.
    for i in range(count):
        new, old = (jax.tree.map(jnp.asarray, first_samples(recorded, k, settings.fit_samples)) for k in (i, i + count))
        both = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), old, new)
        later, learned = _later(recorded, i, settings.fit_samples), learn(both)
        begun, counted = (int(np.sum(context.weights > 0)) for context in (old, both))
        wrong, best = (float(error_of(a, later)) for a in (_after(learned, both.weights, begun), after.adapt(new)))
        enough = wrong - 0.6 * (wrong - best)
        marks = [
            k
            for k in range(1, counted - begun, 2)
            if float(error_of(_after(learned, both.weights, begun + k), later)) <= enough
        ]
        readapted = marks[0] * DT if marks and best < wrong else np.nan
        rows.append({"brake": i, "fvu_unaware": wrong, "fvu_known": best, "readapt_s": readapted})
    return rows


def _brake_metrics(rows: list[dict[str, Any]]) -> dict[str, float]:
    unaware, aware, times = (np.array([row[k] for row in rows]) for k in ("fvu_unaware", "fvu_known", "readapt_s"))
    return {
        "brake_fvu_unaware_median": spread(unaware)["median"],
        "brake_fvu_known_median": spread(aware)["median"],
        "brake_with_a_way_to_go": float(np.sum(aware < unaware)),
        "brake_readapt_s_median": spread(times)["median"],
        "brake_readapted": float(np.sum(np.isfinite(times))),
    }


def _draw(setup: Setup[ObjectModelConfig], rows: list[dict[str, Any]]) -> None:
    draw_curve(SECONDS, _shares(rows), setup.folder / "adaptation.png")
    fitted = trained(_job(setup, 0), DaimlConfig())
    draw_roll_outs(from_fit(*fitted), prior_of(*fitted), unseen_objects(setup), setup.folder / "roll_outs.png")


def _summary(result: ExperimentResult) -> SummaryValue:
    paper, unseen = result.paper.get("ratio_after_before"), result.config.get("unseen", {})
    objects = sum(unseen.values()) if isinstance(unseen, dict) else int(unseen)
    return f"{measured(result, 'ratio_after_before'):.2f}", objects, "" if paper is None else f"{paper:.2f}"


def _shows(result: ExperimentResult) -> str:
    ends = ("pos_rmse_3s_m_before", "pos_rmse_3s_m", "yaw_rmse_3s_deg_before", "yaw_rmse_3s_deg")
    before, after, turned, turned_after = (number(measured(result, name)) for name in ends)
    return (
        f"Adapting to an object leaves {percent(measured(result, 'ratio_after_before'))} of the squared error of the "
        f"prediction before contact. Over 3 s, which planning needs, the error falls from {before} to "
        f"{after} m and from {turned} to {turned_after} deg. For the median object, 1 s of "
        f"contact closes {percent(measured(result, 'gap_closed_1s_median'))} of the gap; for the slowest quarter, at "
        f"most {percent(measured(result, 'gap_closed_1s_q25'))}."
    )


_COLUMNS = ("before contact", "after 25 s", "constant velocity")
_ENDS = {
    "pos_rmse_1s_m": "Position error after 1 s [m]",
    "yaw_rmse_1s_deg": "Yaw error after 1 s [deg]",
    "pos_rmse_3s_m": "Position error after 3 s [m]",
    "yaw_rmse_3s_deg": "Yaw error after 3 s [deg]",
}
_ERROR = lines_of({"mse": "Mean squared error of the acceleration"}, "{}_before", "{}_after", "{}_constant_velocity")
_RATIO = Line("Error after as a share of the error before", ("", "ratio_after_before", ""))

EXPERIMENT = Experiment(
    Section(
        "Prediction of unseen objects",
        "How much better does psi predict an unseen object once it has adapted to it? (Sec. V-A, Fig. 4 of the paper)",
        (
            Table(
                _COLUMNS,
                (
                    *_ERROR,
                    _RATIO,
                    *lines_of(
                        {name: _ENDS[name] for name in ("pos_rmse_3s_m", "yaw_rmse_3s_deg")},
                        *("{}_before", "{}", "{}_constant_velocity"),
                    ),
                ),
            ),
            Table(
                _COLUMNS,
                (
                    *lines_of(_ENDS, "{}_before", "{}", "{}_constant_velocity"),
                    *lines_of(
                        {"fvu_median": "Unexplained share of the variance, median object"},
                        *("{}_before", "{}_after", "{}_constant_velocity"),
                    ),
                    *lines_of(
                        {family: f"Unexplained share of the variance, median {family}" for family in FAMILIES},
                        *("fvu_median_before_{}", "fvu_median_after_{}", ""),
                    ),
                ),
            ),
            Table(
                ("value",),
                lines_of(
                    {
                        "gap_closed_1s_median": "Share of the gap closed after 1 s of contact, median object",
                        "gap_closed_1s_q25": "Share of the gap closed after 1 s of contact, lower quartile",
                        "gap_closed_5s_median": "Share of the gap closed after 5 s of contact, median object",
                        "brake_fvu_unaware_median": "Unexplained share of the variance, brake just put on, median",
                        "brake_fvu_known_median": "Unexplained share of the variance, 25 s with the brake, median",
                    }
                ),
            ),
        ),
        _shows,
        {
            "roll_outs.png": "Predicted and recorded motion of eight unseen objects over 3 s, before and after 25 s",
            "adaptation.png": "Share of the gap closed over seconds of contact",
        },
        summary=(("Prediction error after adaptation, as a share of the error before", _summary),),
    ),
    ObjectModelConfig(),
    quick=ObjectModelConfig(**trainings.QUICK, budget=Budget(3, 100, 3)),
    prepare=_prepare,
    trials=_trials,
    further_trials=lambda setup, rows: {"online": ("online", 0)},
    trial=_trial,
    metrics=lambda setup, rows: _metrics(rows),
    draw=_draw,
    neutral=("seeds",),
    paper={"mse_before": 1.3131, "mse_after": 0.4271, "ratio_after_before": 0.325},  # Sec. V-A
)
