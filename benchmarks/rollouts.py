"""Compares numbers of roll-outs S, horizons T and kinds of noise: accuracy of pushing, and time of a control step.

Run: python -m benchmarks.rollouts --json docs/results/rollouts.json --figure docs/figures/rollouts.png
     python -m benchmarks.rollouts --parts times (the clock alone, on a quiet machine; also: trials, report)

Every variant runs the same pushing trials and is compared with S = 500, T = 30 and the shipped noise. Then its control
step is timed on one core and on two. All parts take an hour on two cores. A stopped run continues where it was, and
parts that are not run are taken from the JSON file if it exists.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from contextlib import closing
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.control.mppi_config import MppiConfig
from shmoo_mjx.control.noise import SPARE, bank
from shmoo_mjx.control.presets import pose_push_config
from shmoo_mjx.evaluation.paired import paired_difference
from shmoo_mjx.evaluation.pushing_trials import STRATA, Runner, Trial, draw_trials
from shmoo_mjx.evaluation.result import ExperimentOptions, make_result, read_result, write_result
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.report.style import SERIES, blank_figure, save_figure
from shmoo_mjx.report.tables import markdown_table

from . import peers
from .registry import machine
from .workers import Worker, usable_cores

KINDS = ("shipped", "white", "sobol", "spline")
"""Kinds of noise: coloured noise as shipped; independent noise; the shipped noise from a low-discrepancy sequence;
independent knots with a smooth curve through them. All kinds come in mirrored pairs."""
ROLLOUTS = (500, 128, 64, 256, 32, 1000)
COMPARED = (500, 128)
"""Numbers of roll-outs with which the other kinds of noise are compared."""
HORIZONS = ((64, 20), (128, 10), (128, 20), (128, 50), (500, 20))
"""Pairs (S, T) of the shipped noise, in addition to those with T = 30."""
KNOTS = 6
MODULE = "benchmarks.rollouts"
YAW_WEIGHT = 0.6
"""Position error that a yaw error of 1 rad equals, as in the cost of a push to a pose [m/rad]."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Noise(MppiConfig):
    """Settings of MPPI with another kind of noise of the same standard deviation."""

    kind: str = KINDS[0]
    """One of `KINDS`."""


@bank.register
def _(cfg: Noise) -> np.ndarray:
    if cfg.kind in ("shipped", "white"):
        correlation = cfg.noise_correlation if cfg.kind == "shipped" else 0.0
        settings = {f.name: getattr(cfg, f.name) for f in fields(MppiConfig)} | {"noise_correlation": correlation}
        return bank(MppiConfig(**settings))
    count = (cfg.num_rollouts + 1) // 2 + SPARE
    if cfg.kind == "sobol":
        steps = np.arange(cfg.horizon)
        values, vectors = np.linalg.eigh(cfg.noise_correlation ** np.abs(steps[:, None] - steps))
        # The largest components come first, because the first dimensions of the sequence are its best.
        shape = (vectors * np.sqrt(np.maximum(values, 0.0)))[:, ::-1]
        drawn = _sobol(count, cfg.horizon * cfg.controls)
    else:
        shape = _spline(cfg.horizon)
        drawn = np.random.default_rng(0).standard_normal((count, KNOTS * cfg.controls))
    drawn = drawn.reshape(count, shape.shape[1], cfg.controls)
    return np.asarray(np.einsum("tk,skm->stm", shape, drawn) * cfg.sigma, dtype=np.float32)


def _sobol(count: int, dimensions: int) -> np.ndarray:
    """Standard normal numbers ``[count, dimensions]`` from Sobol's sequence."""
    from scipy.stats import norm, qmc

    sequence = qmc.Sobol(dimensions, scramble=True, rng=0)
    points = sequence.random_base2(int(np.ceil(np.log2(count))))[:count]
    return norm.ppf(np.clip(points, 1e-6, 1 - 1e-6))


def _spline(horizon: int) -> np.ndarray:
    """Weights ``[T, KNOTS]`` of the knots in a cubic spline, with unit variance at each step."""
    from scipy.interpolate import CubicSpline

    weights = CubicSpline(np.linspace(0, 1, KNOTS), np.eye(KNOTS))(np.linspace(0, 1, horizon))
    return weights / np.linalg.norm(weights, axis=1, keepdims=True)


@dataclass(frozen=True)
class Variant:
    """Noise, number of roll-outs and horizon of a planner."""

    kind: str
    rollouts: int
    horizon: int = 30

    @property
    def name(self) -> str:
        """Short unique name, which serves as a file name."""
        return f"{self.kind}-S{self.rollouts}-T{self.horizon}"

    def config(self) -> Any:
        """The settings of a push to a pose with this variant."""
        base = pose_push_config()
        control = asdict(base.control) | {"num_rollouts": self.rollouts, "horizon": self.horizon, "kind": self.kind}
        return replace(base, control=Noise(**control))


SHIPPED = Variant(KINDS[0], 500)
VARIANTS = (
    *(Variant(KINDS[0], s) for s in ROLLOUTS),
    *(Variant(KINDS[0], s, t) for s, t in HORIZONS),
    *(Variant(k, s) for k in KINDS[1:] for s in COMPARED),
)


def draw(condition_seed: int, runs: int) -> list[Trial]:
    """Trials of movable and demanding objects, ``runs`` of each family, to the two goals that need steering."""
    first = ExperimentOptions(condition_seed=condition_seed).first_unseen
    return [trial for stratum in STRATA[:2] for trial in draw_trials(first, 0, runs, goals=(2, 3), stratum=stratum)]


def push(trials: list[Trial], variant: Variant) -> list[Row]:
    """The rows of all trials of one variant. ``cost_m`` is the error of the final pose as in the cost of a push."""
    from shmoo_mjx.learning.weights import load_weights

    runner = Runner(load_weights(asset(WEIGHTS)), 120.0, config=variant.config())
    rows = []
    for trial in trials:
        row = runner.run(trial, "ours")[0]
        cost = float(np.hypot(row["offset_m"], YAW_WEIGHT * np.deg2rad(row["yaw_error_deg"])))
        kept = {k: row[k] for k in ("trial", "offset_m", "yaw_error_deg", "success", "fell", "time_s", "pushes")}
        rows.append({"variant": variant.name} | kept | {"cost_m": cost})
    return rows


def clock(variant: Variant, cores: int, steps: int) -> Row:
    """The row of the durations of ``steps`` control steps in a process that has ``cores`` cores."""
    asked = json.dumps([variant.kind, variant.rollouts, variant.horizon, cores])
    with closing(Worker([sys.executable, "-P", "-m", MODULE, "--serve", asked], cores)) as worker:
        worker.seconds(20)
        ms = 1e3 * np.asarray(worker.seconds(steps)[0])
    found = {"median_ms": float(np.median(ms)), "p99_ms": float(np.quantile(ms, 0.99))}
    return {"variant": variant.name, "cores": cores, "steps": steps} | found


def serve(asked: str) -> None:
    """Serve the control step of one variant to a `Worker`."""
    kind, rollouts, horizon, cores = json.loads(asked)
    # Restrict the cores before JAX counts them.
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    from shmoo_mjx.learning.weights import load_weights

    from .engines import ours

    step = ours(load_weights(asset(WEIGHTS)), Variant(kind, rollouts, horizon).config(), 0)
    for _ in range(3):
        step()
    peers.serve(step, {"cores": cores})


def summary(rows: list[Row], times: list[Row]) -> list[Row]:
    """One row per variant: cost of its trials, difference from the cost of the shipped variant, and times."""
    of = {v.name: {r["trial"]: r for r in rows if r["variant"] == v.name} for v in VARIANTS}
    base, found = of[SHIPPED.name], []
    for variant in VARIANTS:
        mine = of[variant.name]
        line: Row = {"name": variant.name, "kind": variant.kind, "S": variant.rollouts, "T": variant.horizon}
        if mine:
            line |= {"cost_m": float(np.mean([r["cost_m"] for r in mine.values()])), "trials": len(mine)}
            line |= {"success": float(np.mean([r["success"] for r in mine.values()]))}
            both = [t for t in base if t in mine]
            pair = paired_difference([mine[t]["cost_m"] for t in both], [base[t]["cost_m"] for t in both])
            line |= {} if pair is None else {"more_m": pair.mean, "more_low_m": pair.low, "more_high_m": pair.high}
        # Noise is drawn in advance, so all kinds take the same time.
        timed = replace(variant, kind=KINDS[0]).name
        for row in (t for t in times if t["variant"] == timed):
            line |= {f"{key}_{row['cores']}_cores": row[key] for key in ("median_ms", "p99_ms")}
        found.append(line)
    return found


def as_table(lines: list[Row]) -> str:
    """The summary as a Markdown table."""

    def cell(line: Row, *keys: str, form: str = ".3f") -> str:
        return ", ".join(format(line[k], form) for k in keys if k in line)

    head = ["noise", "S", "T", "cost [m]", "minus shipped [m]", "success", "1 core, p99 [ms]", "2 cores, p99 [ms]"]
    body = []
    measured = [line for line in lines if {"cost_m", "median_ms_1_cores"} & set(line)]
    for line in sorted(measured, key=lambda x: (KINDS.index(x["kind"]), x["T"], x["S"])):
        apart = (
            f"{line['more_m']:+.3f} ({line['more_low_m']:.3f} to {line['more_high_m']:.3f})" if "more_m" in line else ""
        )
        times = [cell(line, f"median_ms_{n}_cores", f"p99_ms_{n}_cores", form=".1f") for n in (1, 2)]
        row = [
            line["kind"],
            str(line["S"]),
            str(line["T"]),
            cell(line, "cost_m"),
            apart,
            cell(line, "success", form=".2f"),
        ]
        body.append(row + times)
    return markdown_table(head, body)


def draw_figure(path: Path, lines: list[Row]) -> None:
    """Draw the cost over S by kind of noise with the intervals of the differences, and over the time of a step."""
    figure = blank_figure(10.0, 4.2)
    left, right = figure.subplots(1, 2, sharey=True)
    reference = next(line["cost_m"] for line in lines if line["name"] == SHIPPED.name)
    for i, (kind, colour) in enumerate(zip(KINDS, SERIES, strict=False)):
        mine = sorted((x for x in lines if x["kind"] == kind and x["T"] == 30 and "more_m" in x), key=lambda x: x["S"])
        x = np.array([line["S"] for line in mine]) * 1.03**i
        y, low, high = (
            reference + np.array([line[k] for line in mine]) for k in ("more_m", "more_low_m", "more_high_m")
        )
        left.errorbar(x, y, [y - low, high - y], marker="o", ms=4, capsize=2, color=colour, label=kind)
    for line in (x for x in lines if x["kind"] == KINDS[0] and {"cost_m", "median_ms_1_cores"} <= set(x)):
        right.plot(line["median_ms_1_cores"], line["cost_m"], "o", color=SERIES[0])
        right.annotate(f"{line['S']} x {line['T']}", (line["median_ms_1_cores"], line["cost_m"]), (4, 4),
                       textcoords="offset points", fontsize=7)  # fmt: skip
    left.set(xscale="log", xlabel="roll-outs S, T = 30", ylabel="error of the final pose [m]", xticks=sorted(ROLLOUTS))
    left.set_xticklabels([str(s) for s in sorted(ROLLOUTS)])
    left.minorticks_off()
    left.legend(fontsize=8)
    right.set(xscale="log", xlabel="control step on one core [ms], shipped noise, S x T", xlim=(1.8, 40))
    right.set_xticks([2, 5, 10, 20], ["2", "5", "10", "20"])
    right.minorticks_off()
    save_figure(path, figure, 110)


def main() -> None:
    """Run the requested parts that are not done yet, and write the result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--parts", nargs="+", choices=("trials", "times", "report"), default=("trials", "times", "report")
    )
    parser.add_argument("--condition-seed", type=int, default=21, help="draws the objects")
    parser.add_argument("--runs", type=int, default=2, help="objects per family and stratum, each pushed to two goals")
    parser.add_argument("--steps", type=int, default=1000, help="control steps per time")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/rollouts"), help="folder of what is done")
    parser.add_argument("--json", type=Path, default=Path("runs/rollouts/rollouts.json"))
    parser.add_argument("--figure", type=Path, default=Path("runs/rollouts/rollouts.png"))
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.serve:
        serve(args.serve)
        return
    say = lambda stage, share: print(f"{100 * share:3.0f} %  {stage}", flush=True)  # noqa: E731
    trials = draw(args.condition_seed, args.runs)
    settings = {"knots": KNOTS, "yaw_weight": YAW_WEIGHT, "config": asdict(pose_push_config())}
    drawn = [t.name for t in trials]
    folder = args.out / fingerprint(Runner.__module__, (settings, args.condition_seed, drawn), asset(WEIGHTS))
    if "trials" in args.parts:
        run_trials({v.name: v for v in VARIANTS}, partial(push, trials), folder, say, workers=args.workers)
    timed = [v for v in VARIANTS if v.kind == KINDS[0]]
    asked = {f"{v.name}-{n}-cores-{args.steps}": (v, n) for v in timed for n in (1, 2) if n <= usable_cores()}
    if "times" in args.parts:
        run_trials(asked, partial(_clocked, args.steps), folder / "times", say, workers=1)
    rows = _read(args.json, folder, [v.name for v in VARIANTS], "cost_m", condition_seed=args.condition_seed)
    times = _read(args.json, folder / "times", list(asked), "cores", condition_seed=args.condition_seed)
    lines = summary(rows, times)
    options = ExperimentOptions(condition_seed=args.condition_seed)
    metrics = {f"{x['name']}_{k}": v for x in lines for k, v in x.items() if isinstance(v, float)}
    result = make_result("rollouts", options, settings | {"machine": machine()}, metrics, paper={}, rows=rows + times)
    write_result(args.json, result)
    if any(row["variant"] == SHIPPED.name for row in rows):
        draw_figure(args.figure, lines)
    print(as_table(lines))


def _clocked(steps: int, asked: tuple[Variant, int]) -> list[Row]:
    return [clock(*asked, steps)]


def _read(saved: Path, folder: Path, names: list[str], key: str, *, condition_seed: int) -> list[Row]:
    """The rows in ``folder`` under ``names``, and rows with ``key`` of other variants from the JSON ``saved``."""
    files = [path for name in names if (path := folder / f"{name}.json").is_file()]
    rows = [row for path in files for row in json.loads(path.read_text())]
    old = read_result(saved) if saved.is_file() else None
    if old is None or old.config["condition_seed"] != condition_seed:
        return rows
    new = {(row["variant"], row.get("cores")) for row in rows}
    return rows + [row for row in old.rows if key in row and (row["variant"], row.get("cores")) not in new]


if __name__ == "__main__":
    main()
