"""What the trainings of one experiment share: training set, unseen objects, and where their results are kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.data import store
from shmoo_mjx.evaluation import datasets, scoring
from shmoo_mjx.evaluation.baselines import Budget, Job, recordings
from shmoo_mjx.evaluation.result import ExperimentOptions


@dataclass(frozen=True)
class TrainingsConfig:
    """What the experiments on the object model have in common."""

    seeds: int = 3
    """Trainings of each kind."""
    training_objects: int | None = None
    """Per family; None takes all that the training set has."""
    unseen: Mapping[str, int] = field(default_factory=lambda: {"box": 7, "cart": 7, "wheelchair": 6})
    """Unseen objects per family."""
    workers: int = 1
    """Processes; a training keeps both cores busy by itself, and two of them hinder each other."""


QUICK: dict[str, Any] = {"seeds": 1, "training_objects": 6, "unseen": {"box": 2, "cart": 2, "wheelchair": 2}}
"""The same in a quick experiment."""


@dataclass(frozen=True)
class Trainings:
    """One experiment's data. Picklable, so that a training can run in a process of its own."""

    train: Path
    """Directory of the training set."""
    unseen: Path
    """Directory with the recordings of unseen objects."""
    folder: Path
    """What an interrupted experiment goes on from."""
    training_objects: int | None
    """Per family; None takes all that the training set has."""
    seed: int

    def job(
        self, name: str, number: int, budget: Budget, fit_samples: int, setting: dict[str, Any] | None = None
    ) -> Job:
        """Training ``number``, whose checkpoint is kept under ``name``; each number has a seed of its own."""
        dataset = store.of_training(self.train)
        if self.training_objects is not None:
            dataset = datasets.subset(dataset, self.training_objects)
        parts = recordings(dataset.split("train")), recordings(dataset.split("validation"))
        return Job(*parts, setting or {}, budget, self.seed + number, fit_samples, self.folder / "training" / name)

    def objects(self) -> store.Dataset:
        """The unseen objects."""
        return store.read(self.unseen, splits=("test",))


def rows_of(objects: store.Dataset, found: Mapping[str, np.ndarray], about: dict[str, Any]) -> list[dict[str, Any]]:
    """One row for each unseen object: ``about``, the object, and its `scoring.NAMES`, NaN where not found."""
    none = np.full(len(objects.names), np.nan)
    return [
        about
        | {"condition": condition, "family": described["family"]}
        | {measure: float(found.get(measure, none)[i]) for measure in scoring.NAMES}
        for i, (condition, described) in enumerate(zip(objects.names, objects.conditions, strict=True))
    ]


def prepare(
    code: str, name: str, options: ExperimentOptions, config: TrainingsConfig, neutral: dict[str, Any]
) -> Trainings:
    """Collect the data that is not at hand, and find the folder that belongs to these settings and no others.

    ``code`` is the experiment's module; ``neutral`` has values for fields of ``config`` that change no single training.
    """
    train, unseen = datasets.training_directory(options), datasets.unseen_directory(options, config.unseen)
    key = asdict(replace(config, workers=1, **neutral)) | {"seed": options.seed}
    folder = options.out / name / fingerprint(code, key, train / store.MANIFEST, unseen / store.MANIFEST)
    return Trainings(train, unseen, folder, config.training_objects, options.seed)
