"""Data sets that experiments on the object model share: one training set, and recordings of unseen objects."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path

from shmoo_mjx.data import store
from shmoo_mjx.data.collect import SPLIT_SEEDS, CollectConfig, collect
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.result import ExperimentOptions
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import FAMILIES, draw_condition

TRAINING = Path("data/train")
"""Default directory of the training set, the one of ``shmoo collect data/train`` in the docs."""

QUICK = CollectConfig(train=8, validation=3)
"""Size of the training set that a quick experiment collects if there is none."""


def training_directory(options: ExperimentOptions) -> Path:
    """The directory of the training set: ``options.data`` or data/train, collected if it is absent.

    An interrupted collection continues. If there is no training set, a quick experiment collects a small one.

    Raises:
        ShmooError: the directory holds a damaged data set.
    """
    directory = options.data or TRAINING
    config = CollectConfig()
    if options.quick and not (directory / store.MANIFEST).exists():
        directory, config = options.data or options.out / "data" / "train-quick", QUICK
    if (directory / store.MANIFEST).exists():
        manifest = json.loads((directory / store.MANIFEST).read_text())
        recorded = manifest.get("schema", {}).get("config")
        config = CollectConfig(**(recorded or {}))
        wanted = len(FAMILIES) * (config.train + config.validation + config.test)
        if recorded is None or len(manifest["conditions"]) >= wanted:
            return directory
    collect(directory, config, progress=_report(options, "collect training objects"))
    return directory


def unseen_directory(options: ExperimentOptions, counts: Mapping[str, int]) -> Path:
    """The directory with recordings of unseen objects, collected once under ``options.out``.

    Args:
        options: the condition_seed draws the objects, and the seed draws the operators that push them.
        counts: number of objects of each family.
    """
    first = options.first_unseen
    assert first >= SPLIT_SEEDS["test"], "an unseen object would have a training seed"
    rows = [
        (f"test-{family}-{first + i}", "test", draw_condition(family, first + i))
        for family, count in counts.items()
        for i in range(count)
    ]
    name = "-".join(str(n) for n in counts.values())
    return collect_rows(options, f"unseen-{first}-{name}", rows)


def collect_rows(options: ExperimentOptions, name: str, rows: list[tuple[str, str, Condition]]) -> Path:
    """A directory under ``options.out`` with recordings of given conditions, collected once.

    Args:
        options: the seed and the condition_seed draw the operators.
        name: first part of the directory's name. The seed is the second part.
        rows: (name, split, condition) of each recording.
    """
    directory = options.out / "data" / f"{name}-seed{options.seed}"
    # The operators differ from those of the training set, whose seeds are small.
    config = CollectConfig(train=0, validation=0, seed=options.first_unseen + options.seed)
    collect(directory, config, progress=_report(options, "collect unseen objects"), rows=rows)
    return directory


def subset(dataset: store.Dataset, per_family: int) -> store.Dataset:
    """The first ``per_family`` conditions of each family and split.

    Raises:
        ShmooError: nothing is left.
    """
    groups: dict[tuple[str, str], list[int]] = defaultdict(list)
    for i, condition in enumerate(dataset.conditions):
        groups[condition["family"], condition["split"]].append(i)
    if not groups:
        raise ShmooError("data set: field 'conditions' is empty; collect some conditions first.")
    return dataset.chosen(sorted(i for group in groups.values() for i in group[:per_family]))


def _report(options: ExperimentOptions, stage: str) -> Callable[[int, int], None]:
    return lambda done, total: options.progress(stage, done / max(total, 1))
