"""The JSON of an experiment: one schema, plain numbers, whole files."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from shmoo_mjx.base.assets import asset
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.registry import EXPERIMENTS, run_experiment
from shmoo_mjx.evaluation.result import (
    ExperimentOptions,
    ExperimentResult,
    make_result,
    read_result,
    spread,
    table,
    weights_id,
    write_result,
)


def example() -> ExperimentResult:
    metrics = {"mse_after": np.float32(0.25), "mse_before": 1.0, "lost": math.nan}
    rows = [{"condition": "box-1", "pose": np.zeros(3), "ok": np.bool_(True)}]
    return make_result(
        "object_model",
        ExperimentOptions(seed=3, quick=True),
        {"seeds": (1, 2)},
        metrics,
        paper={"mse_after": 0.4271},
        rows=rows,
    )


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "result.json"
    write_result(path, example())
    again = read_result(path)
    assert again == example()
    assert again.metrics == {"mse_after": 0.25, "mse_before": 1.0, "lost": None}
    assert again.config == {
        "seeds": [1, 2],
        "condition_seed": 0,
        "quick": True,
        "senses": "real",
        "weights": weights_id(),
    }
    assert again.rows == [{"condition": "box-1", "pose": [0.0, 0.0, 0.0], "ok": True}]
    assert "shmoo-mjx" in again.versions and [p.name for p in path.parent.iterdir()] == ["result.json"]


def test_the_committed_schema_is_that_of_the_code() -> None:
    assert json.loads(asset("experiments/result.schema.json").read_text()) == ExperimentResult.model_json_schema()


def test_the_table_has_the_papers_number_beside_ours() -> None:
    lines = [line.split() for line in table(example()).splitlines()]
    assert ["mse", "after", "0.25", "0.4271"] in lines and ["lost", "-"] in lines


def test_the_table_has_words_and_units() -> None:
    metrics = {"difference_oracle_time_s_low": 1.0, "right_after_1_s": 0.5, "offset_m": 0.1, "s": 1.0}
    made = table(example().model_copy(update={"metrics": metrics}))
    for label in ("difference oracle time low [s] ", "right after 1 s ", "offset [m] ", "s "):
        assert f"\n{label}" in made


def test_spread_leaves_out_what_is_not_finite() -> None:
    assert spread([1.0, 3.0, math.nan])["mean"] == 2.0
    assert math.isnan(spread([])["median"])


@pytest.mark.parametrize("text", ["{", "[]", '{"experiment": "x"}'])
def test_another_file_is_refused_in_one_sentence(tmp_path: Path, text: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(ShmooError, match=r"other\.json"):
        read_result(path)


def test_an_unknown_experiment_names_the_known_ones() -> None:
    with pytest.raises(ShmooError, match="object_planner"):
        run_experiment("nonsense", ExperimentOptions())
    assert set(EXPERIMENTS) >= {"object_model", "baselines", "pushing", "navigation"}


def test_condition_seeds_do_not_meet() -> None:
    assert ExperimentOptions(condition_seed=1).first_unseen - ExperimentOptions().first_unseen == 1000
