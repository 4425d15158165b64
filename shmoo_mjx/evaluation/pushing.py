"""Experiment ``pushing`` (Sec. VI-A, Fig. 7, spec 7.3): objects pushed to three goals.

Three families, three goals, ten runs each; the object changes half-way. Every trial is also run with the coefficients
frozen at the prior, with a quasi-static pusher, and with coefficients fitted in hindsight. Each finished trial is a
file, so that an interrupted experiment goes on where it stopped.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.assets import asset
from shmoo_mjx.evaluation.pushing_trials import METHODS, Runner, Trial, draw_trials, save_trial
from shmoo_mjx.evaluation.result import Ask, ExperimentResult, make_result
from shmoo_mjx.fingerprints import fingerprint
from shmoo_mjx.processes import process_pool
from shmoo_mjx.sensing import senses_named

__all__ = ["PAPER", "PushingConfig", "enclosing_circle", "metrics_of", "run"]

PAPER = {"offset_goal1_m": 0.067, "offset_goal2_m": 0.124, "offset_goal3_m": 0.164}
"""Sec. VI-A: mean final distance from the goal. The circles of Fig. 7 are printed as a picture only."""

OURS = "ours"
_WEIGHTS = "experiments/weights/demo.safetensors"


@dataclass(frozen=True)
class PushingConfig:
    """Size of the experiment."""

    runs: int = 10
    """Runs per family and goal."""
    baseline_runs: int = 2
    """The first so many of them are run with the other methods too."""
    goals: tuple[int, ...] = (1, 2, 3)
    methods: tuple[str, ...] = METHODS
    time_limit: float = 120.0
    """Longest trial [s]."""
    workers: int = 2
    """Processes."""
    videos: bool = True
    """One film per family."""


def config_for(quick: bool) -> PushingConfig:
    """The full experiment, or a short form: two trials per family."""
    return PushingConfig(runs=1, goals=(1, 2), videos=False) if quick else PushingConfig()


def run(ask: Ask) -> ExperimentResult:
    """Run what is not done yet and put the results together."""
    config = config_for(ask.quick)
    weights = Path(ask.weights or asset(_WEIGHTS))
    trials = draw_trials(ask.first_unseen, ask.seed, config.runs, config.goals)
    folder = ask.out / "pushing" / _fingerprint(ask, config, weights)
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [(t, m) for m in config.methods for t in trials if m == OURS or t.run < config.baseline_runs]
    todo = [(t, m) for t, m in wanted if not (folder / f"{m}-{t.name}.json").exists()]
    total = len(wanted)
    for done, name in enumerate(_run_all(todo, weights, config, folder, ask.senses), total - len(todo) + 1):
        ask.progress(f"pushing: {name}", 0.95 * done / total)
    rows = [json.loads((folder / f"{m}-{t.name}.json").read_text()) for t, m in wanted]
    from shmoo_mjx.evaluation.pushing_figure import draw_figure, film

    draw_figure(ask.out / "pushing" / "pushing.png", rows, folder)
    if config.videos:
        for family in dict.fromkeys(t.family for t in trials):
            ask.progress(f"film of a {family}", 0.97)
            first = next(t for t in trials if t.family == family and t.goal == 2)
            film(ask.out / "pushing" / f"pushing-{family}.mp4", first, folder, senses_named(ask.senses))
    ask.progress("done", 1.0)
    return make_result("pushing", ask, config, metrics_of(rows), PAPER, rows)


def metrics_of(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Flat metrics: ours by their names, the other methods as ``baseline_<name>_*``.

    ``baseline_<name>_ours_*`` is what ours did on the trials of that method.
    """
    metrics: dict[str, Any] = {}
    for method in dict.fromkeys(row["method"] for row in rows):
        mine = [row for row in rows if row["method"] == method]
        prefix = "" if method == OURS else f"baseline_{method}_"
        metrics |= {prefix + name: value for name, value in _scores(mine).items()}
        if method != OURS:
            same = {row["trial"] for row in mine}
            paired = _scores([row for row in rows if row["method"] == OURS and row["trial"] in same])
            metrics |= {f"{prefix}ours_{name}": paired[name] for name in ("success_rate", "offset_m", "falls")}
    return metrics


def _scores(rows: list[dict[str, Any]]) -> dict[str, Any]:
    scores: dict[str, Any] = {}
    for goal in sorted({row["goal"] for row in rows}):
        there = [row for row in rows if row["goal"] == goal]
        offsets = np.array([row["offset_m"] for row in there])
        scores[f"offset_goal{goal}_m"] = float(offsets.mean())
        scores[f"offset_goal{goal}_std_m"] = float(offsets.std())
        scores[f"circle_goal{goal}_m"] = float(offsets.max())
        finals = np.array([[row["final_x"], row["final_y"]] for row in there])
        scores[f"radius_goal{goal}_m"] = enclosing_circle(finals)[1]
    for family in dict.fromkeys(row["family"] for row in rows):
        mine = [row for row in rows if row["family"] == family]
        scores[f"success_rate_{family}"] = float(np.mean([row["success"] for row in mine]))
        scores[f"offset_{family}_m"] = float(np.mean([row["offset_m"] for row in mine]))
    scores["success_rate"] = float(np.mean([row["success"] for row in rows]))
    scores["offset_m"] = float(np.mean([row["offset_m"] for row in rows]))
    scores["offset_median_m"] = float(np.median([row["offset_m"] for row in rows]))
    scores["yaw_error_deg"] = float(np.mean([row["yaw_error_deg"] for row in rows]))
    scores["falls"] = int(sum(row["fell"] for row in rows))
    scores["worst_lean_rad"] = max(row["worst_lean_rad"] for row in rows)
    scores["least_arm_margin_rad"] = min(row["arm_margin_rad"] for row in rows)
    scores["time_s"] = float(np.mean([row["time_s"] for row in rows]))
    scores["pushes"] = float(np.mean([row["pushes"] for row in rows]))
    scores["trials"] = len(rows)
    return scores


def enclosing_circle(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre ``[2]`` and radius [m] of the smallest circle round ``points [N, 2]``."""
    import shapely

    points = np.asarray(points, dtype=float)
    if not np.ptp(points, axis=0).any():
        return points[0], 0.0
    cloud = shapely.MultiPoint(points)
    centre = shapely.minimum_bounding_circle(cloud).centroid
    return np.array([centre.x, centre.y]), float(shapely.minimum_bounding_radius(cloud))


def _fingerprint(ask: Ask, config: PushingConfig, weights: Path) -> str:
    """Folder of the trials: other seeds, settings or weights must not be mixed up with these."""
    from shmoo_mjx.control.pushing import PushConfig
    from shmoo_mjx.navigation.push_task import PushTaskConfig, pose_push_config

    settings: tuple[Any, ...] = (asdict(PushTaskConfig()), asdict(pose_push_config()), asdict(PushConfig()))
    asked = (ask.seed, ask.condition_seed, config.time_limit, settings, senses_named(ask.senses))
    return f"trials-{fingerprint(__name__, asked, weights)}"


_RUNNER: dict[tuple[Path, str], Runner] = {}
"""A worker's own runner, made once per process: compiling its controllers takes longer than a trial."""


def _worker() -> None:
    """Before a worker's first computation: the trials run side by side, so that each keeps to one core."""
    import jax

    jax.config.update("jax_num_cpu_devices", 1)
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false".strip()


def _one(trial: Trial, method: str, weights: Path, config: PushingConfig, folder: Path, senses: str) -> str:
    from shmoo_mjx.learning.weights import load_weights

    key = (weights, senses)
    if key not in _RUNNER:
        _RUNNER[key] = Runner(load_weights(weights), config.time_limit, senses_named(senses))
    row, track = _RUNNER[key].run(trial, method)
    save_trial(folder, row, track)
    return f"{method} {trial.name}"


def _run_all(
    todo: list[tuple[Trial, str]], weights: Path, config: PushingConfig, folder: Path, senses: str
) -> Iterator[str]:
    """Runs the trials in processes; yields the name of each as it is done."""
    if not todo:
        return
    workers = min(config.workers, len(todo))
    with process_pool(workers, _worker) as pool:
        jobs = [pool.submit(_one, trial, method, weights, config, folder, senses) for trial, method in todo]
        for job in as_completed(jobs):
            yield job.result()
