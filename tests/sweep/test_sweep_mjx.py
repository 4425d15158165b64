"""The real thing, small: MJX worlds on two devices, in little memory, killed, and by jobs, all give the same rows."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shmoo_mjx.sweep.run import read_table

SWEEP = """
question: does it run?
worlds: 5
shard: 3
seconds: 5
controllers: {plain: {kind: quasi_static}}
vary:
  object.mass: {log_uniform: [2, 20]}
  object.friction: {uniform: [0.1, 0.4]}
  object.payload: 0
  goal.distance: 0.3
  noise.position: 0.003
  delay.command: {choice: [0, 0.04]}
  delay.camera: 0.05
map: [object.mass, object.friction]
"""
pytestmark = pytest.mark.slow


def command(path: Path, out: Path, *more: str) -> list[str]:
    main = "from shmoo_mjx.cli import main; main()"
    return [sys.executable, "-c", main, "sweep", str(path), "--out", str(out), *more]


def with_devices(count: int) -> dict[str, str]:
    return os.environ | {"JAX_NUM_CPU_DEVICES": str(count), "XLA_FLAGS": "", "JAX_PLATFORMS": "cpu"}


def compare(one: dict[str, list[Any]], other: dict[str, list[Any]]) -> None:
    assert list(one) == list(other)
    for name, values in one.items():
        if isinstance(values[0], float) and not name.startswith(("object.", "robot.", "gains.", "noise.", "goal.")):
            # Batches of other sizes round otherwise, and contact makes more of it.
            np.testing.assert_allclose(values, other[name], atol=0.02, rtol=0.02, err_msg=name)
        else:
            assert values == other[name], name


def test_devices_memory_kills_and_jobs_leave_the_rows_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "small.yaml"
    path.write_text(SWEEP)
    said = subprocess.run(
        command(path, tmp_path / "two", "--memory-gb", "1e-6"),
        env=with_devices(2), check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    assert "5 worlds in batches of 2" in said and "on 2 x cpu" in said
    two = read_table(tmp_path / "two" / "results.parquet")
    assert two["world"] == [0, 1, 2, 3, 4] and set(two["outcome"]) >= {"success"}
    assert {p.name for p in (tmp_path / "two").glob("*.png")} == {"parameters.png", "map.png"}

    process = subprocess.Popen(command(path, tmp_path / "one"), env=with_devices(1))
    until = time.monotonic() + 540
    while not list((tmp_path / "one").glob("shards/*.parquet")) and time.monotonic() < until:
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL and not (tmp_path / "one" / "results.parquet").exists()
    said = subprocess.run(
        command(path, tmp_path / "one"), env=with_devices(1), check=True, capture_output=True, text=True
    ).stdout
    assert "1 of 2 shards are there" in said and "2 worlds in batches of 3" in said
    compare(two, read_table(tmp_path / "one" / "results.parquet"))

    pytest.importorskip("submitit")
    jobs = command(path, tmp_path / "jobs", "--jobs", "2", "--cluster", "local", "--options", "timeout_min=9")
    subprocess.run(jobs, env=with_devices(1), check=True)
    compare(two, read_table(tmp_path / "jobs" / "results.parquet"))
