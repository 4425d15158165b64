"""The form of an experiment and its runner, with workers, resuming, fingerprints and progress."""

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
    """Settings that every experiment has."""

    workers: int = 2
    """Number of processes."""


class Prepared(NamedTuple):
    """Inputs of an experiment."""

    data: Any = None
    """Data sets, maps or objects for the trials. Picklable."""
    files: tuple[Path, ...] = ()
    """Files that decide about the results. Other contents get another store."""
    settings: tuple[Any, ...] = ()
    """Settings that decide about the results, in addition to config, seeds and senses."""


@dataclass(frozen=True)
class Setup[C: ExperimentConfig]:
    """Options, config, folders and data that all trials of a run share. Picklable."""

    options: ExperimentOptions
    config: C
    folder: Path
    """Folder for figures."""
    store: Path
    """Folder for finished trials. It belongs to these settings, inputs and code alone."""
    data: Any = None
    """Result of `Experiment.prepare`."""


def _weights(options: ExperimentOptions, config: Any, folder: Path) -> Prepared:
    return Prepared(files=(options.weights_file,))


@dataclass(frozen=True)
class Experiment[C: ExperimentConfig]:
    """An experiment on held-out conditions. Its functions stand at the top level of its module."""

    section: Section
    """How the results page shows it."""
    config: C
    quick: C
    """Config of the short form."""
    trials: Callable[[Setup[C]], Mapping[str, Any]]
    """Trials by name, in the order of the rows. The names serve as file names."""
    trial: Callable[[Setup[C], Any], list[Row]]
    """Runs one value of ``trials`` in a worker process and returns its rows. The code that it imports is part of the
    fingerprint."""
    metrics: Callable[[Setup[C], list[Row]], dict[str, Any]]
    further_trials: Callable[[Setup[C], list[Row]], Mapping[str, Any]] | None = None
    """Further trials that depend on the rows of ``trials``."""
    draw: Callable[[Setup[C], list[Row]], None] | None = None
    """Writes figures into ``folder``."""
    prepare: Callable[[ExperimentOptions, C, Path], Prepared] = _weights
    """Makes the inputs, given the experiment's folder. By default the weights are the only input."""
    adjust: Callable[[ExperimentOptions, C], C] | None = None
    """Changes the config by options such as ``--policies``."""
    neutral: tuple[str, ...] = ()
    """Fields of the config that change the number of trials but no single trial."""
    about: Callable[[Setup[C]], dict[str, Any]] | None = None
    """Further entries of the result's config."""
    only_drawn: tuple[str, ...] = ()
    """Fields of rows that only the figures need. The result leaves them out."""
    paper: Mapping[str, float] = field(default_factory=dict)
    """The paper's numbers under the names of the metrics they compare with."""
    first_seed: int = 0
    """Default of ``--seed``."""
    printed: Callable[[ExperimentResult], str] = lambda result: ""
    """Text that the command prints for a result. If it is empty, the command prints the metrics."""


def run[C: ExperimentConfig](
    name: str, experiment: Experiment[C], options: ExperimentOptions, config: C | None = None
) -> ExperimentResult:
    """Run the missing trials and assemble the result.

    Args:
        name: name of the experiment and of its folder below ``options.out``.
        experiment: the experiment.
        options: options of the command.
        config: replaces the experiment's own config or its quick one, and the options that adjust it.
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
    """The inputs, and the store that belongs to these settings, inputs and code."""
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
