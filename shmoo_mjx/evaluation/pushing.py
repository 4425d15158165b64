"""Experiment ``pushing`` (Sec. VI-A, Fig. 7): objects pushed to three goals.

Three strata of trials, each with three families and three goals: movable objects, ten runs each; objects that ask for
adaptation, seven runs each; and five runs with objects as they are drawn. Every method runs every trial.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from statistics import fmean
from typing import Any

from shmoo_mjx.base import custom
from shmoo_mjx.base.assets import asset
from shmoo_mjx.base.npz import write_arrays
from shmoo_mjx.evaluation.experiment import Experiment, ExperimentConfig, Prepared, Setup
from shmoo_mjx.evaluation.pushing_figure import draw_figure, film
from shmoo_mjx.evaluation.pushing_measures import PAPER, metrics_of, pushing_tables
from shmoo_mjx.evaluation.pushing_trials import EVERYTHING, METHODS, OWN, STRATA, Runner, Trial, draw_trials
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult
from shmoo_mjx.evaluation.tables import (
    Line,
    Section,
    SummaryValue,
    difference,
    lines_of_methods,
    measured,
    rate,
    short,
)
from shmoo_mjx.plant.objects import FAMILIES
from shmoo_mjx.sensing import senses_named


@dataclass(frozen=True)
class PushingConfig(ExperimentConfig):
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
    videos: bool = True
    """One film per family."""


def _prepare(options: ExperimentOptions, config: PushingConfig, folder: Path) -> Prepared:
    from shmoo_mjx.behavior.methods import METHODS
    from shmoo_mjx.behavior.push_task import PushTaskConfig

    settings = asdict(PushTaskConfig()), senses_named(options.senses), *map(asdict, METHODS.values())
    return Prepared(files=(options.weights_file, asset(METHODS["paper"].weights)), settings=settings)


def _drawn(setup: Setup[PushingConfig]) -> list[Trial]:
    config, options = setup.config, setup.options
    runs = zip(STRATA, (config.runs, config.demanding_runs, config.everything_runs), strict=True)
    drawn = (
        draw_trials(options.first_unseen, options.seed, count, goals=config.goals, stratum=stratum)
        for stratum, count in runs
    )
    return [trial for trials in drawn for trial in trials]


def _trials(setup: Setup[PushingConfig]) -> dict[str, tuple[str, Trial]]:
    # Ours first, then the method that differs least from it: the trials of a stopped experiment can be compared.
    drawn = _drawn(setup)
    return {_name(method, trial): (method, trial) for method in setup.config.methods for trial in drawn}


@cache
def _runner(weights: Path, time_limit: float, senses: str) -> Runner:
    """A worker's own: compiling its controllers takes longer than a trial."""
    from shmoo_mjx.learning.weights import load_weights

    return Runner(load_weights(weights), time_limit, senses_named(senses))


def _trial(setup: Setup[PushingConfig], trial: tuple[str, Trial]) -> list[dict[str, Any]]:
    """The row of one trial; its track is kept for the figures."""
    method, drawn = trial
    runner = _runner(setup.options.weights_file, setup.config.time_limit, setup.options.senses)
    row, track = runner.run(drawn, method)
    write_arrays(setup.store / f"{_name(method, drawn)}.npz", track)
    return [row]


def _name(method: str, trial: Trial) -> str:
    return f"{custom.kept_as(OWN, method, METHODS)}-{trial.name}"


def _draw(setup: Setup[PushingConfig], rows: list[dict[str, Any]]) -> None:
    """The figure, and a film of one trial of each family."""
    draw_figure(setup.folder / "pushing.png", [r for r in rows if r["stratum"] != EVERYTHING], setup.store)
    drawn = [t for t in _drawn(setup) if t.goal == 2 and t.stratum == STRATA[0]] if setup.config.videos else []
    for first in {trial.family: trial for trial in reversed(drawn)}.values():
        file = setup.folder / f"pushing-{first.family}.mp4"
        film(file, first, setup.store, senses_named(setup.options.senses))


def _offset(result: ExperimentResult) -> SummaryValue:
    mean, median = (100 * measured(result, name) for name in ("offset_m", "offset_median_m"))
    goals = [result.paper[name] for name in sorted(result.paper) if name.startswith("offset_goal")]
    paper = f"{short(100 * fmean(goals))} cm" if goals else ""
    return f"{short(mean)} cm (median {short(median)} cm)", round(measured(result, "trials")), paper


EXPERIMENT = Experiment(
    Section(
        "Pushing to a pose (VI-A, Fig. 7)",
        "The proxy robot pushes unseen objects to three goals. Two strata: movable objects, and demanding ones (load "
        "far off the centre, 25 to 45 N of resistance, half or twice the friction, a brake from the start). "
        "Both leave out objects with a locked wheel and objects that resist with more than 32 N (demanding: 43 N). "
        "A third stratum leaves out nothing and has tables of its own. Every method runs every trial.",
        ("ours", "frozen prior", "contact model", "quasi-static", "oracle coefficients", "paper's system"),
        (
            *lines_of_methods(
                {
                    **{f"offset_goal{i}_m": f"offset, goal {i} [m]" for i in (1, 2, 3)},
                    **{f"radius_goal{i}_m": f"enclosing circle, goal {i} [m]" for i in (1, 2, 3)},
                    "success_rate": "success",
                    "success_rate_movable": "success, movable",
                    "success_rate_demanding": "success, demanding",
                    **{f"success_rate_{family}": f"success, {family}" for family in FAMILIES},
                    "success_rate_change_brake": "success, a brake pressed on the way",
                    "offset_m": "offset, mean [m]",
                    "offset_movable_m": "offset, mean, movable [m]",
                    "offset_demanding_m": "offset, mean, demanding [m]",
                    "offset_median_m": "offset, median [m]",
                    "yaw_error_deg": "yaw error [deg]",
                    "falls": "falls",
                    "toppled": "objects toppled",
                    "worst_lean_rad": "worst lean [rad]",
                    "time_s": "time [s]",
                    "pushes": "pushes",
                    "trials": "trials",
                },
                *("frozen_prior", "contact_model", "quasi_static", "oracle_coefficients", "paper"),
            ),
            Line("way from the prior's offset to the oracle's", ("way_to_oracle", "", "", "", "", "")),
        ),
        ("pushing.png",),
        further_tables=pushing_tables,
        summary=(
            (
                "Success rate of pushing movable objects to a pose",
                rate("success_rate", lambda r: measured(r, "trials")),
            ),
            (
                "Success rate compared with no adaptation",
                difference("difference_frozen_prior_success", "points", 100.0),
            ),
            ("Mean distance from the goal after pushing", _offset),
            (
                "Distance from the goal compared with no adaptation",
                difference("difference_frozen_prior_offset_m", "cm", 100.0),
            ),
        ),
    ),
    PushingConfig(),
    quick=PushingConfig(runs=1, demanding_runs=1, everything_runs=1, goals=(1, 2), videos=False),
    trials=_trials,
    trial=_trial,
    metrics=lambda setup, rows: metrics_of(rows),
    draw=_draw,
    prepare=_prepare,
    adjust=lambda options, config: replace(config, methods=options.chosen(METHODS, others=True)),
    neutral=("runs", "demanding_runs", "everything_runs", "goals", "methods", "videos"),
    paper=PAPER,
)
