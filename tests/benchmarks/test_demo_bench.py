"""The demo's time is divided into parts that add up."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from benchmarks import demo
from benchmarks.registry import BenchOptions, run_benchmark


def test_a_part_does_not_count_what_is_inside_it() -> None:
    clock = demo.PartClock()
    inner = clock.timed("inner", lambda: time.sleep(0.05))

    def work() -> None:
        time.sleep(0.02)
        inner()
        time.sleep(0.03)
        clock.add("compiled", 0.03)  # what JAX says afterwards

    began = time.perf_counter()
    clock.timed("outer", work)()
    took = time.perf_counter() - began
    assert clock.seconds["inner"] >= 0.05 and clock.seconds["compiled"] == 0.03
    assert sum(clock.seconds.values()) == pytest.approx(took, abs=1e-3)
    assert clock.seconds["outer"] == pytest.approx(took - clock.seconds["inner"] - 0.03, abs=1e-3)


def test_a_part_that_fails_is_left() -> None:
    clock = demo.PartClock()

    def broken() -> None:
        raise ValueError

    with pytest.raises(ValueError):
        clock.timed("broken", broken)()
    assert "broken" in clock.seconds and len(clock.inside) == 1


@pytest.mark.slow
def test_every_part_of_the_demo_is_met(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "QUICK", replace(demo.QUICK, time_s=12.0))
    result = run_benchmark("demo", BenchOptions(quick=True))
    warm = {row["name"]: row["s"] for row in result.rows if row["cache"] == "warm"}
    assert set(warm) == {*demo.PARTS, demo.COMPILATION, demo.START, demo.REST}
    assert all(seconds > 0 for seconds in warm.values())
    assert sum(warm.values()) == pytest.approx(result.metrics["warm_s"])
    assert result.metrics["ratio_to_simulated_time"] == pytest.approx(result.metrics["warm_s"] / 12.0, rel=0.05)
