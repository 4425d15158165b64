"""Scenario files: what is read, what is refused and how, and the checks against a map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from shmoo_mjx.base import yaml_input
from shmoo_mjx.base.yaml_input import read_mapping, yaml_text
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.planning.footprints import footprint_polygon, wall_distance
from shmoo_mjx.planning.maps import OCCUPIED, UNKNOWN, OccupancyGrid
from shmoo_mjx.planning.scenario import (
    FAMILIES,
    ROBOT_RADIUS,
    ObjectEntry,
    Scenario,
    check_place,
    check_places,
    check_point,
    check_scenario,
    load_scenario,
    portable,
    save_scenario,
    with_own_objects,
)
from shmoo_mjx.plant.mesh import add_object
from shmoo_mjx.run.scenario_run import load_inputs

ROOT = Path(__file__).resolve().parents[2]
TETRAHEDRON = "v 0 0 0\nv 0.5 0 0\nv 0 0.5 0\nv 0 0 0.6\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
GOOD = {
    "map": "maps/office.yaml",
    "start": [1.0, 1.0, 0.0],
    "goal": [4.0, 2],
    "objects": [
        {"family": "box", "pose": [2.0, 1.0, 0.1], "properties": {"mass": 3.0, "size": [0.5, 0.5, 0.6]}},
        {"family": "wheelchair", "pose": [3, 1, 0], "seed": 7, "properties": {"locked": [True, True, False, False]}},
    ],
    "seed": 3,
    "limits": {"time_s": 120},
    "senses": "perfect",
}


def write(folder: Path, data: object) -> Path:
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def test_reads_everything_and_finds_the_map_beside_the_file(tmp_path: Path) -> None:
    scenario = load_scenario(write(tmp_path, GOOD))
    assert scenario.map == str(tmp_path / "maps/office.yaml")
    assert scenario.goal == (4.0, 2.0) and scenario.limits.time_s == 120.0
    assert [o.family for o in scenario.objects] == ["box", "wheelchair"]
    assert scenario.objects[0].seed == 0 and scenario.objects[0].properties["mass"] == 3.0
    assert scenario.objects[1].properties["locked"] == [True, True, False, False]
    assert all(type(v) is bool for v in scenario.objects[1].properties["locked"])


def test_written_scenarios_come_back(tmp_path: Path) -> None:
    scenario = Scenario.model_validate(GOOD | {"map": None})
    save_scenario(scenario, tmp_path / "new" / "scene.yaml")
    assert load_scenario(tmp_path / "new" / "scene.yaml") == scenario
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["scene.yaml"]


def test_files_are_named_relative_to_the_file_that_names_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in ("scenes", "things"):
        (tmp_path / folder).mkdir()
    Path(tmp_path / "link").symlink_to(tmp_path / "scenes")
    for name in ("floor.yaml", "table.json"):
        (tmp_path / "things" / name).touch()
    monkeypatch.chdir(tmp_path)
    entry = ObjectEntry(family="things/table.json", pose=(1, 1, 0))
    scenario = Scenario(map=str(tmp_path / "things" / "floor.yaml"), start=(0, 0, 0), goal=(1, 0), objects=(entry,))
    for out in ("scenes/one.yaml", str(tmp_path / "scenes" / "two.yaml"), "link/three.yaml", "four.yaml"):
        save_scenario(scenario, out)
        saved = yaml.safe_load(Path(out).read_text())
        up = "" if out == "four.yaml" else "../"
        assert saved["map"] == f"{up}things/floor.yaml" and saved["objects"][0]["family"] == f"{up}things/table.json"
    monkeypatch.chdir("/")
    back = load_scenario(tmp_path / "link" / "three.yaml")
    assert Path(str(back.map)).is_file() and Path(back.objects[0].family).is_file()
    beside = Scenario(map="room.yaml", start=(0, 0, 0), goal=(1, 0))
    assert portable(beside, tmp_path) == beside


def test_object_files_are_copied_once_and_over_nothing(tmp_path: Path) -> None:
    entries = []
    for name, mass in (("a", 3.0), ("b", 4.0), ("c", 3.0)):
        (tmp_path / name).mkdir()
        (tmp_path / "box.obj").write_text(TETRAHEDRON)
        file = add_object(tmp_path / "box.obj", mass=mass, friction=0.4, out=tmp_path / name / "table.json")
        entries.append(ObjectEntry(family=str(file), pose=(1, 1, 0)))
    entries.append(ObjectEntry(family="box", pose=(3, 3, 0)))
    scenario = Scenario(start=(0, 0, 0), goal=(1, 0), objects=tuple(entries))
    folder = tmp_path / "out"
    for _ in range(2):
        own = with_own_objects(scenario, folder)
        names = [Path(o.family).name for o in own.objects]
        assert names == ["table.json", "table-2.json", "table.json", "box"]
        assert sorted(p.name for p in (folder / "objects").iterdir()) == ["table-2.json", "table.json"]
    assert [o.condition().mass for o in own.objects[:3]] == [3.0, 4.0, 3.0]
    assert with_own_objects(own, folder) == own
    gone = ObjectEntry(family="gone.json", pose=(1, 1, 0))
    with pytest.raises(ShmooError, match=r"gone\.json"):
        with_own_objects(scenario.model_copy(update={"objects": (gone,)}), folder)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"gaol": [1, 2]}, ("'gaol'", "'goal'")),
        ({"start": None}, ("'start'",)),
        ({"start": [0.0, 1.0]}, ("'start[2]'", "missing")),
        ({"goal": [0.0, "east"]}, ("'goal[1]'", "'east'")),
        ({"goal": [0.0, float("inf")]}, ("'goal[1]'", "finite")),
        ({"goal": [0.0, "0.4"]}, ("'goal[1]'", "'0.4'", "without quotes")),
        ({"goal": [0.0, True]}, ("'goal[1]'", "true", "number")),
        ({"seed": "3"}, ("'seed'", "'3'", "without quotes")),
        ({"limits": {"time_s": "60"}}, ("'limits.time_s'", "without quotes")),
        ({"start": [1, 1, 90]}, ("'start[2]'", "90", "radians", "1.571")),
        ({"start": [1, 1, -6.4]}, ("'start[2]'", "radians")),
        ({"objects": [{"family": "box", "pose": [0, 0, 180]}]}, ("'objects[0].pose[2]'", "radians", "3.142")),
        ({"seed": -1}, ("'seed'", "-1")),
        ({"senses": "keen"}, ("'senses'", "'keen'", "real or perfect")),
        ({"limits": {"time": 5}}, ("'limits.time'", "'time_s'")),
        ({"limits": {"time_s": -5}}, ("'limits.time_s'",)),
        ({"objects": [{"family": "sofa", "pose": [0, 0, 0]}]}, ("'objects[0].family'", "'sofa'", *FAMILIES)),
        ({"objects": [{"family": "box"}]}, ("'objects[0].pose'", "missing")),
        ({"objects": [{"family": "box", "pos": [0, 0, 0]}]}, ("'objects[0].pos'", "'pose'")),
        ({"objects": [{"family": "box", "pose": [0, 0, 0], "properties": {"mass": -2}}]}, ("mass = -2", "negative")),
        ({"objects": [{"family": "box", "pose": [0, 0, 0], "properties": {"size": [1, -1, 1]}}]}, ("size = -1",)),
        (
            {"objects": [{"family": "box", "pose": [0, 0, 0], "properties": {"mass": "big"}}]},
            ("mass = 'big'", "number"),
        ),
        ({"objects": [{"family": "box", "pose": [0, 0, 0], "properties": 3}]}, ("'objects[0].properties' is 3",)),
        ({"objects": {"family": "box"}}, ("'objects'", "list")),
        ({"limits": 4}, ("'limits' is 4", "mapping")),
        ({"limits": {"goal_tolerance_m": 1e-12}}, ("'limits.goal_tolerance_m'", "0.05")),
        ({"limits": {"time_s": 1e30}}, ("'limits.time_s'", "86400")),
        ({"objects": [{"family": "box", "pose": [0, 0, 0]}] * 1000}, ("'objects'", "50 items")),
    ],
)
def test_faults_are_said_in_one_sentence(tmp_path: Path, change: dict, words: tuple[str, ...]) -> None:
    path = write(tmp_path, GOOD | change)
    with pytest.raises(ShmooError) as error:
        load_scenario(path)
    text = str(error.value)
    assert str(path) in text and all(word in text for word in words), text
    assert "\n" not in text and text.endswith((".", "?")) and "Value error" not in text and "instance" not in text


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("010", 10), ("08", 8), ("0o17", 15), ("0x1F", 31), ("+5", 5), ("1e1", 10.0), ("5e-2", 0.05), (".5", 0.5),
        ("5.", 5.0), ("1.5E+3", 1500.0), ("true", True), ("FALSE", False), ("~", None), ("", None), ("1:30", "1:30"),
        ("1_000", "1_000"), ("yes", "yes"), ("off", "off"), ("0b11", "0b11"), ("2026-01-01", "2026-01-01"),
        ('"0.4"', "0.4"), ("!!float 3", 3.0),
    ],
)  # fmt: skip
def test_values_are_those_of_yaml_1_2(tmp_path: Path, text: str, value: object) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(f"a: {text}\n")
    found = read_mapping(path, "scenario")["a"]
    assert found == value and type(found) is type(value)


@pytest.mark.parametrize("text", ["!!int 1:30", "!!int x", "!!bool yes", "!!timestamp 2026-13-45", "9" * 5000])
def test_a_value_that_its_tag_does_not_fit_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(f"a: {text}\n")
    with pytest.raises(ShmooError, match="line 1"):
        read_mapping(path, "scenario")


SIGNS = st.text("0123456789.:_eExo+-trueFALSEnyi~#'\" ", max_size=6)
PLAIN = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False), st.integers(-(10**40), 10**40), st.booleans(), st.none(), SIGNS
)


@settings(max_examples=200, deadline=None)
@given(st.dictionaries(st.sampled_from(["a", "b", "c"]), PLAIN))
def test_what_is_written_is_read_back_as_it_was(tmp_path_factory: pytest.TempPathFactory, data: dict) -> None:
    path = tmp_path_factory.mktemp("yaml") / "a.yaml"
    path.write_bytes(yaml_text(data))
    assert read_mapping(path, "scenario") == data
    assert yaml.safe_load(path.read_bytes()) == data  # and by other programs, which know YAML 1.1


def test_a_mass_is_a_number() -> None:
    for mass in ("010", "1e1"):
        entry = ObjectEntry(family="box", pose=(0, 0, 0), properties={"mass": yaml_value(mass)})
        assert entry.condition().mass == 10.0
    for mass in ("yes", "true", "'3'"):
        with pytest.raises((ShmooError, ValidationError), match="mass"):
            ObjectEntry(family="box", pose=(0, 0, 0), properties={"mass": yaml_value(mass)}).condition()
    with pytest.raises(ShmooError, match="radians"):
        properties = {"caster_angle": [90.0, 0.0, 0.0, 0.0]}
        ObjectEntry(family="cart", pose=(0, 0, 0), properties=properties).condition()


def yaml_value(text: str) -> Any:
    return yaml.load(f"a: {text}", yaml_input._Loader)["a"]


@pytest.mark.parametrize("yaw", ["90", "-180", "6.4"])
def test_degrees_on_the_command_line_are_refused(tmp_path: Path, yaw: str) -> None:
    with pytest.raises(ShmooError, match=r"--start .* radians"):
        load_inputs(tmp_path / "room.yaml", None, f"1,1,{yaw}", "2,1")


def test_offsets_may_be_negative(tmp_path: Path) -> None:
    entry = {"family": "cart", "pose": [0, 0, 0], "properties": {"payload_x": -0.1, "caster_angle": [-1.0, 1, 0, 0]}}
    assert load_scenario(write(tmp_path, GOOD | {"objects": [entry]})).objects[0].properties["payload_x"] == -0.1


def two_rooms() -> OccupancyGrid:
    cells = np.zeros((40, 60), np.int8)
    cells[:, 30] = OCCUPIED
    cells[30:, 50:] = UNKNOWN
    return OccupancyGrid(cells, 0.1)


@pytest.mark.parametrize(
    ("start", "goal", "words"),
    [
        ((3.05, 2.0, 0.0), (1.0, 1.0), ("'start'", "inside a wall")),
        ((1.0, 1.0, 0.0), (5.5, 3.5), ("'goal'", "unknown space")),
        ((2.85, 2.0, 0.0), (1.0, 1.0), ("'start'", "0.15 m from a wall", "0.25 m")),
        ((9.0, 2.0, 0.0), (1.0, 1.0), ("'start'", "off the map", "x 0.00 to 6.00")),
        ((1.0, 1.0, 0.0), (4.0, 1.0), ("'goal'", "can't be reached")),
    ],
)
def test_start_and_goal_are_checked_against_the_map(
    start: tuple[float, float, float], goal: tuple[float, float], words: tuple[str, ...]
) -> None:
    with pytest.raises(ShmooError) as error:
        check_scenario(two_rooms(), Scenario(start=start, goal=goal), 0.25, "scene.yaml")
    assert all(word in str(error.value) for word in ("scene.yaml", *words)), str(error.value)


def test_a_good_scenario_passes_whatever_stands_about() -> None:
    entry = ObjectEntry(family="cart", pose=(1.5, 2.0, 0.0))
    check_scenario(two_rooms(), Scenario(start=(0.5, 1, 0), goal=(2.5, 3), objects=(entry,)), 0.25)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("start: [0, 0, 0]\ngoal: [1, 1]\nseed: 1\nseed: 2\n", ("'seed'", "twice", "line 4")),
        ("start: [0, 0, 0]\ngoal: [1, 1]\nlimits: {time_s: 5, time_s: 6}\n", ("'time_s'", "twice")),
        ("goal: " + "[" * 3000 + "]" * 3000, ("levels", "line 1")),
        ("goal: [1, 1", ("YAML",)),
    ],
    ids=["key twice", "inner key twice", "3,000 brackets", "open bracket"],
)
def test_text_that_means_nothing_clear_is_refused(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(ShmooError) as error:
        load_scenario(path)
    assert all(word in str(error.value) for word in (str(path), *words)) and "\n" not in str(error.value)


BOX = ObjectEntry(family="box", pose=(1.5, 2.0, 0.3))


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        ((3.0, 2.0, 0.0), ("in a wall",)),
        ((2.8, 2.0, 0.0), ("in a wall",)),
        ((5.5, 3.5, 0.0), ("in a wall or in unknown",)),
        ((0.1, 2.0, 0.0), ("off the map",)),
        ((90.0, 2.0, 0.0), ("off the map",)),
        ((0.8, 1.0, 0.0), ("where the robot is",)),
        ((1.9, 2.2, 0.0), ("in objects[0]",)),
    ],
)
def test_an_object_where_none_can_stand_is_named(pose: tuple[float, float, float], words: tuple[str, ...]) -> None:
    scenario = Scenario(start=(0.5, 1, 0), goal=(2.5, 3), objects=(BOX, BOX.model_copy(update={"pose": pose})))
    with pytest.raises(ShmooError) as error:
        check_places(two_rooms(), scenario, [(0.3, 0.3), (0.3, 0.3)], "scene.yaml")
    assert all(word in str(error.value) for word in ("scene.yaml: 'objects[1].pose'", *words)), str(error.value)


@pytest.mark.parametrize("resolution", [0.05, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_cells_are_areas_however_coarse_the_map(resolution: float, yaw: float) -> None:
    """A wall from x = 4 on in a map turned by ``yaw``: a box of 0.4 m has room up to x = 3.8, the robot up to 4 - r."""
    side = round(6 / resolution)
    cells = np.zeros((side, side), np.int8)
    cells[:, round(4 / resolution) :] = OCCUPIED
    grid = OccupancyGrid(cells, resolution, (1.0, -2.0, yaw))

    def pose(x: float) -> tuple[float, float, float]:
        return (*se2.transform_point(np.array(grid.origin), np.array([x, 3.0])).tolist(), yaw)

    robot, half = pose(1.0)[:2], (0.2, 0.2)
    for x in (3.5, 3.79, 3.8):
        check_place(grid, "the box", pose(x), half, robot=robot, others={})
    for x in (3.82, 3.9, 4.1, 4.19):
        with pytest.raises(ShmooError, match="stands in a wall"):
            check_place(grid, "the box", pose(x), half, robot=robot, others={})
    check_point(grid, pose(4 - 0.31)[:2], ROBOT_RADIUS, "the goal")
    for x in (4 - 0.27, 3.9, 3.99):
        with pytest.raises(ShmooError, match="from a wall"):
            check_point(grid, pose(x)[:2], ROBOT_RADIUS, "the goal")


@settings(deadline=None)
@given(st.floats(0, 6), st.floats(0, 6), st.floats(-3, 3), st.floats(0, 2))
def test_the_distance_to_cells_is_that_of_their_union(x: float, y: float, yaw: float, reach: float) -> None:
    cells = np.zeros((12, 12), np.int8)
    cells[2:5, 3], cells[8, 6:9] = OCCUPIED, UNKNOWN
    grid = OccupancyGrid(cells, 0.5, (-1.0, 0.5, 0.4))
    walls = shapely.union_all([shapely.box(3, 2, 4, 5), shapely.box(6, 8, 9, 9)])
    local = footprint_polygon((x, y, yaw), (0.3, 0.2))
    shape = shapely.transform(local, lambda p: se2.transform_point(np.array(grid.origin), p))
    true = shapely.distance(local, shapely.transform(walls, lambda p: 0.5 * p))
    found = wall_distance(grid, shape, reach)
    assert found == pytest.approx(true, abs=1e-9) if true < reach - 1e-9 else found >= reach - 1e-9


def test_objects_on_free_floor_pass() -> None:
    scenario = Scenario(
        start=(0.5, 1, 0), goal=(2.5, 3), objects=(BOX, BOX.model_copy(update={"pose": (1.5, 3.0, 0.0)}))
    )
    check_places(two_rooms(), scenario, [(0.3, 0.3), (0.3, 0.3)])


def test_a_mass_alone_is_the_whole_objects_mass() -> None:
    """The seed draws a load for every other box; 6 kg are 6 kg all the same."""
    seeds = [s for s in range(20) if ObjectEntry(family="box", pose=(0, 0, 0), seed=s).condition().payload > 0]
    assert seeds
    for seed in seeds:
        entry = ObjectEntry(family="box", pose=(0, 0, 0), seed=seed, properties={"mass": 6.0})
        assert entry.condition().total_mass == 6.0
        loaded = entry.model_copy(update={"properties": {"mass": 6.0, "payload": 2.0}})
        assert loaded.condition().total_mass == 8.0


@pytest.mark.parametrize("name", ["box_in_doorway", "locked_wheelchair", "three_objects"])
def test_the_scenarios_that_come_with_the_package_fit_their_map(name: str) -> None:
    grid, scenario = load_inputs(None, ROOT / "experiments" / "scenarios" / f"{name}.yaml", None, None)
    check_scenario(grid, scenario, ROBOT_RADIUS)
    check_places(grid, scenario, [o.condition().half_extents for o in scenario.objects], name)
