"""The benchmark's work is one and the same for all engines, and its result has every number."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import mppi as bench
from benchmarks import mppi_problem as work
from benchmarks import workers
from benchmarks.registry import BenchOptions, run_benchmark
from shmoo_mjx.errors import ShmooError


def test_the_work_is_the_papers() -> None:
    assert work.flop(500, 30) == pytest.approx(1.53e9, rel=1e-3)
    problem = work.draw(0)
    assert [w.shape[0] for w, _ in problem.robot] == [28, 128, 128, 50]
    assert problem.psi[-1][0].shape == (50, 6)


def test_numpy_and_jax_do_the_same_transition() -> None:
    problem, rng = work.draw(1), np.random.default_rng(0)
    x = rng.standard_normal((4, 31)).astype(np.float32)
    u = rng.standard_normal((4, 3)).astype(np.float32)

    def net(layers: list, h: Any, xp: Any) -> Any:
        for weight, bias in layers[:-1]:
            h = xp.maximum(h @ weight + bias, 0)
        return h @ layers[-1][0] + layers[-1][1]

    def run(xp: Any) -> Any:
        return work.transition(
            xp,
            lambda s: net(problem.robot, s, xp),
            lambda s: net(problem.psi, s, xp) @ problem.coefficients.T,
            x=x,
            u=u,
        )

    np.testing.assert_allclose(run(np), run(jnp), atol=1e-5)
    # Positions move by the new twist, and the memory holds the twist before.
    new = run(np)
    np.testing.assert_allclose(new[:, :3], x[:, :3] + work.DT * new[:, 3:6], atol=1e-6)
    np.testing.assert_array_equal(new[:, 6:9], x[:, 28:])


def test_an_absent_peer_says_so() -> None:
    with pytest.raises(ShmooError, match=r"pytorch_mppi|torch"):
        workers.peer(Path(sys.executable), "pytorch_mppi_eager", samples=10, horizon=2, activation="relu", seed=0)
    with pytest.raises(ShmooError, match="no-such-python"):
        workers.peer(Path("no-such-python"), "numpy", samples=10, horizon=2, activation="relu", seed=0)
    with pytest.raises(ShmooError, match="choose one of startup"):
        run_benchmark("nonsense", BenchOptions())


def test_a_worker_times_what_it_is_asked_to() -> None:
    worker = workers.peer(Path(sys.executable), "numpy", samples=20, horizon=3, activation="tanh", seed=0)
    try:
        for calls in (3, 1):
            seconds, compiled = worker.seconds(calls)
            assert len(seconds) == calls and min(seconds) > 0 and compiled == 0
    finally:
        worker.close()


@pytest.mark.slow
def test_the_whole_benchmark_in_small(monkeypatch: pytest.MonkeyPatch) -> None:
    small = bench.MppiSizes(
        samples=20, horizon=3, rounds=2, calls=3, gemm=256, steps=40, sample_sweep=(20,), horizon_sweep=(3,),
        problem_sweep=(1, 2),
    )  # fmt: skip
    monkeypatch.setattr(bench, "QUICK", small)
    result = run_benchmark("mppi", BenchOptions(quick=True))
    assert result.experiment == "bench_mppi"
    assert result.metrics["pytorch_mppi_eager_ms"] is None and any("absent" in row for row in result.rows)
    # What is compared with the peer is null with it.
    peers = {k: v for k, v in result.metrics.items() if "pytorch_mppi" in k}
    assert len(peers) == 4 and set(peers.values()) == {None}
    assert all(v is not None and v >= 0 for k, v in result.metrics.items() if k not in peers)
    assert result.metrics["recompilations"] == 0 and result.metrics["p99_over_median"] >= 1
    times = {row["problems"]: row["median_ms"] for row in result.rows if row["kind"] == "sweep problems"}
    assert result.metrics["2_problems_over_2_times_one"] == pytest.approx(times[2] / (2 * times[1]))
    assert result.metrics["ratio_to_ideal"] == pytest.approx(result.metrics["ours_ms"] / result.metrics["ideal_ms"])
