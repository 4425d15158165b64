"""Experiment ``pushing`` (Sec. VI-A, Fig. 7, spec 7.3): objects pushed to three goals.

Two strata of trials: objects as drawn, three families, three goals, ten runs each; and objects that ask for adaptation,
seven runs each. Every method runs every trial. Each finished trial is a file, so that an interrupted experiment goes on
where it stopped.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from shmoo_mjx import own
from shmoo_mjx.assets import WEIGHTS, asset
from shmoo_mjx.evaluation.pushing_measures import metrics_of
from shmoo_mjx.evaluation.pushing_trials import METHODS, OWN, STRATA, Runner, Trial, draw_trials, save_trial
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result
from shmoo_mjx.fingerprints import fingerprint
from shmoo_mjx.processes import process_pool
from shmoo_mjx.sensing import senses_named

__all__ = ["PAPER", "PushingConfig", "run"]

PAPER = {"offset_goal1_m": 0.067, "offset_goal2_m": 0.124, "offset_goal3_m": 0.164}
"""Sec. VI-A: mean final distance from the goal. The circles of Fig. 7 are printed as a picture only."""


@dataclass(frozen=True)
class PushingConfig:
    """Size of the experiment."""

    runs: int = 10
    """Runs per family and goal, objects as drawn."""
    demanding_runs: int = 7
    """Runs per family and goal, objects that ask for adaptation."""
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
    return PushingConfig(runs=1, demanding_runs=1, goals=(1, 2), videos=False) if quick else PushingConfig()


def run(options: ExperimentOptions) -> ExperimentResult:
    """Run what is not done yet and put the results together."""
    config = replace(config_for(options.quick), methods=options.chosen(METHODS, others=True))
    weights = Path(options.weights or asset(WEIGHTS))
    runs = dict(zip(STRATA, (config.runs, config.demanding_runs), strict=True))
    trials = [t for s in STRATA for t in draw_trials(options.first_unseen, options.seed, runs[s], config.goals, s)]
    folder = options.out / "pushing" / _fingerprint(options, config, weights)
    folder.mkdir(parents=True, exist_ok=True)
    # Ours first, then the method that says most beside it: what an experiment that is stopped has run can be compared.
    kept = {m: own.kept_as(OWN, m, METHODS) for m in config.methods}
    wanted = [(t, m) for m in config.methods for t in trials]
    todo = [(t, m) for t, m in wanted if not (folder / f"{kept[m]}-{t.name}.json").exists()]
    total = len(wanted)
    needs_paper_form = any(m == "paper_form" for _, m in todo)
    paper_form = _paper_form(options, weights, folder) if needs_paper_form else None
    job = _Job(weights, paper_form, config, folder, options.senses, kept)
    for done, name in enumerate(_run_all(todo, job), total - len(todo) + 1):
        options.progress(f"pushing: {name}", 0.95 * done / total)
    rows = [json.loads((folder / f"{kept[m]}-{t.name}.json").read_text()) for t, m in wanted]
    from shmoo_mjx.evaluation.pushing_figure import draw_figure, film

    draw_figure(options.out / "pushing" / "pushing.png", rows, folder)
    if config.videos:
        for family in dict.fromkeys(t.family for t in trials):
            options.progress(f"film of a {family}", 0.97)
            first = next(t for t in trials if t.family == family and t.goal == 2 and t.stratum == STRATA[0])
            film(options.out / "pushing" / f"pushing-{family}.mp4", first, folder, senses_named(options.senses))
    options.progress("done", 1.0)
    return make_result("pushing", options, config, metrics_of(rows), PAPER, rows)


def _fingerprint(options: ExperimentOptions, config: PushingConfig, weights: Path) -> str:
    """Folder of the trials: other seeds, settings or weights must not be mixed up with these."""
    from shmoo_mjx.control.pushing import PushConfig
    from shmoo_mjx.navigation.push_task import PushTaskConfig, pose_push_config

    settings: tuple[Any, ...] = (asdict(PushTaskConfig()), asdict(pose_push_config()), asdict(PushConfig()))
    asked = (options.seed, options.condition_seed, config.time_limit, settings, senses_named(options.senses))
    return f"trials-{fingerprint(__name__, asked, weights)}"


def _paper_form(options: ExperimentOptions, weights: Path, folder: Path) -> Path:
    """The same weights with psi as the paper prints it, trained on our data; kept beside the trials."""
    from shmoo_mjx.dynamics.object_model import ObjectConfig
    from shmoo_mjx.evaluation.datasets import training_directory
    from shmoo_mjx.learning import daiml
    from shmoo_mjx.learning.weights import load_weights, save_weights, with_object

    path = folder / "paper_form.safetensors"
    if not path.exists():
        data = training_directory(options)
        settings = daiml.DaimlConfig(object=ObjectConfig.paper(), seed=options.seed)
        settings = replace(settings, chunks=3) if options.quick else settings
        options.progress("training psi as the paper prints it", 0.0)
        fitted = daiml.train_object(data, folder / "paper_form.training" / "object", settings)
        save_weights(path, with_object(load_weights(weights), fitted))
    return path


@dataclass(frozen=True)
class _Job:
    """What the trials of an experiment have in common."""

    weights: Path
    paper_form: Path | None
    config: PushingConfig
    folder: Path
    senses: str
    kept: dict[str, str]
    """By what name each method's trials are kept."""


_RUNNER: dict[tuple[Path, str], Runner] = {}
"""A worker's own runner, made once per process: compiling its controllers takes longer than a trial."""


def _worker() -> None:
    """Before a worker's first computation: the trials run side by side, so that each keeps to one core."""
    import jax

    jax.config.update("jax_num_cpu_devices", 1)
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false".strip()


def _one(trial: Trial, method: str, job: _Job) -> str:
    from shmoo_mjx.learning.weights import load_weights

    key = (job.weights, job.senses)
    if key not in _RUNNER:
        paper_form = None if job.paper_form is None else load_weights(job.paper_form)
        _RUNNER[key] = Runner(load_weights(job.weights), job.config.time_limit, senses_named(job.senses), paper_form)
    row, track = _RUNNER[key].run(trial, method)
    save_trial(job.folder, f"{job.kept[method]}-{trial.name}", row, track)
    return f"{method} {trial.name}"


def _run_all(todo: list[tuple[Trial, str]], job: _Job) -> Iterator[str]:
    """Runs the trials in processes; yields the name of each as it is done."""
    if not todo:
        return
    workers = min(job.config.workers, len(todo))
    with process_pool(workers, _worker) as pool:
        futures = [pool.submit(_one, trial, method, job) for trial, method in todo]
        for future in as_completed(futures):
            yield future.result()
