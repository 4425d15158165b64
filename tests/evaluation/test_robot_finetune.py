"""The experiment `robot_finetune`: what its metrics compare, and its short form from robot to JSON."""

from __future__ import annotations

from pathlib import Path

import pytest

from shmoo_mjx.evaluation import robot_finetune
from shmoo_mjx.evaluation.registry import run_experiment
from shmoo_mjx.evaluation.result import ExperimentOptions

OUTPUTS = {f"mse_{name}": 1.0 for name in robot_finetune.OUTPUTS}


def test_differences_are_of_the_same_push_by_the_same_robot() -> None:
    rows = [{"robot": 0, "model": model, "mse": mse} | OUTPUTS for model, mse in (("before", 0.4), ("after", 0.3))]
    for robot in (0, 1):
        for model, gain in (("before", 0.0), ("after", 0.02)):
            for k in range(3):
                push = {"offset_m": 0.1 * (k + 1) - gain, "yaw_error_deg": 5.0, "success": k > 0, "fell": False}
                rows.append({"robot": robot, "model": model, "trial": f"box-{k}"} | push)
    found = robot_finetune._metrics(rows)
    assert found["reduction_percent"] == pytest.approx(25.0)
    assert found["success_before"] == found["success_after"] == pytest.approx(2 / 3)
    # Equal gains in every pair leave no width to the interval; unpaired offsets would.
    assert found["offset_m_difference"] == pytest.approx(-0.02)
    assert found["offset_m_difference_high"] == pytest.approx(-0.02) and found["offset_m_difference_pairs"] == 6


@pytest.mark.slow
def test_the_short_form_learns_from_its_robot_and_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = ExperimentOptions(quick=True, out=tmp_path)
    result = run_experiment("robot_finetune", options)
    assert {row["model"] for row in result.rows} == {"before", "after", "more"}
    assert result.metrics["reduction_percent"] > 0  # type: ignore[operator]
    assert (tmp_path / "robot_finetune" / "robot_finetune.png").stat().st_size > 5000
    monkeypatch.delattr(robot_finetune, "_record")
    assert run_experiment("robot_finetune", options).metrics == result.metrics
