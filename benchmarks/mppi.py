"""Duration of a control step of ours, pytorch_mppi, NumPy and plain JAX, and the minimum that the machine needs.

Every engine is a process of its own on the same cores. The engines take turns in short rounds, so that other load on
the machine affects all of them alike. Each figure is a median. The peers compute the two networks, sampling, Eq. 9 and
the update. Ours computes the whole step from observation to command, with adaptation, features, contact rules and the
map.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from shmoo_mjx.errors import ShmooError

from . import mppi_problem, workers
from .registry import BenchOptions, Measured
from .workers import Worker, busy_neighbour, usable_cores


@dataclass(frozen=True)
class MppiSizes:
    """Sizes of the benchmark."""

    samples: int = 500
    horizon: int = 30
    activation: str = "relu"
    """Activation of the networks of every engine, the same as that of the shipped weights."""
    rounds: int = 12
    calls: int = 25
    """Control steps of each engine per round."""
    gemm: int = 4096
    """Side of the matrices whose product measures the rate of the machine."""
    steps: int = 10_000
    """Consecutive control steps for the worst case, on a quiet machine and beside a busy process."""
    sample_sweep: tuple[int, ...] = (100, 500, 2_000, 10_000, 100_000)
    horizon_sweep: tuple[int, ...] = (10, 30, 50, 100)
    problem_sweep: tuple[int, ...] = (1, 4, 16, 64)


FULL = MppiSizes()
QUICK = MppiSizes(rounds=3, calls=10, gemm=2048, steps=200, sample_sweep=(), horizon_sweep=(), problem_sweep=())
"""Sizes that take two minutes on two quiet cores, without sweeps."""
GPU = MppiSizes(
    rounds=4, steps=2_000, sample_sweep=(500, 10_000, 100_000), horizon_sweep=(30,), problem_sweep=(1, 64, 512)
)

_JITTER = 1024
"""Side of the matrices whose product takes about as long as a control step. The spread of its times is that of the
machine itself."""
_PAUSE = 0.2
"""Pause between the turns of two engines [s]. Threads of BLAS and OpenMP spin for a while after their work."""

Row = dict[str, Any]


def run(cfg: MppiSizes, options: BenchOptions) -> Measured:
    """Times of all engines. The metrics of peers that are not installed are null, and a row gives the reason."""
    python = options.peers_python or Path(sys.executable)
    turns, about = _take_turns(cfg, _starters(cfg, options.seed, python), options.progress)
    medians = {name: 1e3 * float(np.median(s)) for name, s in turns.items() if s}
    worst = [_worst_case(cfg, options, busy) for busy in (False, True)]
    sweep = _sweeps(cfg, options)
    metrics = _metrics(cfg, medians, about, worst) | _batch_metrics(sweep)
    rows = [_row(name, seconds, about[name]) for name, seconds in turns.items()]
    setup: Row = {"cores": usable_cores(), "device": about["ours"]["device"]}
    setup |= {"flop": mppi_problem.flop(cfg.samples, cfg.horizon)}
    return Measured(metrics, [*rows, *worst, *sweep], setup)


def _starters(cfg: MppiSizes, seed: int, python: Path) -> dict[str, Callable[[], Worker]]:
    """Functions that start each engine."""

    on_cpu = jax.default_backend() == "cpu"

    def own(engine: str, devices: int | None = None, samples: int = cfg.samples) -> Callable[[], Worker]:
        return lambda: workers.ours(_spec(cfg, seed, engine=engine, samples=samples), devices)

    def other(engine: str, by: Path, samples: int = cfg.samples) -> Callable[[], Worker]:
        device = "cpu" if on_cpu else "cuda"
        return lambda: workers.peer(
            by, engine, samples=samples, horizon=cfg.horizon, activation=cfg.activation, seed=seed, device=device
        )

    return {
        "ours": own("ours"),
        "ours_paper": own("ours_paper"),
        "plain_jax": own("plain_jax", 1),
        "numpy": other("numpy", Path(sys.executable)),
        "gemm": other("gemm", Path(sys.executable), cfg.gemm) if on_cpu else own("gemm", 1, cfg.gemm),
        "pytorch_mppi_eager": other("pytorch_mppi_eager", python),
        "pytorch_mppi_compiled": other("pytorch_mppi_compiled", python),
    }


def _spec(cfg: MppiSizes, seed: int, **changes: Any) -> Row:
    spec = {"samples": cfg.samples, "horizon": cfg.horizon, "activation": cfg.activation, "problems": 1, "seed": seed}
    return spec | changes


def _take_turns(
    cfg: MppiSizes, starters: dict[str, Callable[[], Worker]], progress: Callable[[str, float], None]
) -> tuple[dict[str, list[float]], dict[str, Row]]:
    """Run the engines in interleaved rounds.

    Returns:
        Durations of all steps of each engine [s], and what each engine reports about itself. An absent peer has no
        durations and reports the reason.
    """
    running: dict[str, Worker] = {}
    about: dict[str, Row] = {}
    turns: dict[str, list[float]] = {name: [] for name in starters}
    with ExitStack() as stack:
        for name, start in starters.items():
            progress(f"start {name}", 0.0)
            try:
                running[name] = stack.enter_context(closing(start()))
                about[name] = running[name].about
            except ShmooError as error:
                if not name.startswith("pytorch_mppi"):
                    raise
                about[name] = {"absent": f"{name} is absent: {error}"}
        for i in range(cfg.rounds):
            progress("rounds", i / cfg.rounds)
            for name, worker in running.items():
                time.sleep(_PAUSE)
                worker.seconds(2)  # caches and clocks still belong to the previous engine
                turns[name] += worker.seconds(1 if name == "gemm" else cfg.calls)[0]
    return turns, about


def _worst_case(cfg: MppiSizes, options: BenchOptions, busy: bool) -> Row:
    """The row of many consecutive steps of ours.

    Beside a busy process, plain JAX runs too, as the reference for one free core.
    """
    with ExitStack() as stack:
        ours = stack.enter_context(closing(workers.ours(_spec(cfg, options.seed, engine="ours"))))
        if not busy:
            row = _many(cfg, options, ours, "quiet")
            bare = workers.peer(
                Path(sys.executable),
                "gemm",
                samples=_JITTER,
                horizon=cfg.horizon,
                activation=cfg.activation,
                seed=options.seed,
            )
            ms = 1e3 * np.asarray(stack.enter_context(closing(bare)).seconds(max(cfg.steps // 4, 20))[0])
            return row | {"gemm_p99_over_median": np.quantile(ms, 0.99) / np.median(ms)}
        plain = stack.enter_context(closing(workers.ours(_spec(cfg, options.seed, engine="plain_jax"), 1)))
        stack.enter_context(busy_neighbour())
        row = _many(cfg, options, ours, "busy")
        return row | {"plain_jax_ms": 1e3 * float(np.median(plain.seconds(max(cfg.steps // 20, 20))[0]))}


def _many(cfg: MppiSizes, options: BenchOptions, worker: Worker, name: str) -> Row:
    seconds: list[float] = []
    chunk = max(cfg.steps // 20, 1)
    while len(seconds) < cfg.steps:
        options.progress(f"{cfg.steps} steps, {name}", len(seconds) / cfg.steps)
        some, compiled = worker.seconds(chunk)
        seconds += some
        if compiled:
            raise RuntimeError(f"the control step was compiled {compiled} times again while it ran")
    ms = 1e3 * np.asarray(seconds)
    over = int(np.sum(ms > 50.0))
    row = {"kind": "worst case", "name": name, "steps": len(ms), "median_ms": np.median(ms), "max_ms": ms.max()}
    return row | {"p99_ms": np.quantile(ms, 0.99), "over_50_ms": over, "recompilations": compiled}


def _sweeps(cfg: MppiSizes, options: BenchOptions) -> list[Row]:
    """Rows of the step's duration by number of samples, by horizon, and by number of problems planned in one call."""
    wanted = [("samples", {"engine": "ours", "samples": s}) for s in cfg.sample_sweep]
    wanted += [("horizon", {"engine": "ours", "horizon": t}) for t in cfg.horizon_sweep]
    wanted += [("problems", {"engine": "batch", "problems": p}) for p in cfg.problem_sweep]
    rows = []
    for i, (kind, changes) in enumerate(wanted):
        options.progress("sweeps", i / len(wanted))
        with closing(workers.ours(_spec(cfg, options.seed, **changes))) as worker:
            once = min(worker.seconds(1)[0])
            calls = int(np.clip(3.0 / once, 3, 2 * cfg.calls))
            rows.append(_row(kind, worker.seconds(calls)[0], worker.about) | {"kind": f"sweep {kind}"} | changes)
    return rows


def _row(name: str, seconds: list[float], about: Row) -> Row:
    ms = 1e3 * np.asarray(seconds)
    row = {"kind": "engine", "name": name, "calls": len(ms)} | about
    if not len(ms):
        return row
    return row | {"median_ms": np.median(ms), "min_ms": ms.min(), "p90_ms": np.quantile(ms, 0.9)}


def _metrics(cfg: MppiSizes, medians: dict[str, float], about: dict[str, Row], worst: list[Row]) -> Row:
    rate = 2 * cfg.gemm**3 / (1e-3 * medians["gemm"])
    ours, ideal = medians["ours"], 1e3 * mppi_problem.flop(cfg.samples, cfg.horizon) / rate
    shipped = 1e3 * _shipped_flop(cfg.samples, cfg.horizon) / rate
    eager, compiled = medians.get("pytorch_mppi_eager"), medians.get("pytorch_mppi_compiled")
    quiet, busy = worst
    return {
        "ours_ms": ours,
        "ours_p99_ms": quiet["p99_ms"],
        "ours_max_ms": quiet["max_ms"],
        "ours_paper_networks_ms": medians["ours_paper"],
        "pytorch_mppi_eager_ms": eager,
        "pytorch_mppi_compiled_ms": compiled,
        "numpy_ms": medians["numpy"],
        "plain_jax_ms": medians["plain_jax"],
        "ideal_ms": ideal,
        "shipped_ideal_ms": shipped,
        "gemm_gflops": rate / 1e9,
        "ratio_to_pytorch_mppi_eager": ours / eager if eager else None,
        "ratio_to_plain_jax": ours / medians["plain_jax"],
        "ratio_to_ideal": ours / ideal,
        "ratio_to_shipped_ideal": ours / shipped,
        "ratio_paper_networks_to_pytorch_mppi_eager": medians["ours_paper"] / eager if eager else None,
        "ratio_paper_networks_to_plain_jax": medians["ours_paper"] / medians["plain_jax"],
        "ratio_paper_networks_to_ideal": medians["ours_paper"] / ideal,
        "steps_over_50_ms": quiet["over_50_ms"],
        "busy_ms": busy["median_ms"],
        "busy_p99_ms": busy["p99_ms"],
        "busy_max_ms": busy["max_ms"],
        "busy_plain_jax_ms": busy["plain_jax_ms"],
        "recompilations": quiet["recompilations"] + busy["recompilations"],
        "first_step_s": about["ours"]["first_s"],
        "p99_over_median": quiet["p99_ms"] / quiet["median_ms"],
        "gemm_p99_over_median": quiet["gemm_p99_over_median"],
        "busy_over_plain_jax": busy["median_ms"] / busy["plain_jax_ms"],
    }


def _shipped_flop(samples: int, horizon: int) -> int:
    """Floating point operations of the shipped networks' matrix products in the roll-outs of one step."""
    from shmoo_mjx.dynamics import object_model, robot_model
    from shmoo_mjx.learning.weights import load_weights

    params, config = (weights := load_weights()).params, weights.config
    thing = object_model.fuse(params.object, params.coefficients, config.object, params.contact).layers
    matrices = [x for x in jax.tree.leaves((robot_model.fuse(params.robot), thing)) if x.ndim == 2]
    return 2 * samples * horizon * sum(x.size for x in matrices)


def _batch_metrics(sweep: list[Row]) -> Row:
    """Time of the most problems in one call, divided by the time of as many calls with one problem."""
    of = {row["problems"]: row["median_ms"] for row in sweep if row["kind"] == "sweep problems"}
    most = max(of, default=0)
    return {f"{most}_problems_over_{most}_times_one": of[most] / (most * of[1])} if most > 1 and 1 in of else {}
