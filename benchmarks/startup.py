"""Waiting times of a user: ``shmoo --help``, and the demo's first control steps with a warm compilation cache."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from .registry import BenchOptions, Measured

HELP = [sys.executable, "-c", "from shmoo_mjx.cli import main; main()", "--help"]
"""Command that does the same as ``shmoo --help``."""


@dataclass(frozen=True)
class StartupSizes:
    """Sizes of the benchmark."""

    helps: int = 15
    """Number of runs of ``shmoo --help``."""
    demos: int = 3
    """Number of starts of the demo, after one that fills the cache."""


FULL = StartupSizes()
QUICK = StartupSizes(helps=5, demos=1)


def help_seconds() -> tuple[float, float]:
    """Wall-clock time and processor time of ``shmoo --help`` [s]."""
    before, began = os.times(), time.perf_counter()
    subprocess.run(HELP, check=True, stdout=subprocess.DEVNULL)
    took, after = time.perf_counter() - began, os.times()
    own = after.children_user - before.children_user + after.children_system - before.children_system
    return took, own


def run(cfg: StartupSizes, options: BenchOptions) -> Measured:
    """Times of several starts of each command, in processes of their own."""
    rows: list[dict[str, Any]] = []
    for i in range(cfg.helps):
        options.progress("shmoo --help", 0.2 * i / cfg.helps)
        clock, processor = help_seconds()
        rows.append({"name": "help", "s": clock, "processor_s": processor})
    for i in range(cfg.demos + 1):
        options.progress("first control steps of the demo", 0.2 + 0.8 * i / (cfg.demos + 1))
        rows.append({"name": "demo", "cache": "warm" if i else "as found"} | _first_steps(options.seed))
    shown = [row for row in rows if row["name"] == "help"]
    warm = [row for row in rows if row.get("cache") == "warm"]
    metrics = {
        "help_s": np.median([row["s"] for row in shown]),
        "help_processor_s": np.median([row["processor_s"] for row in shown]),
        "first_command_s": np.median([row["drive_s"] for row in warm]),
        "first_push_command_s": np.median([row["push_s"] for row in warm]),
    }
    return Measured(metrics, rows)


def _first_steps(seed: int) -> dict[str, float]:
    command = [sys.executable, "-m", f"{__package__}.first_step", str(seed)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return {f"{name}_s": seconds for name, seconds in json.loads(done.stdout.splitlines()[-1]).items()}
