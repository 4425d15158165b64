"""The runner takes what the command line asks of an experiment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from shmoo_mjx.evaluation.experiment import prepare
from shmoo_mjx.evaluation.registry import RELIABILITY, experiment_named
from shmoo_mjx.evaluation.result import ExperimentOptions


@pytest.mark.parametrize(("name", "quick", "sizes"), [
    ("faults", {"runs": 1}, {"runs": 3, "only": ("camera_gone",)}),
    ("soak", {"minutes": 2.0, "buildings": 1}, {"buildings": 2, "minutes": 5.0}),
])  # fmt: skip
def test_the_short_form_and_sizes_reach_the_config(
    name: str, quick: dict[str, Any], sizes: dict[str, Any], tmp_path: Path
) -> None:
    def config(**options: Any) -> dict[str, Any]:
        return vars(prepare(name, experiment_named(name), ExperimentOptions(out=tmp_path, **options)).config)

    assert config(quick=True).items() >= quick.items()
    assert config(sizes=sizes | {"workers": 1}).items() >= (sizes | {"workers": 1}).items()
    assert not config().items() >= quick.items() and set(RELIABILITY) == {"faults", "soak"}


def test_more_workers_go_on_from_what_fewer_have_run(tmp_path: Path) -> None:
    stores = {
        prepare("faults", experiment_named("faults"), ExperimentOptions(out=tmp_path, sizes={"workers": count})).store
        for count in (1, 2)
    }
    assert len(stores) == 1
