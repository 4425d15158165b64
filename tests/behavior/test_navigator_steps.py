"""The navigator as a state machine in the toy world: transitions, pure steps, late decisions, what is no number."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from toy import toy_scenario
from toy_world import HALF, Stand, World, plain_run, reasons, run

from shmoo_mjx.behavior.interaction import setup_of
from shmoo_mjx.behavior.navigator import MODES, Navigator, init, step
from shmoo_mjx.behavior.state import Mode, NavigatorConfig
from shmoo_mjx.planning.maps import FREE, OCCUPIED, OccupancyGrid
from shmoo_mjx.run.recording import Recording
from shmoo_mjx.run.replay import differences


def test_the_toy_scenario_is_what_it_says() -> None:
    grid, _ = toy_scenario(2, True)
    assert isinstance(grid, OccupancyGrid)
    assert grid.values_at((3.0, 2.0)) == 0 and grid.values_at((3.0, 0.6)) == 0 and grid.values_at((3.0, 3.2)) == 100
    assert toy_scenario(1, True)[0].values_at((3.0, 0.6)) == 100


@pytest.mark.slow
def test_runs_keep_to_the_transition_table() -> None:
    for doors, movable in ((1, True), (2, False), (1, False)):
        navigator, _ = plain_run(doors, movable)
        for transition in navigator.transitions:
            assert transition.target in MODES[transition.source].leads_to, transition


def test_a_step_changes_nothing_but_what_it_returns() -> None:
    grid, scenario = toy_scenario(1, True)
    world = World(scenario.start, scenario.objects[0].pose, movable=True)
    setup = setup_of([HALF], Stand(world))
    state, seen = init(grid, scenario.goal), world.observe()
    for _ in range(60):
        once, again = step(setup, state, seen), step(setup, state, seen)
        for a, b in zip(once[1], again[1], strict=True):
            np.testing.assert_array_equal(a, b)
        assert [type(e) for e in once[2]] == [type(e) for e in again[2]]
        state, seen = once[0], world.step(once[1])


def test_a_decision_takes_effect_when_it_would_be_known_and_the_robot_goes_on_until_then() -> None:
    navigator, world = run(1, config=NavigatorConfig(planning_time=0.3))
    assert navigator.mode is Mode.DONE
    found = next(t for t in navigator.transitions if t.target is Mode.FOLLOW)
    assert found.t == pytest.approx(0.3)
    probe = next(t.t for t in navigator.transitions if t.target is Mode.PROBE)
    verdict = next(t.t for t in navigator.transitions if t.target is Mode.PUSH)
    at_once, _ = plain_run(1)
    before = [next(t.t for t in at_once.transitions if t.target is m) for m in (Mode.PROBE, Mode.PUSH)]
    assert verdict - probe >= before[1] - before[0] + 0.2
    assert np.linalg.norm(world.velocity) < 0.15


def test_a_decision_is_void_if_the_mode_has_changed_meanwhile() -> None:
    grid, scenario = toy_scenario(1, True)
    world = World(scenario.start, scenario.objects[0].pose, movable=True)
    setup = setup_of([HALF], Stand(world), NavigatorConfig(planning_time=0.3))
    state, _, _ = step(setup, init(grid, scenario.goal), world.observe())
    assert state.pending is not None and state.pending.decided.mode is Mode.FOLLOW
    state, _, _ = step(setup, replace(state, mode=Mode.DONE), world.observe())
    assert state.mode is Mode.DONE and state.pending is None


@pytest.mark.parametrize("field", ["robot_pose", "robot_twist", "lean", "object_pose", "object_twist", "wrench"])
def test_what_is_no_number_never_reaches_a_command(field: str) -> None:
    grid, scenario = toy_scenario(1, True)
    world = World(scenario.start, scenario.objects[0].pose, movable=True)
    navigator = Navigator(grid, scenario.goal, [HALF], Stand(world))
    seen, modes = world.observe(), set()
    for i in range(300):
        broken = seen._replace(**{field: getattr(seen, field) * np.nan}) if i % 7 == 3 else seen
        command = navigator.tick(broken)
        modes.add(navigator.mode)
        assert all(np.isfinite(value).all() for value in command)
        seen = world.step(command)
        if navigator.finished:
            break
    assert Mode.PROBE in modes


def test_a_safe_stop_does_not_lean_for_another_sample() -> None:
    grid, scenario = toy_scenario(1, True)
    world = World(scenario.start, scenario.objects[0].pose, movable=True)
    stand = Stand(world)
    lost = stand.step

    def blind(*args: Any, **kwargs: Any) -> Any:
        u, state, _ = lost(*args, **kwargs)
        return np.full_like(u, 0.15), state, SimpleNamespace(ok=False)

    navigator = Navigator(grid, scenario.goal, [HALF], stand)
    seen = world.observe()
    while navigator.mode is not Mode.PROBE:
        seen = world.step(navigator.tick(seen))
    stand.step = blind
    command = navigator.tick(seen)
    assert navigator.mode is Mode.RETREAT and "safe stop" in navigator.transitions[-1].reason
    assert command.u[0, 0] < 0.05


def test_a_probe_that_lost_contact_does_not_plan_at_every_sample() -> None:
    """Half a second of contact, and the object has rolled 0.15 m: too little for a verdict, enough to be looked at."""

    def rolls(world: World, navigator: Navigator) -> None:
        segment = navigator.segment
        if navigator.mode is Mode.PROBE and segment is not None and segment.push is not None:
            world.foreseen = False
            if world.time - segment.push.started > 0.5:
                world.box[0] += 0.02
                world.pose[0] -= 0.02

    navigator, _ = run(1, happens=rolls, seconds=25.0)
    times = [d.t for d in navigator.decisions]
    assert len(times) > 1 and np.diff(times).min() >= 0.5 - 1e-6


@pytest.mark.parametrize("doors", [1, 2])
def test_what_sticks_is_left_for_the_way_round_and_without_one_tried_on_every_side_until_none_is_worth_it(
    doors: int,
) -> None:
    def sticks(world: World, navigator: Navigator) -> None:
        if navigator.mode is Mode.PUSH and world.box[0] > 3.15:
            world.foreseen = world.movable = False

    navigator, _ = run(doors, happens=sticks, seconds=200.0)
    probes = [t.target for t in navigator.transitions].count(Mode.PROBE)
    if doors == 2:
        assert navigator.mode is Mode.DONE and probes <= 1
        return
    assert navigator.mode is Mode.FAILED and "registered as an obstacle" in reasons(navigator)
    tried = navigator.belief.objects[0].failed_faces
    assert len(tried) == probes and len(set(tried)) >= 2


def test_an_object_out_of_reach_is_given_up_once() -> None:
    """It closes a corridor so that no face can be stood off from, and nothing changes that."""
    cells = np.full((80, 120), OCCUPIED, dtype=np.int8)
    cells[31:49, 6:114] = FREE
    world = World((0.6, 2.0, 0.0), (1.15, 2.0, 0.0), movable=True)
    navigator = Navigator(OccupancyGrid(cells, 0.05), [5.2, 2.0], [HALF], Stand(world))
    seen = world.observe()
    while not navigator.finished and world.time < 15.0:
        seen = world.step(navigator.tick(seen))
    given_up = [t.t for t in navigator.transitions if "registered as an obstacle" in t.reason]
    assert navigator.mode is Mode.FAILED
    assert len(given_up) == 1


def test_a_replay_of_what_was_perceived_gives_the_same_commands() -> None:
    grid, scenario = toy_scenario(1, True)
    world = World(scenario.start, scenario.objects[0].pose, movable=True)

    def fresh() -> Navigator:
        return Navigator(grid, scenario.goal, [HALF], Stand(world))

    navigator, seen, rows, commands = fresh(), world.observe(), [], []
    for _ in range(80):
        rows.append(seen)
        commands.append(navigator.tick(seen))
        seen = world.step(commands[-1])
    stacked = [type(r[0])(*(np.stack(c) for c in zip(*r, strict=True))) for r in (rows, commands)]
    recorded = Recording(stacked[0], stacked[1], np.repeat(np.array([scenario.goal], dtype=float), 80, axis=0))
    assert differences(fresh(), recorded) is None
    changed = stacked[0].robot_pose.copy()
    changed[40, 0, 0] += 1e-6
    found = differences(fresh(), recorded._replace(observations=stacked[0]._replace(robot_pose=changed)))
    assert found is not None and found.sample == 40 and "sample 40" in str(found)
