"""Writes the measured tables of docs/performance.md from the results in docs/results.

Run: python -m benchmarks.performance_page (with --check: ends with code 1 if the page differs from the results)

    shmoo bench mppi --peers-python peers/bin/python --json docs/results/bench_mppi.json
    shmoo bench demo --json docs/results/bench_demo.json
    shmoo bench navigation --maps MAPS --json docs/results/bench_navigation.json
    shmoo bench mppi --json docs/results/bench_mppi_gpu.json (on a machine with a GPU; also plant)
    python -m benchmarks.rollouts --json docs/results/rollouts.json --figure docs/figures/rollouts.png

The table of the control step uses the result of the short form if there is none of the long form.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from shmoo_mjx.evaluation.result import ExperimentResult, read_result
from shmoo_mjx.report.tables import markdown_table

ROOT = Path(__file__).resolve().parents[1]
PAGE, RESULTS = ROOT / "docs/performance.md", ROOT / "docs/results"
ENGINES = {
    "shipped_ideal_ms": "limit: matrix products of the shipped networks at the machine's rate",
    "ideal_ms": "ideal: 1.53 GFLOP of the paper's networks at the machine's rate",
    "ours_ms": "**ours, shipped networks**",
    "ours_paper_networks_ms": "ours, the paper's widths",
    "plain_jax_ms": "plain JAX, roll-outs",
    "numpy_ms": "NumPy, roll-outs",
    "pytorch_mppi_compiled_ms": "pytorch_mppi compiled, roll-outs",
    "pytorch_mppi_eager_ms": "pytorch_mppi eager, roll-outs",
}
RATIOS = {
    "p99_over_median": "p99 / median",
    "gemm_p99_over_median": "of bare matrix products as long",
    "busy_over_plain_jax": "beside a busy process / plain JAX beside it",
}

SWEEPS = {"samples": "S", "horizon": "T", "problems": "problems in one call"}


def control_step(result: ExperimentResult) -> str:
    """Table of every engine's time, also relative to pytorch_mppi and to the ideal, with further ratios below it."""
    found = {k: v for k in ENGINES if (v := result.metrics.get(k)) is not None}
    eager, ideal = found.get("pytorch_mppi_eager_ms"), found["ideal_ms"]

    def over(value: float, base: float | None) -> str:
        return "" if base is None else f"{value / base:.2f}"

    rows = [
        [ENGINES[k], f"{v:.1f}" if v > 0.1 else f"{v:.2f}", over(v, eager), over(v, ideal)]
        for k, v in sorted(found.items(), key=lambda x: x[1])
    ]
    table = markdown_table(["", "ms", "over pytorch_mppi eager", "over ideal"], rows)
    more = [f"{label} {value:.2f}" for key, label in RATIOS.items() if (value := result.metrics.get(key)) is not None]
    for key, value in result.metrics.items():
        count, found_it, _ = key.partition("_problems_over_")
        more += [f"{count} problems in one call / {count} x one {value:.2f}"] if found_it else []
    steps = next(row["steps"] for row in result.rows if row["kind"] == "worst case")
    worst = f"{steps:,} steps: p99 {result.metrics['ours_p99_ms']:.1f} ms, worst {result.metrics['ours_max_ms']:.1f} ms"
    sweeps = [s for kind, label in SWEEPS.items() if (s := _sweep(result, kind, label))]
    lines = ["; ".join(parts) for parts in ([worst, *more], sweeps) if parts]
    return f"{_machine(result)}\n\n{table}\n\n" + "\n".join(f"- {line}." for line in lines)


def _sweep(result: ExperimentResult, kind: str, label: str) -> str:
    rows = [row for row in result.rows if row["kind"] == f"sweep {kind}"]
    counts = ", ".join(f"{row[kind]:,}" for row in rows)
    return f"{label} = {counts}: {', '.join(f'{row["median_ms"]:,.1f}' for row in rows)} ms" if rows else ""


def demo(result: ExperimentResult) -> str:
    """Table of the demo's time by part with a warm compilation cache, with bars."""
    warm = [row for row in result.rows if row["cache"] == "warm"]
    rows = [[r["name"], f"{r['s']:.1f}", f"{r['share']:.0%}", "█" * round(40 * r["share"])] for r in warm]
    m = result.metrics
    total = f"{m['warm_s']:.1f} s for {m['simulated_time']:.0f} s simulated: {m['ratio_to_simulated_time']:.2f}"
    first = f"with an empty compilation cache {m['first_time_s']:.0f} s"
    return f"{_machine(result)} {total}; {first}.\n\n{markdown_table(['', 's', 'share', ''], rows)}"


def navigation(result: ExperimentResult) -> str:
    """Table with a row per place: time of a trial over its simulated time, and ms per sample of each part."""
    ms = {(row["part"], row["place"]): row["ms_per_sample"] for row in result.rows}
    places = list(dict.fromkeys(place for _, place in ms))
    parts = sorted({part for part, _ in ms}, key=lambda part: -sum(ms.get((part, place), 0.0) for place in places))
    rows = []
    for place in places:
        ratio = result.metrics[f"{place.replace(' ', '_')}_ratio_to_simulated_time"]
        rows.append([place, f"{ratio:.3f}", *(f"{ms.get((part, place), 0.0):.2f}" for part in parts)])
    return f"{_machine(result)}\n\n{markdown_table(['', 'trial / simulated time', *parts], rows)}"


def batches(result: ExperimentResult) -> str:
    """Table of steps per second of batches of worlds, and of C MuJoCo."""
    rows = [
        [row["engine"], *(str(row.get(k, "")) for k in ("batch", "threads", "state")), f"{row['steps_per_s']:,}"]
        for row in result.rows
    ]
    table = markdown_table(["robot + cart", "worlds", "threads", "state", "steps/s"], rows)
    return f"{_machine(result)}\n\n{table}"


def rollouts(result: ExperimentResult) -> str:
    """Table of the cost and time of every variant."""
    from .rollouts import as_table, summary

    pushes = [row for row in result.rows if "cost_m" in row]
    return as_table(summary(pushes, [row for row in result.rows if "cores" in row]))


BLOCKS: dict[str, tuple[tuple[str, ...], Callable[[ExperimentResult], str]]] = {
    "control step": (("bench_mppi.json", "bench_mppi_quick.json"), control_step),
    "control step elsewhere": (("bench_mppi_epyc.json",), control_step),
    "control step on a GPU": (("bench_mppi_gpu.json",), control_step),
    "plant on a GPU": (("bench_plant_gpu.json",), batches),
    "demo": (("bench_demo.json",), demo),
    "navigation": (("bench_navigation.json",), navigation),
    "roll-outs": (("rollouts.json",), rollouts),
}
"""Result files of each block of the page by name, the preferred one first, and the function that writes the block."""


def page(text: str) -> str:
    """The page with each block written from its result. Blocks without a result do not change."""
    for name, (files, make) in BLOCKS.items():
        there = [RESULTS / file for file in files if (RESULTS / file).is_file()]
        if there:
            block = f"<!-- {name} -->\n{make(read_result(there[0]))}\n<!-- end -->"
            text, count = re.subn(f"<!-- {name} -->.*?<!-- end -->", block.replace("\\", r"\\"), text, flags=re.DOTALL)
            if count != 1:
                raise SystemExit(f"{PAGE}: has {count} blocks named {name}, and needs one.")
    return text


def _machine(result: ExperimentResult) -> str:
    made: dict[str, Any] = result.config["machine"]
    card = "" if made["device"] == "cpu" else f", {made['device']}"
    return f"{made['processor']}, {made['cores']} cores{card}{', short form' if result.config.get('quick') else ''}:"


def main() -> None:
    """Write or check the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    args = parser.parse_args()
    old = PAGE.read_text(encoding="utf-8")
    new = page(old)
    if args.check:
        raise SystemExit(int(new != old))
    PAGE.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    main()
