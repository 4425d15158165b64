"""The `shmoo` command as its users meet it: what good input leaves behind, and what bad input is answered with."""

from __future__ import annotations

import json
import subprocess
import sysconfig
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import yaml

from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.planning.maps import OCCUPIED, OccupancyGrid, save_map

Done = subprocess.CompletedProcess[str]

BAD_INPUT: dict[str, tuple[str, tuple[str, ...]]] = {
    "map without its image": ("navigate --map no_image.yaml --start 1,1,0 --goal 2,1", ("no_image.yaml", "gone.png")),
    "map without resolution": ("navigate --map no_scale.yaml --start 1,1,0 --goal 2,1", ("'resolution'", "missing")),
    "start inside a wall": ("navigate --scenario wall.yaml", ("wall.yaml", "'start'", "inside a wall")),
    "goal unreachable": ("navigate --scenario split.yaml", ("split.yaml", "'goal'", "can't be reached")),
    "unknown object family": ("navigate --scenario family.yaml", ("'objects[0].family'", "'sofa'", "wheelchair")),
    "no object file": ("navigate --scenario gone.yaml", ("shmoo: gone.json: there is no such object file",)),
    "negative mass": ("navigate --scenario mass.yaml", ("mass.yaml", "'objects[0].properties'", "mass", "negative")),
    "object in a wall": ("navigate --scenario box_in_wall.yaml", ("'objects[0].pose'", "in a wall")),
    "load beside its box": ("navigate --scenario load.yaml", ("'objects[0].properties'", "payload_x")),
    "start beside a scenario": ("navigate --scenario good.yaml --start 1,1,0", ("--start", "no effect")),
    "property of another shape": ("navigate --scenario shape.yaml", ("shape.yaml", "'objects[0].properties'", "size")),
    "misspelt key": ("navigate --scenario key.yaml", ("key.yaml", "'gaol'", "did you mean 'goal'?")),
    "truncated weights": ("navigate --scenario good.yaml --weights cut.safetensors", ("cut.safetensors", "damaged")),
    "seed that is no number": ("demo --seed one", ("--seed", "'one'")),
    "start that is no place": ("navigate --map room.yaml --start nan,1,0 --goal 2,1", ("--start", "3 finite numbers")),
    "negative start that is no place": (
        "navigate --map room.yaml --start -1,x,0 --goal 2,1",
        ("--start", "3 finite numbers"),
    ),
    "start in degrees": ("navigate --map room.yaml --start 1,1,90 --goal 2,1", ("--start", "radians", "1.571")),
    "pose in degrees": ("navigate --scenario degrees.yaml", ("'objects[0].pose[2]'", "radians")),
    "number in quotes": ("navigate --scenario quoted.yaml", ("'goal[0]'", "'4'", "quotes")),
    "start off the map": ("navigate --map room.yaml --start -90,1,0 --goal -2,1", ("-90",)),
    "neither scenario nor start": ("navigate --map room.yaml", ("--scenario", "--start", "--goal")),
    "report on nothing": ("report runs/r_nope", ("runs/r_nope", "no such file or folder")),
    "report's folder beside a run": ("report . --out elsewhere", ("--out", "for a recording alone")),
    "weights beside a run": ("report . --weights cut.safetensors", ("--weights", "for a recording alone")),
    "size beside a run": ("report . --size 0.5 0.4", ("--size", "for a recording alone")),
    "training without data": ("train object nothing_here", ("nothing_here", "shmoo collect")),
}
IN_A_PROCESS = {
    "bad input": BAD_INPUT["map without its image"][0],
    "help": "--help",
    "drive": "navigate --scenario drive.yaml --no-video --out drive",
}


def write_inputs(folder: Path) -> None:
    """Maps, scenarios and weights, each with the one fault its name says."""
    cells = np.zeros((60, 100), np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = OCCUPIED
    save_map(OccupancyGrid(cells, 0.05), folder / "room.yaml")
    cells[:, 50:52] = OCCUPIED
    save_map(OccupancyGrid(cells, 0.05), folder / "two_rooms.yaml")
    meta = yaml.safe_load((folder / "room.yaml").read_text())
    maps = {"no_image": meta | {"image": "gone.png"}, "no_scale": {k: meta[k] for k in meta if k != "resolution"}}
    box = {"family": "box", "pose": [3.5, 1.5, 0.0], "properties": {"mass": 3.0}}
    good = {"map": "room.yaml", "start": [1.0, 1.0, 0.0], "goal": [4.0, 2.0], "objects": [box]}
    scenarios = {
        "good": good,
        "wall": good | {"start": [0.02, 1.0, 0.0]},
        "split": good | {"map": "two_rooms.yaml"},
        "degrees": good | {"objects": [box | {"pose": [3.0, 1.5, 90]}]},
        "quoted": good | {"goal": ["4", 2]},
        "family": good | {"objects": [box | {"family": "sofa"}]},
        "gone": good | {"objects": [box | {"family": "gone.json"}]},
        "mass": good | {"objects": [box | {"properties": {"mass": -3.0}}]},
        "box_in_wall": good | {"objects": [box | {"pose": [3.5, 0.42, 0.0], "properties": {"size": [0.5, 0.8, 0.6]}}]},
        "load": good | {"objects": [box | {"properties": {"payload": 5.0, "payload_x": 5.0}}]},
        "shape": good | {"objects": [box | {"properties": {"size": 0.5}}]},
        "key": {"gaol" if key == "goal" else key: value for key, value in good.items()},
        "drive": good | {"goal": [2.0, 1.0], "objects": []},
        "hasty": good | {"objects": [], "limits": {"time_s": 0.5}},
    }
    for name, data in (maps | scenarios).items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(data))
    weights = asset(WEIGHTS).read_bytes()
    (folder / "cut.safetensors").write_bytes(weights[: len(weights) // 2])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("cli")
    write_inputs(made)
    return made


@pytest.fixture(scope="module")
def done(folder: Path) -> dict[str, Done]:
    """Commands in processes of their own, two at a time."""
    program = Path(sysconfig.get_path("scripts")) / "shmoo"

    def run(arguments: str) -> Done:
        command = [str(program), *arguments.split()]
        return subprocess.run(
            command, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=240, check=False
        )

    with ThreadPoolExecutor(2) as pool:
        return dict(zip(IN_A_PROCESS, pool.map(run, IN_A_PROCESS.values()), strict=True))


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_is_answered_with_one_sentence(
    folder: Path, shmoo: Callable[..., Done], monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    monkeypatch.chdir(folder)
    arguments, words = BAD_INPUT[case]
    check_refused(shmoo(*arguments.split()), words)
    assert not (folder / "runs").exists() and not (folder / "weights.safetensors").exists()


@pytest.mark.slow
def test_a_process_of_its_own_answers_the_same(done: dict[str, Done]) -> None:
    check_refused(done["bad input"], BAD_INPUT["map without its image"][1])


def check_refused(result: Done, words: tuple[str, ...]) -> None:
    assert result.returncode == 2, result.stderr
    lines = result.stderr.splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("shmoo: ") and lines[0][-1] in ".?"
    assert all(word in lines[0] for word in words), lines[0]
    assert result.stdout == ""


def test_help_names_every_command(done: dict[str, Done]) -> None:
    assert done["help"].returncode == 0
    for command in ("demo", "navigate", "collect", "train", "map", "doctor"):
        assert f"• {command} " in done["help"].stdout
    assert "shmoo COMMAND --help" in done["help"].stdout


def test_map_show_says_what_is_free_only_by_its_threshold(
    folder: Path, shmoo: Callable[..., Done], tmp_path: Path
) -> None:
    meta = yaml.safe_load((folder / "room.yaml").read_text()) | {"image": "unknown.pgm", "resolution": 0.5}
    (tmp_path / "unknown.pgm").write_bytes(b"P5\n3 1\n255\n" + bytes([205, 205, 254]))
    for threshold, said in ((0.25, "2 cells"), (0.196, "")):
        (tmp_path / "m.yml").write_text(yaml.safe_dump(meta | {"free_thresh": threshold}))
        shown = shmoo("map", "show", str(tmp_path / "m.yml"), "--out", str(tmp_path / "shown.png"))
        assert shown.returncode == 0, shown.stderr
        told = shown.stdout.replace(str(tmp_path), "")  # whose name may hold any number
        assert ("205" in told) == bool(said) and said in told


def test_a_map_is_drawn(folder: Path, shmoo: Callable[..., Done], tmp_path: Path) -> None:
    drawn = shmoo("map", "show", str(folder / "room.yaml"), "--out", str(tmp_path / "picture.png"))
    assert drawn.returncode == 0, drawn.stderr
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_a_drive_leaves_its_folder(done: dict[str, Done], folder: Path) -> None:
    assert done["drive"].returncode == 0, done["drive"].stderr
    assert done["drive"].stdout.startswith("success: ")
    names = {path.name for path in (folder / "drive").iterdir()}
    assert names == {"map.yaml", "map.png", "scenario.yaml", "trace.npz", "recorded.npz", "result.json", "report.html"}
    result = json.loads((folder / "drive" / "result.json").read_text())
    assert result["outcome"] == "success" and result["goal_distance_m"] < 0.25
    assert result["falls"] == result["wall_contacts"] == 0
    assert [t["to"] for t in result["transitions"]] == ["follow path", "done"]
    assert all(t["reason"] for t in result["transitions"])
    assert result["versions"]["mujoco"] == result["versions"]["mujoco-mjx"]


def test_a_run_without_success_says_so(
    folder: Path, shmoo: Callable[..., Done], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    ended = shmoo("navigate", "--scenario", "hasty.yaml", "--no-video", "--out", "hasty")
    assert ended.returncode == 1 and ended.stdout.startswith("timeout: ")
    assert json.loads(Path("hasty/result.json").read_text())["outcome"] == "timeout"
