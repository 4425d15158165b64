"""Experiment ``pushing`` (Sec. VI-A, Fig. 7): objects are pushed to three goals.

The trials form three strata with three families and three goals each: movable objects, demanding objects, and objects
as drawn, which include heavy ones and locked wheels. Every method runs every trial.
"""

from __future__ import annotations

from collections.abc import Mapping
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
    Effect,
    Line,
    Section,
    SummaryValue,
    Table,
    difference,
    effects,
    lines_of_methods,
    measured,
    number,
    rate,
    shown_name,
)
from shmoo_mjx.plant.objects import FAMILIES
from shmoo_mjx.sensing import senses_named


@dataclass(frozen=True)
class PushingConfig(ExperimentConfig):
    """Size of the experiment."""

    runs: int = 5
    """Runs per stratum, family and goal."""
    goals: tuple[int, ...] = (1, 2, 3)
    methods: tuple[str, ...] = METHODS
    time_limit: float = 120.0
    """Longest trial [s]."""
    videos: bool = True
    """Whether to write one film per family."""


def _prepare(options: ExperimentOptions, config: PushingConfig, folder: Path) -> Prepared:
    from shmoo_mjx.behavior.methods import METHODS
    from shmoo_mjx.behavior.push_task import PushTaskConfig

    settings = asdict(PushTaskConfig()), senses_named(options.senses), *map(asdict, METHODS.values())
    return Prepared(files=(options.weights_file, asset(METHODS["paper"].weights)), settings=settings)


def _drawn(setup: Setup[PushingConfig]) -> list[Trial]:
    config, options = setup.config, setup.options
    drawn = (
        draw_trials(options.first_unseen, options.seed, config.runs, goals=config.goals, stratum=stratum)
        for stratum in STRATA
    )
    return [trial for trials in drawn for trial in trials]


def _trials(setup: Setup[PushingConfig]) -> dict[str, tuple[str, Trial]]:
    # Methods run one after another, ours first, so that the trials of a stopped experiment can be compared.
    drawn = _drawn(setup)
    return {_name(method, trial): (method, trial) for method in setup.config.methods for trial in drawn}


@cache
def _runner(weights: Path, time_limit: float, senses: str) -> Runner:
    """The runner of a worker process. It is kept because compiling its controllers takes longer than a trial."""
    from shmoo_mjx.learning.weights import load_weights

    return Runner(load_weights(weights), time_limit, senses_named(senses))


def _trial(setup: Setup[PushingConfig], trial: tuple[str, Trial]) -> list[dict[str, Any]]:
    """Run one trial and return its row. Its track is kept for the figures."""
    method, drawn = trial
    runner = _runner(setup.options.weights_file, setup.config.time_limit, setup.options.senses)
    row, track = runner.run(drawn, method)
    write_arrays(setup.store / f"{_name(method, drawn)}.npz", track)
    return [row]


def _name(method: str, trial: Trial) -> str:
    return f"{custom.kept_as(OWN, method, METHODS)}-{trial.name}"


def _draw(setup: Setup[PushingConfig], rows: list[dict[str, Any]]) -> None:
    """Write the figure, and a film of one trial per family."""
    draw_figure(setup.folder / "pushing.png", [r for r in rows if r["stratum"] != EVERYTHING], setup.store)
    drawn = [t for t in _drawn(setup) if t.goal == 2 and t.stratum == STRATA[0]] if setup.config.videos else []
    for first in {trial.family: trial for trial in reversed(drawn)}.values():
        file = setup.folder / f"pushing-{first.family}.mp4"
        film(file, first, setup.store, senses_named(setup.options.senses))


def _offset(result: ExperimentResult) -> SummaryValue:
    mean, median = (100 * measured(result, name) for name in ("offset_m", "offset_median_m"))
    goals = [result.paper[name] for name in sorted(result.paper) if name.startswith("offset_goal")]
    paper = f"{number(100 * fmean(goals))} cm" if goals else ""
    return f"{number(mean)} cm (median {number(median)} cm)", round(measured(result, "trials")), paper


EFFECTS = (
    Effect("the success rate", "success", "points", 100.0),
    Effect("the mean distance from the goal", "offset_m", "cm", 100.0),
    Effect("the yaw error", "yaw_error_deg", "deg"),
    Effect("the time", "time_s", "s"),
)
"""What the page compares methods by."""


def _shows(result: ExperimentResult) -> str:
    subjects = {
        "frozen_prior": "Compared with no adaptation, ours",
        "paper": "Compared with the paper's system, ours",
        "contact_model": "Compared with the contact model alone, ours",
    }
    told = (effects(result, subject, f"difference_{method}_", EFFECTS) for method, subject in subjects.items())
    return " ".join(sentence for sentence in told if sentence)


_COLUMNS = ("ours", *(shown_name(method) for method in METHODS[1:]))


def _table(labels: dict[str, str], *further: Line) -> Table:
    return Table(_COLUMNS, (*lines_of_methods(labels, *METHODS[1:]), *further))


def _arguments(config: Mapping[str, Any]) -> str:
    methods = config.get("methods", METHODS)
    return "" if set(methods) == set(METHODS) else f"--policies {' '.join(methods)}"


EXPERIMENT = Experiment(
    Section(
        "Pushing to a pose",
        "How precisely does the robot push unseen objects to three goals? (Sec. VI-A, Fig. 7 of the paper)",
        (
            _table(
                {
                    "success_rate": "Success rate",
                    **{f"offset_goal{i}_m": f"Mean distance from goal {i} [m]" for i in (1, 2, 3)},
                    "offset_median_m": "Median distance from the goal [m]",
                    "yaw_error_deg": "Mean yaw error [deg]",
                    "time_s": "Mean time [s]",
                    "trials": "Trials",
                }
            ),
            _table(
                {
                    "offset_m": "Mean distance from the goal [m]",
                    **{f"offset_{stratum}_m": f"Mean distance, {stratum} objects [m]" for stratum in STRATA[:2]},
                    **{f"success_rate_{stratum}": f"Success rate, {stratum} objects" for stratum in STRATA[:2]},
                    **{f"success_rate_{family}": f"Success rate, {family}" for family in FAMILIES},
                    "success_rate_change_brake": "Success rate, a brake pressed on the way",
                    **{f"radius_goal{i}_m": f"Radius of the circle of all ends, goal {i} [m]" for i in (1, 2, 3)},
                    "yaw_error_median_deg": "Median yaw error [deg]",
                    "falls": "Falls",
                    "toppled": "Objects toppled",
                    "worst_lean_rad": "Largest lean [rad]",
                    "pushes": "Mean number of pushes",
                },
                Line("Share of the way from no adaptation to known parameters", ("way_to_oracle", *[""] * 5)),
            ),
            pushing_tables,
        ),
        _shows,
        {"pushing.png": "Paths of the objects under our controller, and where every object ended"},
        arguments=_arguments,
        summary=(
            (
                "Success rate of pushing to a pose, objects without a locked wheel, up to 43 N",
                rate("success_rate", lambda r: measured(r, "trials")),
            ),
            (
                "Success rate of pushing, compared with no adaptation",
                difference("difference_frozen_prior_success", "points", 100.0),
            ),
            (
                "Success rate of pushing to a pose, objects as drawn",
                rate("everything_success_rate", lambda r: measured(r, "everything_trials")),
            ),
            ("Mean distance from the goal after pushing", _offset),
        ),
    ),
    PushingConfig(),
    quick=PushingConfig(runs=1, goals=(1, 2), videos=False),
    trials=_trials,
    trial=_trial,
    metrics=lambda setup, rows: metrics_of(rows),
    draw=_draw,
    prepare=_prepare,
    adjust=lambda options, config: replace(config, methods=options.chosen(METHODS, others=True)),
    neutral=("runs", "goals", "methods", "videos"),
    paper=PAPER,
)
