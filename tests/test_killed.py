"""Collecting and training, killed with SIGKILL in the middle and started again, end as if nothing had happened."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from safetensors import safe_open

COLLECT = ("--train", "1", "--validation", "1", "--episodes", "2", "--seconds", "12", "--quiet")
TRAIN = """
import sys
from pathlib import Path

from shmoo_mjx.data import store
from shmoo_mjx.dynamics import ObjectConfig
from shmoo_mjx.learning import daiml, trees

if __name__ == "__main__":
    data, out = map(Path, sys.argv[1:])
    config = daiml.DaimlConfig(
        object=ObjectConfig(hidden=(24, 24), body=False), horizon=4, conditions=3, adapt_rows=32, windows=8,
        chunks=4, chunk_updates=100, fit_rows=100,
    )
    fitted = daiml.train_object(store.of_training(data), out, config, lambda p: print(p.chunk, flush=True))
    trees.save_checkpoint(out / "fitted.safetensors", fitted.params, {"history": fitted.history})
"""


def shmoo_collect(directory: Path) -> subprocess.Popen[str]:
    return subprocess.Popen([str(Path(sys.executable).with_name("shmoo")), "collect", str(directory), *COLLECT])


def content(path: Path) -> Any:
    """What the file says, in no order: safetensors writes its metadata in any, workers end in any."""
    if path.suffix == ".json":
        return json.loads(path.read_text())
    with safe_open(path, framework="numpy") as file:
        names = file.keys()
        return file.metadata(), {name: file.get_tensor(name).tobytes() for name in names}


def files(directory: Path) -> dict[str, Any]:
    """The data set; what a killed process was about to write (NAME.PID.tmp) is no part of it."""
    return {path.name: content(path) for path in directory.iterdir() if path.suffix != ".tmp"}


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("whole") / "data"
    assert shmoo_collect(directory).wait() == 0
    return directory


def test_a_killed_collect_goes_on(collected: Path, tmp_path: Path) -> None:
    directory = tmp_path / "data"
    process, deadline = shmoo_collect(directory), time.monotonic() + 120.0
    while len(list(directory.glob("*.safetensors"))) < 3 and time.monotonic() < deadline:
        time.sleep(0.005)
    process.kill()
    process.wait()
    some = set(directory.glob("*.safetensors"))
    assert 0 < len(some) < len(list(collected.glob("*.safetensors")))
    before = {path: path.stat().st_mtime_ns for path in some}
    assert shmoo_collect(directory).wait() == 0
    # The last one written may not have been in the manifest yet.
    assert sum(path.stat().st_mtime_ns == then for path, then in before.items()) >= len(some) - 1
    assert files(directory) == files(collected)


def test_a_killed_training_goes_on(collected: Path, tmp_path: Path) -> None:
    (tmp_path / "train.py").write_text(TRAIN)

    def train(out: str) -> subprocess.Popen[str]:
        command = [sys.executable, str(tmp_path / "train.py"), str(collected), str(tmp_path / out)]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    whole = train("whole")
    assert whole.communicate()[0].split() == ["1", "2", "3", "4"]
    cut = train("cut")
    assert cut.stdout is not None
    assert [cut.stdout.readline().strip() for _ in range(2)] == ["1", "2"]
    cut.kill()
    cut.communicate()
    assert not (tmp_path / "cut" / "fitted.safetensors").exists()
    rest = train("cut").communicate()[0].split()
    assert rest and rest[0] > "2" and rest[-1] == "4"
    assert content(tmp_path / "whole" / "fitted.safetensors") == content(tmp_path / "cut" / "fitted.safetensors")
