"""Experiment real_pushing: the learner of psi on real pushes that other people's robots recorded.

A condition (a shape-surface pair, or a support) is left out of the meta-training; the coefficients are fitted on 20 %
of its pushes, drawn at random, and the other pushes are predicted. Published models are scored on exactly those rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.data import real_pushes
from shmoo_mjx.data.real_pushes import Condition
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation import push_learning, push_physics
from shmoo_mjx.evaluation.push_learning import Prepared
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.fingerprints import fingerprint
from shmoo_mjx.learning.daiml import DaimlConfig
from shmoo_mjx.types import Array

__all__ = ["QUICK", "RealPushing", "errors", "linear", "measure", "run"]

PREFIXES = {"mit_push-pair_out": "", "mit_push-shape_out": "shape_out_", "mlab_triangle-pair_out": "mlab_"}
"""Of the metrics, by trial. Pair out: the other recordings of the same shape are known. Shape out: they are not."""
_NAMES = {"ours": "", "poly4": "published_", "quadratic": "published_quadratic_"}


@dataclass(frozen=True)
class RealPushing:
    """What is tried."""

    seeds: int = 3
    """Each draws the pushes to adapt on and the initial weights anew."""
    share: float = 0.2
    """Of a condition's pushes that the coefficients are fitted on, as the published models were."""
    members: int = 3
    """psi's whose predictions are averaged; each stops on other validation conditions."""
    daiml: DaimlConfig = field(
        default_factory=lambda: DaimlConfig(
            # Few conditions and noisy labels: a small psi, few coefficients, slow steps.
            object=ObjectConfig(hidden=(32, 32), functions=3, linear_terms=False, body=False),
            horizon=1,
            conditions=8,
            adapt_rows=80,
            windows=32,
            label_floor=0.3,
            spectral_cap=1.0,
            alpha=0.0,
            learning_rate=3e-4,
            chunks=12,
            chunk_updates=50,
            patience=4,
            fit_rows=60,
        )
    )
    naive: DaimlConfig = field(
        default_factory=lambda: DaimlConfig(
            object=ObjectConfig(functions=20, body=False),
            horizon=1,
            adapt_rows=80,
            windows=32,
            chunks=20,
            chunk_updates=50,
            patience=6,
            fit_rows=60,
        )
    )
    """Of the same learner on the pusher's start, end and travel alone, without outline or physics."""
    workers: int = 2


QUICK = RealPushing(
    seeds=1,
    members=1,
    daiml=replace(RealPushing().daiml, chunks=4),
    naive=replace(RealPushing().naive, chunks=4),
)


def run(options: ExperimentOptions) -> ExperimentResult:
    """Run the experiment; the figure goes to ``options.out / real_pushing``.

    Raises:
        ShmooError: no --data, or no data set of a known layout in it.
    """
    from shmoo_mjx.evaluation.real_pushing_figure import draw_figure

    if options.data is None:
        raise ShmooError("real_pushing needs --data: give the folder that holds mit_push or mlab_triangle.")
    cfg = QUICK if options.quick else RealPushing()
    data = real_pushes.load(options.data)
    folder = options.out / "real_pushing"
    settings = asdict(replace(cfg, seeds=0)) | {"condition_seed": options.condition_seed}
    pushes = sorted(options.data.glob("m*/pushes*.csv"))
    store = folder / f"trials-{fingerprint(__name__, settings, *pushes)}"
    trials = [trial for trial in PREFIXES if trial.partition("-")[0] in data]
    seeds = range(options.seed, options.seed + cfg.seeds)
    named = {f"{trial}-{seed}": (trial, seed) for trial in trials for seed in seeds}
    rows = run_trials(
        named, partial(_trial, cfg, options.data, options.condition_seed), store, options.progress, cfg.workers
    )
    draw_figure(folder / "real_pushing.png", rows)
    return make_result("real_pushing", options, cfg, measure(rows), {}, rows)


def measure(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Mean over the conditions of the mean error; then mean and standard deviation over the seeds."""
    metrics: dict[str, float] = {}
    for trial, prefix in PREFIXES.items():
        own = [row for row in rows if row["trial"] == trial]
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


def linear(condition: Condition, known: Array) -> np.ndarray:
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


def _trial(cfg: RealPushing, directory: Path, condition_seed: int, trial: tuple[str, int]) -> list[dict[str, Any]]:
    """Every condition left out once: one row each."""
    name, seed = trial
    data_set, _, protocol = name.partition("-")
    data = real_pushes.load(directory)[data_set]
    learned: dict[tuple[str, ...], Any] = {}
    rows = []
    for i, (left_out, condition) in enumerate(data.items()):
        train = [
            n for n, c in data.items() if n != left_out and not (protocol == "shape_out" and c.shape == condition.shape)
        ]
        order = np.random.default_rng([condition_seed, seed, i]).permutation(len(condition.start))
        count = round(cfg.share * len(order))
        known, scored = order[:count], order[count:]
        predicted = _predictions(cfg, directory, data_set, left_out, train, known, seed, learned)
        row: dict[str, Any] = {"trial": name, "seed": seed, "condition": left_out}
        row |= {"adapted_on": len(known), "scored": len(scored), "trained_on": train}
        row["outline_from"] = [left_out, *_same_shape(data, train, condition)]
        for predictor, motion in predicted.items():
            row[f"{predictor}_pos_error_mm"], row[f"{predictor}_angle_error_deg"] = errors(
                motion[scored], condition.motion[scored]
            )
        rows.append(row)
    return rows


def _predictions(
    cfg: RealPushing,
    directory: Path,
    data_set: str,
    left_out: str,
    train: list[str],
    known: Array,
    seed: int,
    learned: dict[tuple[str, ...], Any],
) -> dict[str, Array]:
    """Motions ``[N, 3]`` of all pushes by every predictor; of the condition's outcomes only ``known`` are looked at."""
    data, others = real_pushes.load(directory)[data_set], _training_side(directory, data_set)
    condition = data[left_out]
    known = known[push_learning.credible(condition)[known]]
    same = [data[n] for n in _same_shape(data, train, condition)]
    prepared = push_learning.prepare(condition, known, same, _prior([others[n] for n in train]))
    naive = push_learning.naive(condition)
    if tuple(train) not in learned:
        usable = {n: np.flatnonzero(push_learning.credible(data[n])) for n in train}
        learned[tuple(train)] = (
            _fits(cfg.daiml, cfg.members, seed, {n: (others[n], usable[n]) for n in train}),
            _fits(cfg.naive, 1, seed, {n: (push_learning.naive(data[n]), usable[n]) for n in train}),
        )
    fits, naive_fits = learned[tuple(train)]
    return {
        "ours": np.mean([push_learning.adapted(f, prepared, known) for f in fits], axis=0),
        **condition.published,
        "physics": prepared.base,
        "naive": push_learning.adapted(naive_fits[0], naive, known),
        "linear": linear(condition, known),
        "no_motion": np.zeros_like(condition.motion),
    }


def _fits(config: DaimlConfig, members: int, seed: int, train: Mapping[str, tuple[Prepared, Array]]) -> list[Any]:
    found = []
    for member in range(members):
        config = replace(config, seed=1000 * seed + member)
        shuffled = np.random.default_rng(config.seed).permutation(list(train))
        validation = [str(n) for n in shuffled[: max(1, len(train) // 4)]]
        found.append(push_learning.trained(train, validation, config))
    return found


@cache
def _training_side(directory: Path, data_set: str) -> dict[str, Prepared]:
    """Each condition as meta-training sees it, from all of its own pushes and no other's."""
    data = real_pushes.load(directory)[data_set]
    return {n: push_learning.prepare(c, np.flatnonzero(push_learning.credible(c))) for n, c in data.items()}


def _same_shape(data: Mapping[str, Condition], train: list[str], condition: Condition) -> list[str]:
    return [n for n in train if data[n].shape == condition.shape]


def _prior(train: list[Prepared]) -> tuple[np.ndarray, np.ndarray]:
    """What the training conditions' parameters say about the next one's."""
    parameters = np.stack([p.parameters for p in train])
    # A few conditions show less than the true spread.
    spread = np.sqrt(parameters.var(axis=0, ddof=1) + (0.2 * push_physics.SPREAD) ** 2)
    return parameters.mean(axis=0), spread
