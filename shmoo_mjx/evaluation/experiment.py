"""The form of an experiment, and the one runner: workers, resume after a stop, fingerprints, progress, result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result, no_progress
from shmoo_mjx.evaluation.tables import Section
from shmoo_mjx.evaluation.trials import run_trials

Row = dict[str, Any]


@dataclass(frozen=True)
class ExperimentConfig:
    """What the config of every experiment has."""

    workers: int = 2
    """Processes."""


class Prepared(NamedTuple):
    """What an experiment needs before its first trial."""

    data: Any = None
    """For the trials: data sets, maps, objects. Picklable."""
    files: tuple[Path, ...] = ()
    """Files whose contents decide about the results; their rows are kept apart from those of others."""
    settings: tuple[Any, ...] = ()
    """Settings, besides the config, the seeds and the senses, that decide about the results."""


@dataclass(frozen=True)
class Setup[C: ExperimentConfig]:
    """What all trials of one run of an experiment share. Picklable."""

    options: ExperimentOptions
    config: C
    folder: Path
    """For figures."""
    store: Path
    """For what is kept of trials: one folder for these settings, inputs and code, and no others."""
    data: Any = None
    """What `Experiment.prepare` made."""


def _weights(options: ExperimentOptions, config: Any, folder: Path) -> Prepared:
    return Prepared(files=(options.weights_file,))


@dataclass(frozen=True)
class Experiment[C: ExperimentConfig]:
    """One claim that is measured on held-out conditions. Every function stands at the top level of its module."""

    section: Section
    """How the page of results shows it."""
    config: C
    quick: C
    """Config of the short form."""
    trials: Callable[[Setup[C]], Mapping[str, Any]]
    """What is tried, by names that are good as file names, in the order of the rows."""
    trial: Callable[[Setup[C], Any], list[Row]]
    """One value of ``trials`` -> its rows; called in other processes. Code that it imports is in the fingerprint."""
    metrics: Callable[[Setup[C], list[Row]], dict[str, Any]]
    further_trials: Callable[[Setup[C], list[Row]], Mapping[str, Any]] | None = None
    """What is tried after ``trials``, given their rows."""
    draw: Callable[[Setup[C], list[Row]], None] | None = None
    """Writes figures into ``folder``."""
    prepare: Callable[[ExperimentOptions, C, Path], Prepared] = _weights
    """Makes the inputs, given the experiment's folder; by default the weights are the only one."""
    adjust: Callable[[ExperimentOptions, C], C] | None = None
    """Changes the config by options such as ``--policies``."""
    neutral: tuple[str, ...] = ()
    """Fields of the config that change no single trial, only how many of them there are."""
    about: Callable[[Setup[C]], dict[str, Any]] | None = None
    """What the result's config says besides ``config``."""
    only_drawn: tuple[str, ...] = ()
    """Fields of rows that figures need and the result leaves out."""
    paper: Mapping[str, float] = field(default_factory=dict)
    """The paper's numbers under the names of the metrics they compare with."""
    first_seed: int = 0
    """Seed where the command line gives none."""
    printed: Callable[[ExperimentResult], str] = lambda result: ""
    """What the command prints of a result in the place of its metrics; they are printed if it is empty."""


def run[C: ExperimentConfig](
    name: str, experiment: Experiment[C], options: ExperimentOptions, config: C | None = None
) -> ExperimentResult:
    """Run what is not done yet and put the result together.

    Args:
        name: of the experiment and its folder below ``options.out``.
        experiment: what is run.
        options: from the command line.
        config: by default the experiment's own, or its quick one, adjusted by the options.
    """
    setup = prepare(name, experiment, options, config)

    def rows_of(trials: Mapping[str, Any]) -> list[Row]:
        work = partial(experiment.trial, setup)
        return run_trials(trials, work, setup.store, options.progress, workers=setup.config.workers)

    rows = rows_of(experiment.trials(setup))
    if experiment.further_trials is not None:
        rows += rows_of(experiment.further_trials(setup, rows))
    metrics = experiment.metrics(setup, rows)
    if experiment.draw is not None:
        options.progress("figures", 0.98)
        experiment.draw(replace(setup, options=options), rows)
    options.progress("done", 1.0)
    settings = asdict(setup.config) | (experiment.about(setup) if experiment.about is not None else {})
    rows = [{key: value for key, value in row.items() if key not in experiment.only_drawn} for row in rows]
    return make_result(name, options, settings, metrics, paper=dict(experiment.paper), rows=rows)


def prepare[C: ExperimentConfig](
    name: str, experiment: Experiment[C], options: ExperimentOptions, config: C | None = None
) -> Setup[C]:
    """The inputs, and the folder that belongs to these settings, inputs and code."""
    if config is None:
        config = experiment.quick if options.quick else experiment.config
        config = config if experiment.adjust is None else experiment.adjust(options, config)
        config = replace(config, **options.sizes)
    folder = options.out / name
    data, files, settings = experiment.prepare(options, config, folder)
    deciding = {k: v for k, v in asdict(config).items() if k not in ("workers", *experiment.neutral)}
    identity = deciding, options.seed, options.condition_seed, options.senses, settings
    store = folder / f"trials-{fingerprint(experiment.trial.__module__, identity, *files)}"
    return Setup(replace(options, progress=no_progress), config, folder, store, data)
