"""What a person does to the world happens, nothing else changes, and what can't be is refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh

from shmoo_mjx.behavior.state import Mode
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.live.scenes import object_files, scene_named, scenes
from shmoo_mjx.live.session import Session
from shmoo_mjx.planning.maps import FREE, OccupancyGrid, save_map
from shmoo_mjx.planning.scenario import load_scenario
from shmoo_mjx.plant.mesh import add_object
from shmoo_mjx.report.trace import load_result
from shmoo_mjx.run.scenario_run import load_inputs

pytest.importorskip("viser")


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    made = Session(load_weights(), lambda: scene_named("box_in_doorway", tmp_path), "real", tmp_path)
    yield made
    made.close()


def run(session: Session, samples: int) -> None:
    for _ in range(samples):
        session.step()


def free_place(session: Session) -> tuple[float, float, float]:
    """Ahead of the robot, in its camera's sight."""
    x, y, yaw = session.simulation.true.robot_pose[0]
    return float(x + 1.2 * np.cos(yaw)), float(y + 1.2 * np.sin(yaw)), 0.3


def test_the_same_world_goes_on_as_if_nothing_had_been_changed(session: Session) -> None:
    run(session, 8)
    simulation = session.simulation
    command = simulation.decide()
    before, physics = simulation.world, simulation.world.truth.physics.copy()
    simulation.change(session.scenario)
    np.testing.assert_array_equal(simulation.world.truth.physics, physics)
    after, seen = simulation.engine.step(simulation.world, command)
    same, also_seen = simulation.engine.step(before, command)
    np.testing.assert_array_equal(after.truth.physics, same.truth.physics)
    for one, other in zip(seen, also_seen, strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_is_put_down_stands_there_is_seen_and_nothing_else_moves(session: Session) -> None:
    run(session, 5)
    before, pose = session.simulation.true, free_place(session)
    session.add("cart", pose, {"mass": 12.0, "payload": 5.0, "friction": 0.6})
    simulation = session.simulation
    np.testing.assert_allclose(simulation.true.object_pose[0, -1], pose, atol=1e-6)
    np.testing.assert_array_equal(simulation.true.object_pose[0, :-1], before.object_pose[0])
    np.testing.assert_array_equal(simulation.true.robot_pose, before.robot_pose)
    assert simulation.conditions[-1].total_mass == pytest.approx(17.0) and simulation.time == float(before.time[0])
    assert np.isnan(simulation.observation.object_pose[0, -1]).all()
    run(session, 5)
    assert np.linalg.norm(session.simulation.observation.object_pose[0, -1, :2] - pose[:2]) < 0.1
    assert len(simulation.navigator.belief.objects) >= 1 and not simulation.history.falls


def test_an_object_is_carried_elsewhere_and_rests_there(session: Session) -> None:
    run(session, 3)
    pose = free_place(session)
    session.place(0, pose)
    np.testing.assert_allclose(session.simulation.true.object_pose[0, 0], pose, atol=1e-9)
    run(session, 5)
    np.testing.assert_allclose(session.simulation.true.object_pose[0, 0], pose, atol=0.01)


@pytest.mark.parametrize("bearing", [0.0, 0.5 * np.pi, np.pi])
def test_a_shove_gives_an_object_its_impulse_and_friction_stops_it(session: Session, bearing: float) -> None:
    simulation = session.simulation
    before, mass = simulation.true, simulation.conditions[0].total_mass
    robot, box = before.robot_pose[0, :2], before.object_pose[0, 0, :2]
    away = (box - robot) / np.linalg.norm(box - robot)
    session.shove(0, 6.0, bearing)
    twist = session.simulation.true.object_twist[0, 0, :2]
    assert mass * np.linalg.norm(twist) == pytest.approx(6.0, rel=1e-3)
    assert twist @ away == pytest.approx(np.linalg.norm(twist) * np.cos(bearing), abs=1e-6)
    np.testing.assert_array_equal(session.simulation.true.robot_pose, before.robot_pose)
    run(session, 15)
    moved = session.simulation.true.object_pose[0, 0, :2] - box
    assert np.linalg.norm(moved) > 0.005 and np.linalg.norm(session.simulation.true.object_twist[0, 0, :2]) < 0.05
    assert not simulation.history.falls


def test_settings_reach_the_robot_and_the_result(tmp_path: Path) -> None:
    settings = ("control.temperature=0.3", "navigator.goal_tolerance=0.3")
    session = Session(
        load_weights(), lambda: scene_named("box_in_doorway", tmp_path), "perfect", tmp_path, settings=settings
    )
    assert session.controller.config.control.temperature == 0.3
    session.reset()
    assert session.simulation.navigator.config.goal_tolerance == 0.3
    run(session, 2)
    result = load_result(session.save_report("run").parent / "result.json")
    assert result["settings"] == list(settings) and "goal_tolerance=0.3" in result["command"]
    session.close()


@pytest.mark.slow
def test_the_settings_of_mppi_change_in_the_middle_of_a_push(tmp_path: Path) -> None:
    session = Session(load_weights(), partial(scene_named, "box_in_doorway", tmp_path), "perfect", tmp_path)
    navigator = session.simulation.navigator
    navigator.setup = navigator.setup._replace(config=replace(navigator.config, goes_round="never"))
    while session.plan is None and session.simulation.time < 40.0:
        session.step()
    before, settings = session.controller, ("control.num_rollouts=64", "control.horizon=20")
    made = session.compiled(settings)
    assert session.controller is before and session.settings == ()
    session.use(made, settings)
    session.use(made, settings)
    run(session, 10)
    assert session.plan is not None and session.plan.controls.shape[:2] == (64, 20)
    assert session.settings == settings and not session.simulation.history.falls
    assert navigator.mode in (Mode.PROBE, Mode.PUSH)
    session.close()


def test_loads_and_brakes_reach_the_physics(session: Session) -> None:
    session.add("wheelchair", free_place(session), {"mass": 10.0})
    index = len(session.scenario.objects) - 1

    def weight() -> float:
        model = session.simulation.scene.model
        return float(model.body_subtreemass[model.body(f"object{index}/object").id])

    light = weight()
    session.alter(index, payload=40.0)
    assert weight() - light == pytest.approx(40.0)
    session.brake(index, True)
    assert session.simulation.conditions[index].locked == (True, True, False, False)
    session.brake(index, False)
    assert not any(session.simulation.conditions[index].locked)


@pytest.mark.parametrize("pose", ["wall", "robot", "other", "outside"])
def test_places_where_nothing_can_stand_are_refused_and_nothing_changes(session: Session, pose: str) -> None:
    simulation, (x0, y0, _, _) = session.simulation, session.simulation.grid.bounds
    places = {
        "wall": (x0 + 0.3, y0 + 0.02, 0.0),
        "robot": (*simulation.true.robot_pose[0, :2], 0.0),
        "other": tuple(simulation.true.object_pose[0, 0]),
        "outside": (x0 - 5.0, y0, 0.0),
    }
    before, number = session.scenario, session.started
    with pytest.raises(ShmooError):
        session.add("box", places[pose], {"mass": 5.0})
    assert session.scenario is before and session.started == number and session.simulation is simulation


def test_what_makes_no_sense_is_refused(session: Session) -> None:
    x, y, yaw = free_place(session)
    for bad in (
        lambda: session.add("sofa", (x, y, yaw), {}),
        lambda: session.add("box", (x, y, float("nan")), {}),
        lambda: session.add("box", (x, y, yaw), {"mass": -1.0}),
        lambda: session.alter(7, payload=1.0),
        lambda: session.alter(0, payload=float("inf")),
        lambda: session.brake(0, True),
        lambda: session.head_for(float("inf"), 0.0),
        lambda: session.head_for(*session.simulation.grid.bounds[:2]),
        lambda: session.save_scenario("../elsewhere"),
        lambda: session.save_report("no time has passed"),
        lambda: scene_named("no such scene", session.out),
    ):
        number, conditions, scene = session.started, session.simulation.conditions, session.simulation.scene
        with pytest.raises(ShmooError):
            bad()
        assert session.started == number
        assert session.simulation.conditions is conditions and session.simulation.scene is scene


def test_another_goal_is_headed_for(session: Session) -> None:
    run(session, 3)
    x, y, yaw = session.simulation.true.robot_pose[0]
    goal = (float(x + 0.5 * np.cos(yaw)), float(y + 0.5 * np.sin(yaw)))
    session.head_for(*goal)
    run(session, 70)
    assert np.linalg.norm(session.simulation.true.robot_pose[0, :2] - goal) < 0.25


def test_a_saved_scene_is_a_scenario_and_a_saved_run_a_report(session: Session, tmp_path: Path) -> None:
    run(session, 4)
    session.add("box", free_place(session), {"mass": 5.0})
    run(session, 4)
    path = session.save_scenario("mine")
    _, scenario = load_inputs(None, path, None, None)
    assert len(scenario.objects) == len(session.scenario.objects) and "mine" in scenes(tmp_path)
    true = session.simulation.true
    np.testing.assert_allclose(scenario.start, true.robot_pose[0])
    np.testing.assert_allclose([o.pose for o in scenario.objects], true.object_pose[0])
    session.load(lambda: scene_named("mine", tmp_path))
    np.testing.assert_allclose(session.simulation.true.robot_pose[0], scenario.start, atol=1e-6)

    run(session, 3)
    page = session.save_report("run")
    assert page.stat().st_size > 10_000
    assert len(load_result(page.parent / "result.json")["objects"]) == len(scenario.objects)
    assert load_scenario(page.parent / "scenario.yaml").objects


def test_saved_scenes_and_runs_can_be_moved(
    session: Session, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path_factory.mktemp("here")
    monkeypatch.chdir(here)
    trimesh.creation.cylinder(radius=0.25, height=0.6).export("stool.stl")
    stool = add_object(Path("stool.stl"), mass=5.0, friction=0.35).resolve()
    session.add(str(stool), free_place(session), {})
    run(session, 3)
    files = session.save_scenario("mine"), session.save_report("run").parent / "scenario.yaml"
    stool.unlink()
    moved = here / "moved"
    tmp_path.rename(moved)
    for file in files:
        text = (moved / file.relative_to(tmp_path)).read_text()
        assert "stool.json" in text and str(here) not in text and str(tmp_path) not in text
        _, scenario = load_inputs(None, moved / file.relative_to(tmp_path), None, None)
        assert scenario.objects[-1].condition().mass == 5.0
    moved.rename(tmp_path)


def test_what_a_scene_was_loaded_from_is_not_saved_over(session: Session, tmp_path: Path) -> None:
    scene = session.save_scenario("mine")
    assert session.save_scenario("mine") == scene  # one's own, as often as one likes
    (tmp_path / "floor.yaml").write_text((tmp_path / "mine.map.yaml").read_text())
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    session.load(scenes(tmp_path)["mine"])
    run(session, 2)
    for name, says in (("mine", "input of this command"), ("floor", "is a map's YAML")):
        with pytest.raises(ShmooError, match=says):
            session.save_scenario(name)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    assert session.save_scenario("other").is_file()


def test_a_run_in_which_objects_came_makes_a_report(session: Session) -> None:
    run(session, 4)
    session.add("box", free_place(session), {"mass": 5.0})
    run(session, 3)
    assert session.save_report("later").exists()
    assert np.isnan(np.array(session.simulation.history.rows[0].object_pose)[-1]).all()


def test_begin_again_is_the_scene_as_it_was_loaded(session: Session) -> None:
    start = session.simulation.true.robot_pose.copy()
    run(session, 10)
    session.add("box", free_place(session), {"mass": 5.0})
    session.reset()
    np.testing.assert_array_equal(session.simulation.true.robot_pose, start)
    assert len(session.scenario.objects) == 1 and session.simulation.time == 0.0


@pytest.mark.slow
def test_while_it_pushes_it_says_what_the_last_decision_on_this_push_was(tmp_path: Path) -> None:
    session = Session(load_weights(), partial(scene_named, "box_in_doorway", tmp_path), "perfect", tmp_path)
    navigator = session.simulation.navigator
    # The way round is short: it would go round.
    navigator.setup = navigator.setup._replace(config=replace(navigator.config, goes_round="never"))
    while session.probability is None and session.simulation.time < 40.0:
        session.step()
    # The decision to push falls before there is a push.
    assert len(navigator.decisions) > 1 and session.probability == navigator.decisions[-1].probability
    while navigator.mode in (Mode.PROBE, Mode.PUSH) and session.simulation.time < 80.0:
        assert session.probability == navigator.decisions[-1].probability
        session.step()
    assert session.probability is None
    session.close()


def test_objects_and_maps_of_ones_own_are_found_by_name(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    trimesh.creation.cylinder(radius=0.25, height=0.6).export("stool.stl")
    add_object(Path("stool.stl"), mass=5.0, friction=0.35)
    Path("other.json").write_text("{}")
    Path("compose.yaml").write_text("services: {}\n")
    save_map(session.simulation.grid, "floor.yaml")
    save_map(session.simulation.grid, "floor [2].yml")
    assert object_files(session.out) == {"stool": here / "stool.json"}
    found = scenes(session.out)
    assert {"map floor", "map floor [2]", "map office", "three_objects"} <= set(found) and "compose" not in found
    for load in (found["map floor"], partial(scene_named, "floor.yaml", session.out)):
        session.load(load)
        run(session, 5)
        assert session.simulation.navigator.finished and not session.scenario.objects
    x, y, _ = session.simulation.true.robot_pose[0]
    session.head_for(x + 0.6, y)
    session.add(str(here / "stool.json"), (x, y + 1.2, 0.0), {"payload": 2.0})
    run(session, 3)
    assert not session.simulation.navigator.finished and session.simulation.conditions[0].mass == 5.0
    again = scene_named(str(session.save_scenario("kept")), session.out)[1]
    assert again.objects[0].condition() == session.simulation.conditions[0]


def test_a_map_without_room_is_refused(tmp_path: Path) -> None:
    save_map(OccupancyGrid(np.full((9, 9), FREE, dtype=np.int8), 0.05), tmp_path / "tiny.yaml")
    with pytest.raises(ShmooError, match="has no room for a robot"):
        scene_named(str(tmp_path / "tiny.yaml"), tmp_path)
