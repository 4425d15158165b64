"""Every command that writes: an output that is an input, or a file of another kind, is refused and stays as it is."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pytest
import yaml

from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.base.inputs import files_read
from shmoo_mjx.planning.maps import OCCUPIED, OccupancyGrid, load_map, save_map
from shmoo_mjx.plant.mesh import add_object

Shmoo = Callable[..., CompletedProcess[str]]

SQUARE = "v 0 0 0\nv 0.5 0 0\nv 0 0.5 0\nv 0 0 0.6\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
SWEEP = "worlds: 2\nfamilies: [table.json]\ncontrollers: {plain: {kind: quasi_static}}\n"
HEADER = "t,object_x,object_y,object_yaw,force_x,force_y\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A map, a scenario with an object file, and files of other kinds, in the present folder."""
    monkeypatch.chdir(tmp_path)
    cells = np.zeros((60, 100), np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = OCCUPIED
    save_map(OccupancyGrid(cells, 0.05), "map.yaml")
    Path("table.obj").write_text(SQUARE)
    add_object(Path("table.obj"), mass=5.0, friction=0.4, out=Path("table.json"))
    scenario = {"map": "map.yaml", "start": [1.0, 1.0, 0.0], "goal": [2.0, 1.0]}
    table = {"family": "table.json", "pose": [3.5, 2.2, 0.0]}
    Path("scenario.yaml").write_text(yaml.safe_dump(scenario | {"objects": [table]}))
    Path("sweep.yaml").write_text(SWEEP)
    Path("notes.txt").write_text("mine\n")
    Path("log.csv").write_text(HEADER)
    Path("package.json").write_text('{"name": "mine"}\n')
    shutil.copy(asset(WEIGHTS), "weights.safetensors")
    return tmp_path


POINTS = "--start 1,1,0 --goal 2,1"
REFUSED = {
    "a map's picture over its image": ("map show map.yaml --out map.png", "map.png"),
    "a map's picture over its YAML": ("map show map.yaml --out map.yaml", "map.yaml"),
    "a map's picture over a link": ("map show map.yaml --out link.png", "link.png"),
    "a map's picture over a text": ("map show map.yaml --out notes.txt", "notes.txt"),
    "a run over its scenario": ("navigate --scenario scenario.yaml --out .", "scenario.yaml"),
    "a run over its map": (f"navigate --map map.yaml {POINTS} --out .", "map.yaml"),
    "a run over its map, by another way": (f"navigate --map map.yaml {POINTS} --out here", "map.yaml"),
    "a run over another map": (f"navigate --map copy/map.yaml {POINTS} --out .", "scenario.yaml"),
    "a run in a folder that is no run's": ("demo --quick --out other", "other/demo-0/map.yaml"),
    "an experiment over a map": ("experiment object_model --quick --json map.yaml", "map.yaml"),
    "an experiment over a scenario set": (
        "experiment navigation --scenarios set.json --json set.json",
        "set.json",
    ),
    "an experiment over weights": (
        "experiment pushing --weights weights.safetensors --json weights.safetensors",
        "weights.safetensors",
    ),
    "a benchmark over JSON": ("bench plant --json package.json", "package.json"),
    "faults over JSON": ("experiment faults --runs 1 --json package.json", "package.json"),
    "a soak over an object": ("experiment soak --minutes 1 --json table.json", "table.json"),
    "a scenario set over a map": ("scenarios make --maps . --out map.yaml", "map.yaml"),
    "a scenario set over JSON": ("scenarios make --maps . --out package.json", "package.json"),
    "an object over its mesh": ("object add table.obj --mass 4 --friction 0.4 --out table.obj", "table.obj"),
    "an object over JSON": ("object add table.obj --mass 4 --friction 0.4 --out package.json", "package.json"),
    "a sweep over a map's image": ("sweep sweep.yaml --out .", "map.png"),
    "a view over a map's image": ("view scene/scene.yaml --no-window --out scene", "scene.png"),
    "a report in a run's folder": ("report log.csv --size 0.5 0.4 --out run", "run/result.json"),
    "weights over a map": ("train robot data --out map.yaml", "map.yaml"),
    "a map's picture over a folder": ("map show map.yaml --out /", "/: is a folder"),
    "an object over the present folder": ("object add table.obj --mass 4 --friction 0.4 --out .", ".: is a folder"),
    "weights over a folder": ("train object data --quick --out /", "/: is a folder"),
    "a scenario set over a folder": ("scenarios make --per-map 1 --out run", "run: is a folder"),
    "a scenario set where none can be": ("scenarios make --per-map 1 --out /proc/set.json", "/proc/set.json"),
    "an experiment over a folder": ("experiment faults --json .", ".: is a folder"),
    "a benchmark where none can be": ("bench startup --json /proc/x/bench.json", "/proc/x/bench.json"),
    "a benchmark below a file": ("bench startup --out notes.txt", "notes.txt/bench_startup.json"),
    "all benchmarks over JSON": ("bench all --json new.json --out results", "results/bench_plant.json"),
    "a benchmark without its interpreter": ("bench mppi --quick --peers-python nope/python", "nope/python"),
    "an object file that no scenario takes": ("object add table.obj --mass 4 --friction 0.4 --out a.txt", ".json"),
    "a picture under another name": ("map show map.yaml --out a.txt", ".png"),
}


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("case", REFUSED)
def test_what_would_be_destroyed_is_refused_in_one_sentence(case: str, folder: Path, shmoo: Shmoo) -> None:
    (folder / "link.png").symlink_to("map.png")
    (folder / "here").symlink_to(folder)
    for name in ("copy", "other/demo-0", "scene"):
        (folder / name).mkdir(parents=True)
        for part in ("map.yaml", "map.png"):
            shutil.copy(part, folder / name)
    (folder / "scene" / "map.png").rename(folder / "scene" / "scene.png")
    meta = yaml.safe_load((folder / "map.yaml").read_text()) | {"image": "scene.png"}
    (folder / "scene" / "map.yaml").write_text(yaml.safe_dump(meta))
    (folder / "scene" / "scene.yaml").write_text("map: map.yaml\nstart: [1, 1, 0]\ngoal: [2, 1]\n")
    (folder / "run").mkdir()
    np.savez(folder / "run" / "trace.npz", t=np.zeros(1))
    (folder / "run" / "result.json").write_text(json.dumps({"outcome": "success"}))
    (folder / "results").mkdir()
    shutil.copy("package.json", "results/bench_plant.json")
    (folder / "set.json").write_text(json.dumps({"format": "", "scenarios": []}))
    before = tree(folder)
    words, named = REFUSED[case]
    done = shmoo(*words.split())
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("shmoo: ") and named in done.stderr, done.stderr
    assert tree(folder) == before


def test_a_map_is_drawn_beside_its_image_by_default(folder: Path, shmoo: Shmoo) -> None:
    before = load_map("map.yaml").cells
    for _ in range(2):  # its own picture may be replaced
        done = shmoo("map", "show", "map.yaml")
        assert done.returncode == 0 and done.stdout == "map_free_space.png\n"
    np.testing.assert_array_equal(load_map("map.yaml").cells, before)
    assert (folder / "map_free_space.png").stat().st_size > 1000


def test_inputs_are_what_files_refer_to(folder: Path) -> None:
    (folder / "inner").mkdir()
    (folder / "inner" / "deep.yml").write_text("image: ../map.png\n")
    names = {os.path.normpath(p) for p in files_read([Path("scenario.yaml"), "notes.txt", "no such file", 3])}
    assert names == {"scenario.yaml", "map.yaml", "map.png", "table.json", "notes.txt"}
    assert {os.path.normpath(p) for p in files_read([Path("inner")])} == {"inner/deep.yml", "map.png"}
    assert Path("table.json") in files_read([(Path("sweep.yaml"),)])
    # Each list holds the one before twice: a million million strings, if they were all walked through.
    lines = ["a0: &a0 [x]"] + [f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 40)]
    Path("bomb.yaml").write_text("\n".join(lines))
    assert files_read([Path("bomb.yaml")]) == {Path("bomb.yaml")}
