"""A run's folder can be moved, and repeats the run from wherever it and the shell are."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from collections.abc import Callable
from html import unescape
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pytest
import yaml

from shmoo_mjx.learning.weights import load_weights, save_weights
from shmoo_mjx.planning.maps import OCCUPIED, OccupancyGrid, save_map
from shmoo_mjx.plant.mesh import add_object
from shmoo_mjx.run.view import scene_named

Shmoo = Callable[..., CompletedProcess[str]]

TABLE = "v 0 0 0\nv 0.5 0 0\nv 0 0.5 0\nv 0 0 0.6\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
NAME = "a run, $x$ 跑"


@pytest.fixture
def inputs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A map, two object files of one name, weights, and a scenario with paths relative to it."""
    folder = tmp_path / "inputs"
    for part in ("scenes", "maps", "things/more"):
        (folder / part).mkdir(parents=True)
    monkeypatch.chdir(folder)
    cells = np.zeros((60, 100), np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = OCCUPIED
    save_map(OccupancyGrid(cells, 0.05), "maps/floor.yaml")
    Path("table.obj").write_text(TABLE)
    for out, mass in (("things/table.json", 5.0), ("things/more/table.json", 9.0)):
        add_object(Path("table.obj"), mass=mass, friction=0.4, out=Path(out))
    objects = [
        {"family": "../things/table.json", "pose": [3.5, 2.2, 0.0]},
        {"family": "../things/more/table.json", "pose": [4.2, 0.8, 0.0]},
    ]
    scenario = {"map": "../maps/floor.yaml", "start": [1.0, 1.0, 0.0], "goal": [2.0, 1.0], "objects": objects}
    Path("scenes/scene.yaml").write_text(yaml.safe_dump(scenario | {"senses": "perfect"}))
    shipped = load_weights()
    save_weights("own.safetensors", shipped._replace(info=shipped.info | {"object_score": 0.5}))
    return folder


@pytest.mark.slow
def test_a_run_is_repeated_from_its_folder_alone(
    inputs: Path, tmp_path: Path, shmoo: Shmoo, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["navigate", "--no-video", "--scenario", "scenes/scene.yaml", "--weights", "own.safetensors", "--out"]
    done = shmoo(*words, NAME)
    assert done.returncode == 0, done.stderr
    assert shmoo(*words, NAME).returncode == 0  # over its own earlier output
    moved = tmp_path / "far" / "away" / NAME
    moved.parent.mkdir(parents=True)
    shutil.move(NAME, moved)
    shutil.rmtree(inputs)
    monkeypatch.chdir(tmp_path / "far")

    for file in [*moved.rglob("*.yaml"), moved / "result.json"]:
        assert str(tmp_path) not in file.read_text() and ".." not in file.read_text(), file
    held = json.loads((moved / "result.json").read_text())["config"]["scenario"]
    assert held["map"] == "map.yaml" and held["senses"] == "perfect"
    assert [o["family"] for o in held["objects"]] == ["objects/table.json", "objects/table-2.json"]

    assert [round(c.mass) for c in scene_named(f"away/{NAME}/scenario.yaml", 0).conditions] == [5, 9]
    for command in ("replay", "report"):
        done = shmoo(command, f"away/{NAME}")
        assert done.returncode == 0, done.stderr
    shown = re.findall(r"<pre>(uv run shmoo .*?)</pre>", (moved / "report.html").read_text())
    monkeypatch.chdir(moved.parent)
    again = shlex.split(unescape(shown[0]))[3:]
    assert again[0] == "navigate"
    done = shmoo(*again, "--no-video")
    assert done.returncode == 0, done.stderr
    first, second = (np.load(Path(name) / "trace.npz") for name in (NAME, f"{NAME}-again"))
    np.testing.assert_array_equal(first["robot_pose"], second["robot_pose"])
    done = shmoo(*again[:-1], NAME, "--no-video")
    assert done.returncode == 2 and "input of this command" in done.stderr


@pytest.mark.slow
def test_weights_of_an_earlier_run_do_not_stay(inputs: Path, shmoo: Shmoo) -> None:
    words = ["navigate", "--no-video", "--map", "maps/floor.yaml", "--start=1,1,0", "--goal=1.2,1", "--out", "out"]
    assert shmoo(*words, "--weights", "own.safetensors").returncode == 0
    assert (inputs / "out" / "weights.safetensors").is_file()
    assert shmoo(*words).returncode == 0
    assert not (inputs / "out" / "weights.safetensors").exists() and shmoo("replay", "out").returncode == 0
