"""Collecting and training, killed with SIGKILL in the middle and started again, end as if nothing had happened."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from safetensors import safe_open

COLLECT = ("--train", "1", "--validation", "1", "--episodes", "2", "--seconds", "4", "--quiet")
DYING = """
import os
import signal
import sys
import time

from shmoo_mjx.cli import main


def die_at(number, before):
    # Every file is put in its place by os.replace; the process ends just before or after the given one.
    place, done = os.replace, 0

    def replace(source, target):
        nonlocal done
        done += 1
        if not (before and done == number):
            place(source, target)
        if done == number:
            os.kill(os.getpid(), signal.SIGKILL)

    os.replace = replace


if __name__ == "__main__":
    die_at(int(sys.argv.pop(1)), before=False)
    main()
"""
EVERYWHERE = """
import contextlib
import os
import sys
import time
from concurrent.futures import Future
from pathlib import Path

import numpy as np

from dying import die_at
from shmoo_mjx.data import collect, store

computed = []


def made_up(config, seeds, number):
    computed.append(seeds)
    rng = np.random.default_rng([config.seed, number])
    shapes = {key: (2, 5, *tail) for key, tail in store.FIELDS.items()} | {"face": (2, 4), "size": (2,)}
    return [{key: rng.normal(size=shape) for key, shape in shapes.items()} for _ in seeds]


class Here:
    def submit(self, work, *arguments):
        done = Future()
        done.set_result(work(*arguments))
        return done


def run(directory):
    collect.collect(directory, collect.CollectConfig(train=1, validation=1))


def found(directory):
    return {path: (path.read_bytes(), path.stat().st_mtime_ns) for path in directory.glob("*.safetensors")}


collect._run_chunk, collect.process_pool = made_up, lambda workers: contextlib.nullcontext(Here())
folder, points = Path(sys.argv[1]), 0
run(folder / "whole")
whole = {path.name: content for path, (content, _) in found(folder / "whole").items()}
# The first manifest, then a recording and a manifest for each of the six.
for number in range(1, 2 * len(whole) + 2):
    for before in (True, False):
        directory = folder / f"{number}{before}"
        child = os.fork()
        if child == 0:
            die_at(number, before)
            run(directory)
        assert os.WTERMSIG(os.waitpid(child, 0)[1]) == 9
        kept, computed[:] = found(directory), []
        run(directory)
        end = found(directory)
        assert all(end[path] == state for path, state in kept.items()), (number, before)
        assert {path.name: content for path, (content, _) in end.items()} == whole, (number, before)
        assert sorted(store.read(directory).names) == sorted(Path(name).stem for name in whole)
        assert len(computed) == 3 - len(kept) // 2, (number, before)
        assert {path.name for path in directory.iterdir()} == {*whole, "manifest.json"}, (number, before)
        points += 1
print(points)
"""
TRAIN = """
import sys
import time
from pathlib import Path

from shmoo_mjx.data import store
from shmoo_mjx.dynamics import ObjectConfig
from shmoo_mjx.learning import daiml, serialisation

if __name__ == "__main__":
    data, out = map(Path, sys.argv[1:])
    config = daiml.DaimlConfig(
        object=ObjectConfig(hidden=(24, 24), contact_model=False), horizon=4, conditions=3, adapt_samples=32, windows=8,
        epochs=4, epoch_updates=100, fit_samples=100,
    )
    fitted = daiml.train_object(store.of_training(data), out, config, lambda p: print(p.epoch, flush=True))
    serialisation.save_tree(out / "fitted.safetensors", fitted.params, {"history": fitted.history})
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
    return {path.name: content(path) for path in directory.iterdir()}


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("whole") / "data"
    assert shmoo_collect(directory).wait() == 0
    return directory


@pytest.mark.slow
def test_a_killed_collect_goes_on(collected: Path, tmp_path: Path) -> None:
    (tmp_path / "dying.py").write_text(DYING)
    directory = tmp_path / "data"
    # Its eighth file is the fourth recording, the second of a chunk, which no manifest names yet.
    dying = subprocess.run([sys.executable, str(tmp_path / "dying.py"), "8", "collect", str(directory), *COLLECT])
    assert dying.returncode == -signal.SIGKILL
    before = {path: path.stat().st_mtime_ns for path in directory.glob("*.safetensors")}
    assert len(before) == 4
    assert shmoo_collect(directory).wait() == 0
    assert all(path.stat().st_mtime_ns == then for path, then in before.items())
    assert files(directory) == files(collected)


@pytest.mark.slow
def test_a_collect_loses_nothing_wherever_it_is_killed(tmp_path: Path) -> None:
    (tmp_path / "dying.py").write_text(DYING)
    (tmp_path / "everywhere.py").write_text(EVERYWHERE)
    command = [sys.executable, str(tmp_path / "everywhere.py"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout == "26\n", done.stderr


@pytest.mark.slow
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


def test_ctrl_c_ends_at_once_with_one_sentence(tmp_path: Path) -> None:
    """A terminal sends it to the whole group: neither the workers' tracebacks nor their jobs are waited for."""
    # What a shell runs in the background ignores Ctrl-C, and so do its children.
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    code += "from shmoo_mjx.cli import main; main()"
    longer = [*COLLECT, "--episodes", "60"]  # so that it can't have ended by itself
    command = [sys.executable, "-c", code, "collect", str(tmp_path / "data"), *longer]
    running = subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60.0
    while not (tmp_path / "data" / "manifest.json").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(1.0)
    os.killpg(running.pid, signal.SIGINT)
    _, said = running.communicate(timeout=20.0)
    assert running.returncode == 130
    assert said == "shmoo: stopped; run the same command again to go on.\n"
