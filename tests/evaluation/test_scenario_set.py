"""A scenario set: made from maps by the command, opened again as it was, and refused in a sentence when damaged."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest
import trimesh
from toy import toy_generated, toy_scenario

from shmoo_mjx.base.assets import asset
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation import experiment, navigation, navigation_places, scenario_set
from shmoo_mjx.evaluation.certify import Certificate
from shmoo_mjx.evaluation.navigation_places import kept_scenario
from shmoo_mjx.evaluation.result import ExperimentOptions, file_id
from shmoo_mjx.evaluation.scenario_set import find_set, make_set, open_set
from shmoo_mjx.evaluation.scenarios import KINDS, Generated
from shmoo_mjx.planning.maps import load_map, save_map
from shmoo_mjx.plant.mesh import add_object

SHIPPED = find_set(Path("floor_plans"))
TWO = "the (2nd) [floor]"


CERTIFICATE = Certificate(attempts=(), round_s=30.0, reference_s=30.0, best=())


def drawn_quickly(grid: Any, extra: Any, *rest: Any, **options: Any) -> Generated:
    return toy_generated(True, kind="detour only", detour=9.0, certificate=CERTIFICATE)


def at_once(trials: dict[str, Any], work: Callable[[Any], list[Any]], *rest: Any, **options: Any) -> list[Any]:
    return [row for trial in trials.values() for row in work(trial)]


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(navigation_places, "draw_scenario", drawn_quickly)
    monkeypatch.setattr(scenario_set, "run_trials", at_once)
    (tmp_path / "maps").mkdir()
    for name in ("one.yaml", "the (2nd) [floor].yml"):
        save_map(toy_scenario(1, True)[0], tmp_path / "maps" / name)
    count = make_set(tmp_path / "set.json", tmp_path / "maps", (7, 8), per_map=2, drawn=tmp_path / "drawn")
    assert count == 8
    return tmp_path / "set.json"


def test_a_set_is_opened_as_it_was_made_wherever_it_is(made: Path, tmp_path: Path) -> None:
    places, count = open_set(made, tmp_path / "elsewhere")
    assert count == 4 and set(places.maps) == {"one", TWO}
    grid = toy_scenario(1, True)[0]
    opened = load_map(places.maps["one"])
    assert np.array_equal(opened.cells, grid.cells) and opened.resolution == grid.resolution
    wanted, found = kept_scenario(places, opened, TWO, 3)
    assert wanted in KINDS and found is not None and found.scenario.objects == toy_scenario(1, True)[1].objects
    assert found.certificate == CERTIFICATE and found.extra == 5.0
    text = made.read_text()
    assert str(tmp_path) not in text and "border" not in text and json.loads(text)["condition_seeds"] == [7, 8]


def test_object_files_are_relative_to_the_set(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box((0.3, 0.3, 0.5)).export("stool.stl")
    add_object(Path("stool.stl"), mass=5.0, friction=0.35)
    data = json.loads(made.read_text())
    data["scenarios"][0]["scenario"]["objects"][0] |= {"family": "stool.json", "properties": {}}
    made.write_text(json.dumps(data))
    monkeypatch.chdir("/")
    places, _ = open_set(made, tmp_path / "elsewhere")
    found = kept_scenario(places, load_map(places.maps["one"]), "one", 0)[1]
    assert found is not None and found.scenario.objects[0].condition().mass == 5.0


def test_navigation_runs_the_set_and_says_which(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[str] = []

    def trial(setup: Any, given: tuple[str, int, str]) -> list[dict[str, Any]]:
        ran.append("-".join(map(str, given)))
        return []

    trial.__module__ = navigation.__name__
    changed = replace(navigation.EXPERIMENT, trial=trial, metrics=lambda setup, rows: {}, draw=None)
    monkeypatch.setattr(experiment, "run_trials", at_once)
    options = ExperimentOptions(out=tmp_path, scenario_set=made, policies=("ours",))
    result = experiment.run("navigation", changed, options)
    assert sorted(ran) == sorted(f"{name}-{i}-ours" for name in ("one", TWO) for i in range(4))
    assert result.config["scenario_set"] == file_id(made) and result.config["generated_maps"] is False
    folders = [
        experiment.prepare("navigation", navigation.EXPERIMENT, o).store
        for o in (options, ExperimentOptions(out=tmp_path))
    ]
    assert folders[0] != folders[1]


def test_a_folder_of_the_name_of_a_shipped_set_does_not_hide_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arena").mkdir()
    assert find_set(Path("arena")) == asset("experiments/scenario_sets/arena.json")
    Path("floor_plans").write_text("{}")
    assert find_set(Path("floor_plans")) == Path("floor_plans")


@pytest.mark.slow
def test_the_arena_has_100_certified_scenarios_without_maps_of_others(tmp_path: Path) -> None:
    places, _ = open_set(find_set(Path("arena")), tmp_path)
    assert places.entries is not None and len(places.entries) == 100 and len(places.maps) == 25
    entries = [entry.certificate for entry in places.entries.values()]
    assert all(entry is not None for entry in entries)
    solvable = [entry is not None and entry.reference_s is not None for entry in entries]
    assert 80 <= sum(solvable) < 100
    kinds = [entry.kind for entry in places.entries.values()]
    assert [kind != "unsolvable" for kind in kinds] == solvable
    assert find_set(Path("arena")).stat().st_size < 500_000


def test_a_set_of_the_older_form_has_no_certificates_and_loads(tmp_path: Path) -> None:
    places, _ = open_set(SHIPPED, tmp_path)
    older = json.loads(SHIPPED.read_text())["scenarios"][0]
    assert "certificate" not in older and "border" in older and places.entries is not None
    name = next(iter(places.entries))
    found = kept_scenario(places, load_map(places.maps[name.rpartition("-")[0]]), *_place(name))[1]
    assert found is not None and found.certificate is None


def _place(name: str) -> tuple[str, int]:
    map_name, _, number = name.rpartition("-")
    return map_name, int(number)


def test_the_shipped_set_has_20_scenarios_of_every_kind_that_fit_their_maps(tmp_path: Path) -> None:
    assert asset("experiments/scenario_sets/floor_plans.json") == SHIPPED and SHIPPED.stat().st_size < 200_000
    places, _ = open_set(SHIPPED, tmp_path)
    assert places.entries is not None and len(places.entries) == 20 and len(places.maps) == 5
    assert {entry.kind for entry in places.entries.values()} == set(KINDS)


@pytest.mark.parametrize(
    ("harm", "says"),
    [
        (lambda d: d["scenarios"][0].update(map="gone"), "'scenarios\\[0\\]' is on 'gone'"),
        (lambda d: d["scenarios"][1].update(movable=[]), "'scenarios\\[1\\]' must say 'movable'"),
        (lambda d: d["scenarios"][0]["scenario"].update(goal=[900.0, 0.0]), "'goal' \\(900, 0\\) lies off the map"),
        (lambda d: d["scenarios"][0].update(kind="odd"), "'scenarios\\[0\\].kind'"),
        (
            lambda d: d["scenarios"][0]["certificate"].update(best=[-1]),
            "'scenarios\\[0\\].certificate' names an attempt",
        ),
        (lambda d: d["maps"].update({"../x": d["maps"]["one"]}), "name maps by letters"),
        (lambda d: d["maps"].update({"x\n": d["maps"]["one"]}), "name maps by letters"),
        (lambda d: d["scenarios"][0].update(number="1"), "'scenarios\\[0\\].number'"),
        (lambda d: d["maps"]["one"].update(png="?"), "'maps.one.png' is no base64"),
        (lambda d: d.update(scenarios=[]), "'scenarios'"),
        (lambda d: d.update(format="other"), "'format'"),
    ],
)
def test_a_damaged_set_is_refused_with_its_field(
    made: Path, tmp_path: Path, harm: Callable[[dict[str, Any]], None], says: str
) -> None:
    data = json.loads(made.read_text())
    harm(data)
    made.write_text(json.dumps(data))
    with pytest.raises(ShmooError, match=says):
        open_set(made, tmp_path / "elsewhere")


def test_bad_input_is_one_sentence_with_exit_code_2(
    shmoo: Callable[..., CompletedProcess[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "none").mkdir()
    (tmp_path / "odd.json").write_text("[1]")
    for command, says in (
        (("scenarios", "make", "--maps", "none", "--out", "x.json"), "holds no map_server YAML"),
        (("scenarios", "make", "--out", "x.json", "--condition-seed", "-1"), "--condition-seed"),
        (("scenarios", "make", "--out", "x.json", "--per-map", "0"), "--per-map"),
        (("experiment", "navigation", "--scenarios", "gone.json"), "there is no such scenario set"),
        (("experiment", "navigation", "--scenarios", "odd.json"), "this is no scenario set"),
        (("experiment", "navigation", "--scenarios", "none"), "this is no scenario set"),
        (("experiment", "navigation", "--scenarios", "-3"), "--scenarios '-3' must be a whole number"),
        (("experiment", "pushing", "--scenarios", "odd.json"), "for shmoo experiment navigation or lifelong alone"),
        (("experiment", "navigation", "--maps", "none", "--scenarios", "odd.json"), "without --maps"),
    ):
        done = shmoo(*command)
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1, done.stderr
        assert done.stderr.startswith("shmoo: ") and says in done.stderr


@pytest.mark.slow
def test_the_command_draws_a_set_that_is_the_same_again(
    shmoo: Callable[..., CompletedProcess[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in (tmp_path / "a", tmp_path / "b"):
        (folder / "maps").mkdir(parents=True)
        save_map(toy_scenario(2, True)[0], folder / "maps" / "rooms.yaml")
        monkeypatch.chdir(folder)
        done = shmoo("scenarios", "make", "--maps", "maps", "--out", "set.json", "--per-map", "1")
        assert done.returncode == 0 and "set.json: 1 scenario" in done.stdout, done.stderr
    assert (tmp_path / "a" / "set.json").read_bytes() == (tmp_path / "b" / "set.json").read_bytes()
    assert open_set(tmp_path / "a" / "set.json", tmp_path / "opened")[1] == 1
