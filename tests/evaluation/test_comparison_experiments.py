"""The experiments `baselines` and `ablations` from data to JSON and figure, on synthetic objects and tiny trainings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shmoo_mjx.data import store
from shmoo_mjx.evaluation import ablations, datasets
from shmoo_mjx.evaluation.baselines import Budget
from shmoo_mjx.evaluation.baselines import experiment as baselines
from shmoo_mjx.evaluation.registry import EXPERIMENTS, run_experiment
from shmoo_mjx.evaluation.result import ExperimentOptions

TINY = {
    "hidden": (8,),
    "contact_model": False,
    "functions": 2,
    "horizon": 2,
    "windows": 4,
    "conditions": 4,
    "adapt_samples": 16,
}


@pytest.fixture
def options(synthetic_dataset: store.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ExperimentOptions:
    """The synthetic data set in the place of collected ones."""
    opened = store.create_or_open(tmp_path / "data", {"kind": "synthetic"})
    entries = zip(synthetic_dataset.names, synthetic_dataset.arrays, synthetic_dataset.conditions, strict=True)
    for name, arrays, condition in entries:
        store.write_condition(opened, name, arrays, condition)
    monkeypatch.setattr(datasets, "training_directory", lambda options: tmp_path / "data")
    monkeypatch.setattr(datasets, "unseen_directory", lambda options, counts: tmp_path / "data")
    return ExperimentOptions(out=tmp_path / "out")


@pytest.mark.slow
def test_baselines_are_tuned_trained_scored_and_kept(
    options: ExperimentOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without the contact model, whose identification takes minutes.
    config = baselines.BaselinesConfig(
        methods=("trigonometric", "mlp", "constant_velocity"),
        settings=2,
        tuning=Budget(1, 4, 1),
        final=Budget(1, 8, 1),
        seeds=2,
        fit_seconds=10.0,
        workers=1,
    )
    result = run_experiment("baselines", options, config)
    found = result.metrics
    assert found["mse_std_mlp"] > 0 and found["mse_std_trigonometric"] == 0  # type: ignore[operator]
    tuned = [row for row in result.rows if "tuned" in row]
    assert len(tuned) == 4
    scored = [row for row in result.rows if row.get("method") == "mlp"]
    assert len(scored) == 2 * 3 and {row["run"] for row in scored} == {0, 1}
    best = min((row for row in tuned if row["tuned"] == "trigonometric"), key=lambda row: row["validation_fvu"])
    assert all(row["setting"] == best["setting"] for row in result.rows if row.get("method") == "trigonometric")
    assert (options.out / "baselines" / "baselines.png").stat().st_size > 5000
    table = baselines.baselines_table(result)
    assert "| constant_velocity" not in table and "| constant velocity" in table

    monkeypatch.delattr(baselines, "job_of")  # a fit that is made again would need it
    assert run_experiment("baselines", options, config).metrics == found


@pytest.mark.slow
def test_ablations_vary_one_thing_and_probe(options: ExperimentOptions, monkeypatch: pytest.MonkeyPatch) -> None:
    variants = {"default": TINY, "no_adversary": TINY | {"alpha": 0.0}, "functions_3": TINY | {"functions": 3}}
    monkeypatch.setattr(ablations, "VARIANTS", variants)
    config = ablations.AblationsConfig(
        variants=tuple(variants), budget=Budget(1, 4, 1), seeds=1, fit_seconds=(2.0, 10.0), probes=1, probe_updates=20
    )
    result = run_experiment("ablations", options, config)
    found = result.metrics
    for name in ("default", "default_2s", "no_adversary", "functions_3"):
        assert np.isfinite(found[f"fvu_{name}"])  # type: ignore[arg-type]
    assert "pos_rmse_3s_m_default" in found
    assert found["chance"] == pytest.approx(1 / 24) and found["mse_functions_3"] != found["mse_default"]
    assert 0 <= found["probe_psi_default"] <= 1  # type: ignore[operator]
    assert 0 <= found["probe_psi_no_adversary"] <= 1  # type: ignore[operator]
    assert "probe_psi_functions_3" not in found
    assert "| without the adversary |" in ablations.ablations_table(result)


def test_every_shipped_variant_is_a_configuration() -> None:
    from shmoo_mjx.evaluation.baselines.adaptive import daiml_config
    from shmoo_mjx.evaluation.baselines.protocol import Job, Recordings
    from shmoo_mjx.learning.daiml import DaimlConfig
    from shmoo_mjx.learning.samples import Samples

    nothing = Recordings(Samples(*np.zeros((4, 0, 0))), *np.zeros((2, 0, 0)))
    made = {n: daiml_config(Job(nothing, nothing, s), DaimlConfig()) for n, s in ablations.VARIANTS.items()}
    assert made["functions_3"].object.functions == 3 and made["no_adversary"].alpha == 0.0
    assert set(ablations.EXPERIMENT.quick.variants) <= set(made)
    assert set(ablations.AblationsConfig().variants) == set(made)
    assert {"baselines", "ablations"} <= set(EXPERIMENTS)
