"""A navigation trial's time is divided into parts that add up, and is a fraction of the time that it simulates."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import navigation
from benchmarks.parts import PARTS
from benchmarks.registry import BenchOptions, run_benchmark

MAPS = Path(__file__).resolve().parents[2] / "experiments/maps"
MET = {"physics", "low-level control, 500 Hz", "senses", "navigator, the rest", navigation.REST}


@pytest.mark.slow
def test_trials_are_much_faster_than_what_they_simulate() -> None:
    result = run_benchmark("navigation", BenchOptions(quick=True, maps=MAPS))
    for place in (navigation.DEMO, "office"):
        name, rows = place.replace(" ", "_"), [row for row in result.rows if row["place"] == place]
        assert {row["part"] for row in rows} >= MET and {row["part"] for row in rows} <= {*PARTS, navigation.REST} | {
            "tracing and compilation"
        }
        simulated, ratio = (result.metrics[f"{name}_{what}"] for what in ("simulated_s", "ratio_to_simulated_time"))
        assert 0 < simulated <= 10.0
        assert sum(row["s"] for row in rows) == pytest.approx(ratio * simulated, rel=1e-6)
        # Some 0.1 to 0.2 on a quiet core; a decision that took seconds would show even beside other work.
        assert ratio < 1.0
