"""Parts that the experiments on the object model share: config, training set, unseen objects, and single trainings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.data import store
from shmoo_mjx.evaluation import datasets, scoring
from shmoo_mjx.evaluation.baselines import Budget, Job, recordings
from shmoo_mjx.evaluation.experiment import ExperimentConfig, Prepared, Setup
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult


@dataclass(frozen=True)
class TrainingsConfig(ExperimentConfig):
    """Settings that the experiments on the object model have in common."""

    workers: int = 1
    """Number of processes. One training uses several cores, so parallel trainings slow each other down."""
    seeds: int = 3
    """Number of trainings of each kind, each with its own seed."""
    training_objects: int | None = None
    """Number of training objects per family; None for all objects of the training set."""
    unseen: Mapping[str, int] = field(default_factory=lambda: {"box": 7, "cart": 7, "wheelchair": 6})
    """Number of unseen objects by family."""


QUICK: dict[str, Any] = {"seeds": 1, "training_objects": 6, "unseen": {"box": 2, "cart": 2, "wheelchair": 2}}
"""These settings in a quick experiment."""


class Directories(NamedTuple):
    """Data sets of an experiment."""

    train: Path
    """The training set."""
    unseen: Path
    """Recordings of unseen objects."""


def prepare(options: ExperimentOptions, config: TrainingsConfig, folder: Path) -> Prepared:
    """The data sets of an experiment. Missing ones are collected."""
    data = Directories(datasets.training_directory(options), datasets.unseen_directory(options, config.unseen))
    return Prepared(data, tuple(directory / store.MANIFEST for directory in data))


def job_of(
    setup: Setup[Any],
    name: str,
    number: int,
    *,
    budget: Budget,
    fit_samples: int,
    setting: dict[str, Any] | None = None,
) -> Job:
    """One training on the training set of an experiment.

    Args:
        setup: setup of the experiment.
        name: name of the directory of the checkpoint.
        number: number of the training, which is added to the seed.
        budget: budget of the training.
        fit_samples: number of first samples of a validation condition that a method adapts on.
        setting: settings of the method; None for the defaults.
    """
    dataset = store.of_training(setup.data.train)
    if setup.config.training_objects is not None:
        dataset = datasets.subset(dataset, setup.config.training_objects)
    parts = recordings(dataset.split("train")), recordings(dataset.split("validation"))
    seed, directory = setup.options.seed + number, setup.store / "training" / name
    return Job(*parts, setting or {}, budget, seed, fit_samples, directory)


def unseen_objects(setup: Setup[Any]) -> store.Dataset:
    """The recordings of unseen objects."""
    return store.read(setup.data.unseen, splits=("test",))


def rows_of(objects: store.Dataset, scores: Mapping[str, np.ndarray], about: dict[str, Any]) -> list[dict[str, Any]]:
    """One row for each unseen object: ``about``, the object, and its `scoring.NAMES` (NaN if not measured)."""
    none = np.full(len(objects.names), np.nan)
    return [
        about
        | {"condition": condition, "family": described["family"]}
        | {measure: float(scores.get(measure, none)[i]) for measure in scoring.NAMES}
        for i, (condition, described) in enumerate(zip(objects.names, objects.conditions, strict=True))
    ]


AFTER_3S = {"pos_rmse_3s_m": "position error after 3 s [m]", "yaw_rmse_3s_deg": "yaw error after 3 s [deg]"}
"""Measures of the longest roll-out, with their column heads in tables."""


def size_of(result: ExperimentResult) -> str:
    """Numbers of unseen objects and seeds of a result, as a sentence."""
    return f"{sum(result.config['unseen'].values())} unseen objects, {result.config['seeds']} seeds."
