"""Predicted pushes beside true ones: ends, coverage, measures, and the whole experiment on one object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shmoo_mjx.evaluation.experiment import Setup
from shmoo_mjx.evaluation.outcomes import OutcomesConfig, _trial, draw_object, end_after
from shmoo_mjx.evaluation.outcomes_measures import (
    covered,
    draw_figure,
    errors,
    measure,
    median_pose,
    outcomes_tables,
)
from shmoo_mjx.evaluation.result import ExperimentOptions, make_result

START = np.array([0.2, -0.1, 3.1])


def test_an_end_is_the_pose_at_exactly_that_way_and_nan_before() -> None:
    ahead = np.array([np.cos(START[2]), np.sin(START[2])])
    way = 0.03 * np.arange(1, 41)
    straight = np.concatenate([START[:2] + way[:, None] * ahead, np.full((40, 1), START[2])], axis=1)
    short, turned = straight[:20], straight + np.array([0.0, 0.0, 0.1])  # beyond pi
    poses = np.stack([straight, np.concatenate([short, np.repeat(short[-1:], 20, axis=0)])])
    end = end_after(poses, START, 0.8)
    np.testing.assert_allclose(end[0], [*(START[:2] + 0.8 * ahead), START[2]], atol=1e-6)
    assert np.isnan(end[1]).all()
    assert end_after(turned, START, 0.8)[2] == pytest.approx(3.2 - 2 * np.pi)
    first = end_after(straight, START, 0.01)
    np.testing.assert_allclose(first[:2], START[:2] + 0.01 * ahead, atol=1e-6)


def test_errors_and_medians_know_that_yaw_is_an_angle() -> None:
    found = errors(np.array([0.0, 0.0, 3.1]), np.array([0.3, 0.4, -3.1]))
    assert found["position_m"] == pytest.approx(0.5) and found["yaw_deg"] == pytest.approx(4.77, abs=0.01)
    middle = median_pose(np.array([[0.0, 0.0, 3.1], [1.0, 2.0, -3.1], [5.0, 9.0, 3.14]]))
    np.testing.assert_allclose(middle, [1.0, 2.0, 3.14])


def test_the_region_holds_the_share_of_ends_that_it_should() -> None:
    rng = np.random.default_rng(0)
    mix = np.array([[0.3, 0.2, 0.0], [0.0, 0.1, 0.3], [0.0, 0.0, 0.4]])
    ends = rng.normal(size=(300, 64, 3)) @ mix + [0.0, 0.0, 3.0]
    inside = [covered(samples, true) for samples, true in zip(ends, rng.permutation(ends[:, 0]), strict=True)]
    assert np.mean(inside) == pytest.approx(0.8, abs=0.06)
    assert not covered(ends[0], np.array([2.0, 0.0, 3.0]))
    # Samples that agree have a region too.
    assert covered(np.zeros((64, 3)), np.zeros(3)) and not covered(np.zeros((64, 3)), np.full(3, 0.1))


def row(index: int, came: bool, p: float, off: float, stratum: str = "free") -> dict[str, Any]:
    found = {"object": index, "stratum": stratum, "moves": float(came), "comes": float(came)}
    found |= {f"{name}_{event}": q for name, q in (("posterior", p), ("prior", 0.5)) for event in ("moves", "comes")}
    ends = {"posterior_position_m": off, "posterior_yaw_deg": 100 * off, "posterior_covered": off < 0.2}
    return found | (ends if came else {})


def test_measures_and_their_table() -> None:
    rows = [row(0, True, 0.9, 0.1), row(0, True, 1.0, 0.3), row(1, False, 0.4, 0.0), row(2, True, 0.2, 0.1)]
    metrics = measure(rows)
    assert metrics["position_m_free_posterior"] == pytest.approx(0.1)
    assert metrics["covered_free_posterior"] == pytest.approx(2 / 3)
    assert metrics["brier_comes_free_posterior"] == pytest.approx((0.01 + 0.0 + 0.16 + 0.64) / 4)
    assert metrics["right_moves_free_posterior"] == 0.75 and metrics["brier_moves_free_prior"] == pytest.approx(0.25)
    assert metrics["pushes_free_posterior"] == 4 and metrics["comes_free_posterior"] == 3
    low, high = (metrics[f"position_m_free_posterior_{end}"] for end in ("low", "high"))
    assert low == pytest.approx(0.1) and high == pytest.approx(0.2)
    text = outcomes_tables()[1](make_result("outcomes", ExperimentOptions(), {}, metrics, paper={}, rows=rows))
    assert "| 0.10 (0.10 to 0.20) |" in text and "nan" not in text


def test_objects_have_one_locked_wheel_or_none() -> None:
    drawn = [draw_object(i, 1_000_000) for i in range(60)]
    counts = [sum(c.locked) for c in drawn]
    assert sorted(set(counts)) == [0, 1] and counts.count(1) == 20
    assert all(not any(c.locked[2:]) for c in drawn if c.family == "wheelchair")


@pytest.mark.slow
def test_a_push_of_a_box_is_predicted_and_the_posterior_is_surer_than_the_prior(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A light box.
    seed = next(s for s in range(1_027_000, 1_027_100) if draw_object(0, s).total_mass * draw_object(0, s).friction < 4)
    monkeypatch.setattr(ExperimentOptions, "first_unseen", seed)
    rows = _trial(Setup(ExperimentOptions(), OutcomesConfig(), tmp_path, tmp_path), 0)
    assert len(rows) == 3 and len({r["side"] for r in rows}) == 3
    assert all(r["comes"] and r["known"] and r["robots_comes"] for r in rows)
    assert np.median([r["posterior_position_m"] for r in rows]) < 0.2
    assert np.mean([r["posterior_comes"] for r in rows]) > np.mean([r["prior_comes"] for r in rows]) > 0.3
    draw_figure(tmp_path / "outcomes.png", rows, 0.8)
    assert (tmp_path / "outcomes.png").stat().st_size > 10_000
