"""Steps per second, compile time and memory of the plant with its control: C MuJoCo and MJX, by scene and batch.

Run: python benchmarks/plant_speed.py [--scene robot box cart wheelchair room] [--batch 1 64 512] [--json speed.json]
     python benchmarks/plant_speed.py --scene boxes0 boxes1 boxes2 boxes4 boxes6 --batch 64  (cost by number)
     python benchmarks/plant_speed.py --batch 512 2048 8192 32768  (a GPU, if JAX has one)

One step is 2 ms with its control. On a CPU, MJX parts the worlds over as many devices as there are cores.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any


def main() -> None:
    """Print one JSON line per row, and write them all to a file if asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--engine", nargs="+", choices=["c", "mjx"], default=["c", "mjx"])
    parser.add_argument("--impl", choices=["jax", "warp"], default="jax", help="back end of MJX; warp needs a GPU")
    parser.add_argument("--scene", nargs="+", default=["robot", "box", "cart", "wheelchair", "room"])
    parser.add_argument("--batch", nargs="+", type=int, default=[1, 64, 512])
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "shmoo_mjx" / "jax"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    os.environ.setdefault("XLA_FLAGS", f"--xla_force_host_platform_device_count={args.threads}")
    from shmoo_mjx.benchmarking.plant import c_rows, mjx_rows
    from shmoo_mjx.errors import ShmooError
    from shmoo_mjx.plant.engine_mjx import check_backend

    try:
        check_backend(args.impl)
    except ShmooError as error:
        parser.error(str(error))

    rows: list[dict[str, Any]] = []
    for name in args.scene:
        c_rates: dict[tuple[str, int], float] = {}
        if "c" in args.engine:
            for row in c_rows(name, args.threads, args.seconds):
                c_rates[row["state"], row["threads"]] = row["steps_per_s"]
                rows.append(row)
                print(json.dumps(row), flush=True)
        for batch in args.batch if "mjx" in args.engine else []:
            for row in mjx_rows(name, batch, args.seconds, c_rates, args.impl):
                rows.append(row)
                print(json.dumps(row), flush=True)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
