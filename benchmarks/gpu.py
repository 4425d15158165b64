"""What a GPU is for: control steps of many roll-outs or problems, MJX and MJX Warp in batches, training.

Run: python benchmarks/gpu.py [mppi plant daiml] --out docs/results [--peers-python PYTHON]

Writes bench_NAME_gpu.json for each; benchmarks/performance_page.py makes docs/performance.md's tables of the first two.
Without a GPU it measures the CPU, and says so in each result's config.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from shmoo_mjx.base.environment import prepare_environment

prepare_environment()

from shmoo_mjx.benchmarking import daiml, mppi, plant  # noqa: E402 (JAX reads the environment when it is imported)
from shmoo_mjx.benchmarking.registry import BenchOptions, describe, run_benchmark  # noqa: E402
from shmoo_mjx.evaluation.result import write_result  # noqa: E402

SIZES = {
    "mppi": mppi.MppiSizes(
        rounds=4, steps=2_000, sample_sweep=(500, 10_000, 100_000), horizon_sweep=(30,), problem_sweep=(1, 64, 512)
    ),
    "plant": plant.PlantSizes(scenes=("cart",), batches=(512, 8192)),
    "daiml": daiml.DaimlSizes(epochs=0, conditions=(480,), whole=False),
}


def _report(stage: str, fraction: float) -> None:
    print(f"{fraction:5.0%} {stage}", end="\r", file=sys.stderr, flush=True)


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=list(SIZES))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--peers-python", type=Path)
    args = parser.parse_args()
    if not set(args.names) <= set(SIZES):
        parser.error(f"choose of {', '.join(SIZES)}")
    for name in args.names:
        options = BenchOptions(peers_python=args.peers_python, progress=_report)
        result = run_benchmark(name, options, SIZES[name])
        write_result(args.out / f"bench_{name}_gpu.json", result)
        print(describe(result), flush=True)


if __name__ == "__main__":
    main()
