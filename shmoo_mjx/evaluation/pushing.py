"""Experiment ``pushing`` (Sec. VI-A, Fig. 7): objects pushed to three goals.

Three strata of trials, each with three families and three goals: movable objects, ten runs each; objects that ask for
adaptation, seven runs each; and five runs with objects as they are drawn. Every method runs every trial. Each finished
trial is a file, so that an interrupted experiment goes on where it stopped.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from shmoo_mjx.base import custom
from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.evaluation.pushing_figure import draw_figure, film
from shmoo_mjx.evaluation.pushing_measures import PAPER, metrics_of
from shmoo_mjx.evaluation.pushing_trials import EVERYTHING, METHODS, OWN, STRATA, Runner, Trial, draw_trials
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.report.trace import write_arrays
from shmoo_mjx.sensing import senses_named


@dataclass(frozen=True)
class PushingConfig:
    """Size of the experiment."""

    runs: int = 10
    """Runs per family and goal, movable objects."""
    demanding_runs: int = 7
    """Runs per family and goal, objects that ask for adaptation."""
    everything_runs: int = 5
    """Runs per family and goal, objects as they are drawn: locked wheels and heavy ones included."""
    goals: tuple[int, ...] = (1, 2, 3)
    methods: tuple[str, ...] = METHODS
    time_limit: float = 120.0
    """Longest trial [s]."""
    workers: int = 2
    """Processes."""
    videos: bool = True
    """One film per family."""


QUICK = PushingConfig(runs=1, demanding_runs=1, everything_runs=1, goals=(1, 2), videos=False)


def run(options: ExperimentOptions) -> ExperimentResult:
    """Run what is not done yet and put the results together."""
    config = replace(QUICK if options.quick else PushingConfig(), methods=options.chosen(METHODS, others=True))
    weights = Path(options.weights or asset(WEIGHTS))
    runs = dict(zip(STRATA, (config.runs, config.demanding_runs, config.everything_runs), strict=True))
    drawn = [t for s in STRATA for t in draw_trials(options.first_unseen, options.seed, runs[s], config.goals, s)]
    folder = options.out / "pushing" / _fingerprint(options, config, weights)
    # Ours first, then the method that says most beside it: what an experiment that is stopped has run can be compared.
    trials = {_name(m, t): (m, t) for m in config.methods for t in drawn}
    robot = weights, config.time_limit, options.senses
    rows = run_trials(trials, partial(_trial, robot, folder), folder, options.progress, config.workers)
    draw_figure(options.out / "pushing" / "pushing.png", [r for r in rows if r["stratum"] != EVERYTHING], folder)
    if config.videos:
        for family in dict.fromkeys(t.family for t in drawn):
            options.progress(f"film of a {family}", 0.97)
            first = next(t for t in drawn if t.family == family and t.goal == 2 and t.stratum == STRATA[0])
            film(options.out / "pushing" / f"pushing-{family}.mp4", first, folder, senses_named(options.senses))
    options.progress("done", 1.0)
    return make_result("pushing", options, config, metrics_of(rows), PAPER, rows)


def _fingerprint(options: ExperimentOptions, config: PushingConfig, weights: Path) -> str:
    """Folder of the trials: other seeds, settings or weights must not be mixed up with these."""
    from shmoo_mjx.behavior.methods import METHODS
    from shmoo_mjx.behavior.push_task import PushTaskConfig

    settings = asdict(PushTaskConfig()), *(asdict(method) for method in METHODS.values())
    asked = (options.seed, options.condition_seed, config.time_limit, settings, senses_named(options.senses))
    return f"trials-{fingerprint(__name__, asked, weights, asset(METHODS['paper'].weights))}"


@cache
def _runner(weights: Path, time_limit: float, senses: str) -> Runner:
    """A worker's own: compiling its controllers takes longer than a trial."""
    from shmoo_mjx.learning.weights import load_weights

    return Runner(load_weights(weights), time_limit, senses_named(senses))


def _trial(robot: tuple[Path, float, str], folder: Path, trial: tuple[str, Trial]) -> list[dict[str, Any]]:
    """The row of one trial; its track is kept for the figures."""
    method, drawn = trial
    row, track = _runner(*robot).run(drawn, method)
    write_arrays(folder / f"{_name(method, drawn)}.npz", track)
    return [row]


def _name(method: str, trial: Trial) -> str:
    return f"{custom.kept_as(OWN, method, METHODS)}-{trial.name}"
