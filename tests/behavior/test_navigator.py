"""The navigator's behaviour in the toy world: what it decides, and what it does about surprises."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from toy import toy_scenario
from toy_world import HALF, Stand, World, plain_run, reasons, run, said, visited

from shmoo_mjx.behavior import push_options
from shmoo_mjx.behavior.belief import Status
from shmoo_mjx.behavior.interaction import PROBE_ROOM
from shmoo_mjx.behavior.navigator import Navigator
from shmoo_mjx.behavior.state import Mode, NavigatorConfig
from shmoo_mjx.geometry.faces import heading
from shmoo_mjx.planning.maps import FREE, OCCUPIED, OccupancyGrid
from shmoo_mjx.types import DT, Observation


def test_a_movable_box_in_the_only_doorway_is_pushed_away() -> None:
    navigator, world = plain_run(1)
    assert navigator.mode is Mode.DONE
    assert {Mode.APPROACH, Mode.CONTACT, Mode.PROBE, Mode.PUSH, Mode.RETREAT} <= visited(navigator)
    assert np.linalg.norm(world.box[:2] - (3.0, 2.025)) > 0.3


def test_a_box_that_is_hardly_felt_is_noticed_as_it_gives_way() -> None:
    def light(world: World, navigator: Navigator) -> None:
        world.resistance = 2.5

    navigator, _ = run(1, happens=light)
    assert navigator.mode is Mode.DONE
    began = next(t.t for t in navigator.transitions if t.target is Mode.CONTACT)
    probe = next(t.t for t in navigator.transitions if t.target is Mode.PROBE)
    assert probe - began < 4.0


def test_in_a_corridor_the_first_goal_may_be_far() -> None:
    """A box in a corridor of 0.9 m: the next place where it is out of the way is the room behind it, 2 m on."""
    cells = np.full((80, 120), OCCUPIED, dtype=np.int8)
    cells[31:49, 6:80] = FREE
    cells[6:74, 80:114] = FREE
    world = World((0.8, 2.0, 0.0), (2.0, 2.0, 0.0), movable=True)
    navigator = Navigator(OccupancyGrid(cells, 0.05), [5.2, 1.0], [HALF], Stand(world))  # type: ignore[arg-type]
    for _ in range(2):
        navigator.tick(world.observe())
    assert navigator.mode is Mode.APPROACH, reasons(navigator)
    assert navigator.segment is not None
    assert np.linalg.norm(navigator.segment.goal[:2] - world.box[:2]) > 1.5


def test_a_box_that_stands_aslant_behind_a_doorway_is_pushed_at_its_corner() -> None:
    """From the doorway the robot has room for none of its sides."""
    grid, scenario = toy_scenario(1, True)
    world = World(scenario.start, (3.4, 2.025, np.pi / 4), movable=True)
    navigator = Navigator(grid, scenario.goal, [HALF], Stand(world))  # type: ignore[arg-type]
    while navigator.mode in (Mode.REPLAN, Mode.FOLLOW):
        world.step(navigator.tick(world.observe()))
    assert navigator.mode is Mode.APPROACH, reasons(navigator)
    assert navigator.segment is not None
    assert heading(world.box, navigator.segment.face) == pytest.approx(0.0)
    assert navigator.segment.side >= 4


@pytest.mark.parametrize("moves", [True, False])
def test_only_what_stands_still_is_called_immovable_once_it_has_been_called_movable(moves: bool) -> None:
    """Later looks foresee no motion; the box goes on, or sticks."""

    def worsens(world: World, navigator: Navigator) -> None:
        if navigator.mode is Mode.PUSH:
            world.foreseen, world.movable = False, moves

    navigator, _ = run(1, happens=worsens)
    assert ("registered as an obstacle" in reasons(navigator)) != moves
    assert (navigator.mode is Mode.DONE) == moves


def test_what_rolls_away_after_a_short_touch_is_let_go() -> None:
    def rolls(world: World, navigator: Navigator) -> None:
        if navigator.segment is not None and navigator.segment.push is not None:
            world.foreseen = False
            world.box[0] += 0.05 if world.time - navigator.segment.push.started < 0.8 else 0.0
            world.pose[:2] -= 0.05 * np.array([np.cos(world.pose[2]), np.sin(world.pose[2])])

    navigator, _ = run(1, happens=rolls, seconds=25.0)
    began = next(t.t for t in navigator.transitions if t.target is Mode.PROBE)
    lost = next(t for t in navigator.transitions if t.target is Mode.RETREAT)
    assert ("lost" in lost.reason or "no longer blocks" in lost.reason) and lost.t - began < 6.0


@pytest.mark.parametrize("status", [Status.FIXED, Status.PARKED, Status.UNKNOWN])
@pytest.mark.parametrize("gap", [0.2, 0.24])
def test_what_it_stands_too_near_to_does_not_keep_it_from_setting_out(status: Status, gap: float) -> None:
    grid, scenario = toy_scenario(2, movable=False)
    world = World((3.0 - HALF[0] - gap, 2.0, np.pi), scenario.objects[0].pose, movable=False)
    navigator = Navigator(
        grid, [1.0, 2.6], [HALF], Stand(world), config=NavigatorConfig(planning_time=0.1), first_status=[status]
    )  # type: ignore[arg-type]
    while not navigator.finished and world.time < 20.0:
        world.step(navigator.tick(world.observe()))
    assert navigator.mode is Mode.DONE
    assert len(navigator.plans) == 1, reasons(navigator)


def test_an_immovable_box_is_registered_and_gone_round() -> None:
    navigator, _ = run(doors=2, movable=False, config=NavigatorConfig(decides_by="K"))
    assert navigator.mode is Mode.DONE
    assert navigator.belief.objects[0].status is Status.FIXED
    assert Mode.PUSH not in visited(navigator) and not navigator.decisions[-1].manipulable


def test_the_way_round_one_object_does_not_lead_through_another_that_is_gone_round() -> None:
    """A box in each of two doorways, equally far: it stops to push one, and does not turn from one to the other."""
    grid, scenario = toy_scenario(2, True)
    world = World((1.8, 1.3, 0.0), scenario.objects[0].pose, movable=True)
    navigator = Navigator(grid, scenario.goal, [HALF, HALF], Stand(world))  # type: ignore[arg-type]
    seen = world.observe()
    boxes = np.array([[scenario.objects[0].pose, (3.0, 0.6, 0.0)]])
    both = {"object_pose": boxes, "object_twist": np.zeros((1, 2, 3)), "wrench": np.zeros((1, 2, 3)),
            "object_age": np.zeros((1, 2)), "detected": np.ones((1, 2), dtype=bool)}  # fmt: skip
    for _ in range(4):
        navigator.tick(seen._replace(**both))
    assert navigator.mode is Mode.APPROACH, reasons(navigator)
    assert len([t for t in navigator.transitions if t.target is Mode.FOLLOW]) <= 2


def test_gaps_that_look_wide_enough_only_from_afar_are_not_tried_for_ever() -> None:
    """A registered box in each of two doorways: the gap beside the one that is far always seems wide enough."""
    cells = np.full((160, 120), FREE, dtype=np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = cells[:, 59:61] = OCCUPIED
    cells[20:41, 59:61] = cells[120:141, 59:61] = FREE
    far = np.array([(3.0, 1.915, 0.0), (3.0, 6.915, 0.0)])
    world = World((1.2, 4.0, 0.0), (3.0, 1.915, 0.0), movable=False)
    navigator = Navigator(
        OccupancyGrid(cells, 0.05), [5.0, 4.0], [HALF, HALF], Stand(world),
        first_status=[Status.FIXED, Status.FIXED],
    )  # type: ignore[arg-type]  # fmt: skip
    still = {"object_twist": np.zeros((1, 2, 3)), "wrench": np.zeros((1, 2, 3)), "object_age": np.zeros((1, 2)),
             "detected": np.ones((1, 2), dtype=bool)}  # fmt: skip
    while not navigator.finished and world.time < 120.0:
        seen = far.copy()
        seen[np.linalg.norm(far[:, :2] - world.pose[:2], axis=1) < 2.5, 1] -= 0.14
        world.step(navigator.tick(world.observe()._replace(object_pose=seen[None], **still)))
    assert navigator.mode is Mode.FAILED, reasons(navigator)
    assert reasons(navigator).count("(fixed) is in the way") == 4, reasons(navigator)


def test_with_no_way_left_it_says_so_and_stands_still() -> None:
    navigator, world = run(doors=1, movable=False)
    assert navigator.mode is Mode.FAILED
    assert "every route to the goal is blocked" in navigator.transitions[-1].reason
    assert np.linalg.norm(world.velocity) < 0.15
    known = navigator.belief.objects[0]
    assert known.pushes > 0 and known.failed_faces and known.given_up == known.pushes
    navigator.head_for([5.0, 2.0], world.time)
    assert navigator.belief.objects[0].failed_faces == ()


@pytest.mark.parametrize(("pushes", "again"), [(2, False), (3, True)])
def test_what_was_given_up_is_looked_at_again_once_something_has_been_pushed_since(pushes: int, again: bool) -> None:
    grid, scenario = toy_scenario(1, False)
    world = World(scenario.start, scenario.objects[0].pose, movable=False)
    navigator = Navigator(grid, scenario.goal, [HALF], Stand(world))  # type: ignore[arg-type]
    navigator.tick(world.observe())
    given_up = navigator.state.with_object(0, status=Status.FIXED, given_up=2, pushes=pushes)
    navigator.state = replace(given_up, mode=Mode.REPLAN)
    navigator.tick(world.observe())
    assert ("is looked at again" in said(navigator)) == again
    assert (navigator.mode is Mode.FOLLOW) == again


@pytest.mark.slow
def test_what_holds_the_hands_and_is_never_felt_is_given_up() -> None:
    """As where two objects carry each other's tags: what is felt is said of the other one."""

    def numb(seen: Observation) -> Observation:
        return seen._replace(wrench=np.zeros_like(seen.wrench))

    navigator, _ = run(1, movable=False, sees=numb, seconds=300.0)
    assert navigator.mode is Mode.FAILED
    assert Mode.PROBE not in visited(navigator) and "was not felt" in reasons(navigator)


@pytest.mark.parametrize("decides_by", ["time", "K"])
def test_the_first_decision_falls_after_a_second_of_contact(decides_by: Any) -> None:
    navigator, _ = run(1, config=NavigatorConfig(decides_by=decides_by))
    began = next(t.t for t in navigator.transitions if t.target is Mode.PROBE)
    decided = next(t.t for t in navigator.transitions if t.target is Mode.PUSH)
    assert 1.0 - DT < decided - began < 2.0


@pytest.mark.parametrize(
    ("decides_by", "doors"), [("time", 2), pytest.param("time", 1, marks=pytest.mark.slow), ("K", 2)]
)
def test_what_holds_is_left_however_well_the_model_speaks_of_it(decides_by: Any, doors: int) -> None:
    """Each push ends once it stalls, and the next one on that side is trusted less; by Algorithm 1 it is registered."""

    def holds(world: World, navigator: Navigator) -> None:
        world.movable, navigator.setup.controller.foresees = False, True

    config = NavigatorConfig(decides_by=decides_by)
    navigator, _ = run(doors, movable=False, happens=holds, config=config, seconds=240.0)
    assert navigator.mode is (Mode.DONE if doors == 2 else Mode.FAILED)
    for begun, ended in zip(
        [t.t for t in navigator.transitions if t.target is Mode.PROBE],
        [t.t for t in navigator.transitions if t.target is Mode.RETREAT],
        strict=True,
    ):
        assert ended - begun < push_options.GIVES_UP + 1.0


@pytest.mark.parametrize("movable", [True, False])
def test_the_probe_leans_in_firmly_until_the_object_moves(movable: bool) -> None:
    navigator, _ = plain_run(1, movable)
    rooms = navigator.setup.controller.rooms
    firm = [room == PROBE_ROOM for room in rooms]
    assert firm[0] and not all(firm)


def test_a_registered_object_that_somebody_moves_counts_as_unknown_again() -> None:
    moved_at = []

    def carry(world: World, navigator: Navigator) -> None:
        known = navigator.belief.objects.get(0)
        if known is not None and known.status is Status.FIXED and not moved_at:
            world.box[:] = (4.6, 1.0, 0.3)
            moved_at.append(world.time)

    navigator, _ = run(doors=2, movable=False, config=NavigatorConfig(decides_by="K"), happens=carry)
    assert navigator.mode is Mode.DONE and moved_at
    assert "object 0 (fixed) stands" in said(navigator) and "counts as unknown again" in said(navigator)


def test_an_object_that_somebody_puts_into_the_way_is_noticed_and_dealt_with() -> None:
    def carry(world: World, navigator: Navigator) -> None:
        if abs(world.time - 2.0) < 0.01:
            world.box[:2] = (3.0, 2.025)

    grid_free = (1.4, 3.3, 0.0)

    def start_elsewhere(world: World, navigator: Navigator) -> None:
        if world.time == 0.0:
            world.box[:] = grid_free
        carry(world, navigator)

    navigator, _ = run(doors=1, happens=start_elsewhere)
    assert navigator.mode is Mode.DONE
    assert "somebody has moved it" in said(navigator)
    assert Mode.PUSH in visited(navigator)


def test_an_object_that_is_taken_away_during_a_push_ends_it() -> None:
    def snatch(world: World, navigator: Navigator) -> None:
        if navigator.mode is Mode.PUSH and world.box[1] < 3.0:
            world.box[:] = (0.8, 3.4, 0.0)

    navigator, _ = run(doors=1, happens=snatch)
    assert navigator.mode is Mode.DONE
    assert "suddenly elsewhere" in said(navigator)
    assert Mode.RETREAT in visited(navigator)


def missing(begin: float, end: float, when: list[float]) -> Callable[[Observation], Observation]:
    """Drop-outs of the object's pose from ``begin`` to ``end`` seconds after ``when[0]``."""

    def sees(seen: Observation) -> Observation:
        since = float(seen.time[0]) - when[0] if when else -1.0
        gone = begin <= since < end
        return (
            seen._replace(object_pose=seen.object_pose * np.nan, object_twist=seen.object_twist * np.nan)
            if gone
            else seen
        )

    return sees


@pytest.mark.parametrize(("length", "survives"), [(1.0, True), (4.0, False)])
def test_a_push_lives_through_a_second_without_the_objects_pose(length: float, survives: bool) -> None:
    when: list[float] = []
    counts: list[tuple[float, int]] = []

    def watch(world: World, navigator: Navigator) -> None:
        if navigator.mode is Mode.PUSH and not when:
            when.append(world.time)
        if navigator.segment is not None and navigator.segment.push is not None:
            counts.append((world.time, navigator.segment.push.pusher.samples))

    navigator, _ = run(doors=1, happens=watch, sees=missing(0.15, 0.15 + length, when))
    assert navigator.mode is Mode.DONE
    assert ("has not been detected for" not in reasons(navigator)) == survives
    assert "object 0 is not detected" in said(navigator) and "is detected again after" in said(navigator)
    # What was guessed meanwhile has taught nothing.
    during = [n for t, n in counts if when[0] + 0.25 <= t <= when[0] + 0.95]
    assert during and max(during) == min(during)


def test_a_goal_that_becomes_unreachable_ends_the_run_with_the_reason() -> None:
    def bar(world: World, navigator: Navigator) -> None:
        if abs(world.time - 0.3) < 0.01:
            world.box[:] = (1.4, 3.3, 0.0)
        if abs(world.time - 1.3) < 0.01:
            world.box[:] = (3.0, 2.025, 0.0)
            world.movable = False

    navigator, world = run(doors=1, happens=bar)
    assert navigator.mode is Mode.FAILED
    assert "was moved while it was being approached" in reasons(navigator)
    assert "every route to the goal is blocked" in navigator.transitions[-1].reason
    assert np.linalg.norm(world.velocity) < 0.15 and world.pose[0] < 3.0


def test_a_policy_that_avoids_everything_touches_nothing() -> None:
    navigator, world = run(doors=2, first_status=[Status.FIXED])
    assert navigator.mode is Mode.DONE and Mode.APPROACH not in visited(navigator)
    np.testing.assert_allclose(world.box[:2], (3.0, 2.025))
    blocked, _ = run(doors=1, first_status=[Status.FIXED])
    assert blocked.mode is Mode.FAILED and Mode.APPROACH not in visited(blocked)


@pytest.mark.slow
def test_a_policy_that_never_goes_round_pushes_until_it_gives_up() -> None:
    navigator, _ = run(doors=1, movable=False, config=NavigatorConfig(goes_round="never"), seconds=200.0)
    assert navigator.mode is Mode.FAILED
    assert "going round is not allowed" in navigator.transitions[-1].reason
    assert navigator.belief.objects[0].pushes > 0


@pytest.mark.slow
def test_a_policy_that_always_goes_round_pushes_only_where_there_is_no_way_round() -> None:
    config = NavigatorConfig(goes_round="always")
    navigator, _ = run(doors=2, config=config)
    assert navigator.mode is Mode.DONE and Mode.APPROACH not in visited(navigator)
    navigator, _ = run(doors=1, config=config)
    assert navigator.mode is Mode.DONE and Mode.PUSH in visited(navigator)
