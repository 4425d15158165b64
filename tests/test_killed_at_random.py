"""SIGKILL at random moments, over and over in one folder: the end is that of a run that nobody disturbed.

Slow, about ten minutes for each command: uv run pytest -m slow tests/test_killed_at_random.py
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

KILLS = 20
SWEEP = """
worlds: 6
shard: 2
seconds: 5
controllers: {plain: {kind: quasi_static}}
vary: {object.mass: {log_uniform: [2, 20]}, object.friction: {uniform: [0.1, 0.4]}, goal.distance: 0.3}
map: [object.mass, object.friction]
"""
COLLECT = "--train 1 --validation 1 --episodes 2 --seconds 4"
WORK = {
    "demo": "demo --quick --seed 0 --out OUT",
    "collect": f"collect OUT {COLLECT}",
    "train": "train robot DATA --out OUT/w.safetensors",
    "experiment": "experiment object_planner --quick --out OUT",
    "sweep": "sweep SWEEP --out OUT",
}


def begin(words: str, folder: Path) -> subprocess.Popen[bytes]:
    places = {"OUT": folder / "out", "DATA": folder.parent / "data", "SWEEP": folder.parent / "sweep.yaml"}
    for name, place in places.items():
        words = words.replace(name, str(place))
    folder.mkdir(exist_ok=True)
    with (folder / "said").open("wb") as said:
        command = [str(Path(sys.executable).with_name("shmoo")), *words.split(), "--quiet"]
        return subprocess.Popen(command, stdout=said, stderr=said, start_new_session=True)


def finish(running: subprocess.Popen[bytes], folder: Path) -> dict[str, Any]:
    assert running.wait(timeout=1800) == 0, (folder / "said").read_text()
    return files(folder / "out")


def files(folder: Path) -> dict[str, Any]:
    """What every file holds; JSON in no order, for workers end in any."""
    found = {str(p.relative_to(folder)): p for p in folder.rglob("*") if p.is_file()}
    return {name: json.loads(p.read_text()) if p.suffix == ".json" else p.read_bytes() for name, p in found.items()}


def gone(group: int) -> bool:
    """Whether a killed process took its workers with it."""
    until = time.monotonic() + 20.0
    while time.monotonic() < until:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


@pytest.mark.slow
@pytest.mark.parametrize("name", WORK)
def test_killed_again_and_again_it_ends_as_if_nothing_had_happened(name: str, tmp_path: Path) -> None:
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    if name == "train":
        finish(begin(f"collect DATA {COLLECT}", tmp_path / "any"), tmp_path / "any")
    began = time.monotonic()
    whole = finish(begin(WORK[name], tmp_path / "whole"), tmp_path / "whole")
    longest = time.monotonic() - began
    rng, kills, folder = np.random.default_rng(zlib.crc32(name.encode())), 0, tmp_path / "killed"
    moments = []
    while kills < KILLS:
        began = time.monotonic()
        running = begin(WORK[name], folder)
        moments.append(float(rng.uniform(0.0, longest)))
        try:
            running.wait(moments[-1])
        except subprocess.TimeoutExpired:
            os.kill(running.pid, signal.SIGKILL)
            running.wait()
            kills += 1
            assert gone(running.pid), "workers outlive it"
            continue
        # The whole run may have been slower, on a busier machine.
        longest = min(longest, time.monotonic() - began)
        assert finish(running, folder) == whole, moments
        shutil.rmtree(folder)
    ended = finish(begin(WORK[name], folder), folder)
    assert set(ended) == set(whole), moments
    assert ended == whole, (moments, [file for file in whole if ended[file] != whole[file]])
