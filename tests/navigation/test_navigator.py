"""The navigator's behaviour in a world of points and rectangles: what it decides, and what it does about surprises.

The toy world has no physics worth the name, and the pushing controller is a stand-in that leans forward and rolls out
what the toy object would do; both are enough for the state machine, and fast.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from toy import toy_scenario

from shmoo_mjx import se2
from shmoo_mjx.control.equilibrium_lean import arms_lean
from shmoo_mjx.faces import faces_of
from shmoo_mjx.hands import HAND_RADIUS
from shmoo_mjx.learning import adaptation
from shmoo_mjx.learning.adaptation import AdaptState
from shmoo_mjx.navigation.belief import Status
from shmoo_mjx.navigation.maps import FREE, OCCUPIED, OccupancyGrid, clearance_field
from shmoo_mjx.navigation.navigator import MODES, PROBE_ROOM, Navigator, init, setup_of, step
from shmoo_mjx.navigation.object_planner import ObjectPlannerConfig
from shmoo_mjx.navigation.records import Mode, NavigatorConfig
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.recorded import Recorded
from shmoo_mjx.replay import differences
from shmoo_mjx.types import DT, Command, Observation

HALF = (0.25, 0.275)


class State(NamedTuple):
    """Stands for the pushing controller's memory."""

    adapt: AdaptState
    face: np.ndarray
    pose: np.ndarray
    samples: int = 0
    """How many samples Eq. 8 took in."""


class Stand(SimpleNamespace):
    """Stands for the pushing controller: leans forward while slow, and foresees what ``world`` would do."""

    def __init__(self, world: World) -> None:
        super().__init__(world=world, rooms=[], foresees=False)

    def init(self, now: Any, face: Any, half: Any, key: Any, adapt: AdaptState | None = None) -> State:
        return State(adapt or adaptation.init(np.zeros(18), np.eye(18), np.eye(3)), face, now.object_pose)

    def step(
        self, state: State, now: Any, last_u: Any, goal: Any, around: Any, half: Any, governor_room: float | None = None
    ) -> tuple[np.ndarray, State, Any]:
        self.rooms.append(governor_room)
        assert np.isfinite(now.object_pose).all() and np.isfinite(now.object_twist).all()
        forward = se2.rotate(now.robot_twist[:2], -now.robot_pose[2])
        lean = 0.1 * np.clip(0.25 - forward[0], -0.3, 0.3), -0.1 * forward[1]
        after = state._replace(pose=now.object_pose, samples=state.samples + bool(now.detected))
        return np.array([*lean, 0.0]), after, SimpleNamespace(ok=True)

    def _foresees_motion(self) -> bool:
        return bool(self.foresees or (self.world.movable and self.world.foreseen))

    def planning_rollouts(
        self, state: State, goal: Any, around: Any, half: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        angle = state.pose[2] + state.face[2]
        reach = np.linspace(0.1, 1.2, 60) if self._foresees_motion() else np.full(60, 0.01)
        along = reach[:, None] * np.array([np.cos(angle), np.sin(angle)])
        ends = np.concatenate([state.pose[:2] + along, np.full((60, 1), state.pose[2])], axis=1)
        paths = np.linspace(state.pose, ends, 6)[1:].swapaxes(0, 1)
        return paths, paths[..., :2], np.linalg.norm(ends[:, :2] - goal[:2], axis=1)


class World:
    """A disc that accelerates as it leans, and a rectangle that it pushes without slip, or that stops it."""

    def __init__(self, start: tuple[float, float, float], box: tuple[float, float, float], movable: bool) -> None:
        self.pose, self.velocity = np.array(start), np.zeros(2)
        self.box, self.box_twist = np.array(box), np.zeros(3)
        self.movable, self.resistance, self.foreseen = movable, 12.0, True
        self.lean, self.lean_rate, self.reach, self.force = np.zeros(2), np.zeros(2), 0.2, np.zeros(2)
        self.time = 0.0

    def observe(self) -> Observation:
        hands = np.array([[[self.reach, 0.1, 0.4], [self.reach, -0.1, 0.4]]])
        twist = np.array([[*self.velocity, 0.0]])
        wrench = np.array([[[*self.force, 0.0]]])
        # The low-level control leans back for the arms, and is commanded without that.
        parts = (self.pose, twist[0], self.lean - arms_lean(hands[0]), self.lean_rate)
        robot = [np.array([p], dtype=float) for p in parts]
        return Observation(
            np.array([self.time]), *robot, hands, self.box[None, None].copy(), self.box_twist[None, None], wrench,
            np.zeros(1), np.zeros((1, 1)), np.array([[True]]),
        )  # fmt: skip

    def step(self, command: Command) -> Observation:
        a, _, c = shmoobot().flatness
        before = self.box.copy()
        self.force = np.zeros(2)
        for _ in range(10):
            rate = (command.u[0, :2] - self.lean) / 0.1
            self.lean, self.lean_rate = self.lean + rate * DT / 10, rate
            turn = se2.wrap(command.yaw[0] - self.pose[2])
            self.pose[2] = se2.wrap(self.pose[2] + np.clip(turn, -0.15, 0.15) / 10)
            self.velocity = self.velocity + c / a * se2.rotate(self.lean, self.pose[2]) * DT / 10
            self.pose[:2] += self.velocity * DT / 10
            self.reach += np.clip(command.reach[0] - self.reach, -0.04, 0.04)
            self._touch()
        self.box_twist = (self.box - before) / DT
        self.time += DT
        return self.observe()

    def _touch(self) -> None:
        """Press the rectangle, or be stopped by it, where the hands are inside one of its faces."""
        ahead = np.array([np.cos(self.pose[2]), np.sin(self.pose[2])])
        tip = self.pose[:2] + (self.reach + HAND_RADIUS) * ahead
        for face in faces_of(HALF):
            local = se2.relative(se2.compose(self.box, face[:3]), np.array([*tip, self.pose[2]]))
            if 0.0 < local[0] < 0.2 and abs(local[1]) < face[3] and abs(local[2]) < 0.5:
                normal = np.array([np.cos(self.box[2] + face[2]), np.sin(self.box[2] + face[2])])
                self.force = (self.resistance if self.movable else 40.0) * normal
                if self.movable:
                    self.box[:2] += local[0] * normal
                else:
                    self.pose[:2] -= local[0] * normal
                    self.velocity = self.velocity - max(self.velocity @ normal, 0.0) * normal


def run(
    doors: int = 2,
    movable: bool = True,
    config: NavigatorConfig | None = None,
    happens: Callable[[World, Navigator], None] = lambda world, navigator: None,
    sees: Callable[[Observation], Observation] = lambda seen: seen,
    first_status: list[Status] | None = None,
    seconds: float = 120.0,
) -> tuple[Navigator, World]:
    """One run in the toy scenario; what happens in the world and what is seen of it may be tampered with."""
    grid, scenario = toy_scenario(doors, movable)
    world = World(scenario.start, scenario.objects[0].pose, movable)
    navigator = Navigator(
        grid, scenario.goal, [HALF], Stand(world), config=config or NavigatorConfig(), first_status=first_status
    )  # type: ignore[arg-type]
    seen, walls = world.observe(), clearance_field(grid)
    while not navigator.finished and world.time < seconds:
        command = navigator.tick(sees(seen))
        happens(world, navigator)
        seen = world.step(command)
        assert walls.at(world.pose[:2]) > 0.15, f"the robot hits a wall at {world.time:.1f} s while to {navigator.mode}"
    return navigator, world


def visited(navigator: Navigator) -> set[Mode]:
    return {t.target for t in navigator.transitions}


def reasons(navigator: Navigator) -> str:
    return "; ".join(t.reason for t in navigator.transitions)


def said(navigator: Navigator) -> str:
    return "; ".join(note.text for note in navigator.notes)


def test_a_movable_box_in_the_only_doorway_is_pushed_away() -> None:
    navigator, world = run(doors=1)
    assert navigator.mode is Mode.DONE
    assert {Mode.APPROACH, Mode.CONTACT, Mode.PROBE, Mode.PUSH, Mode.RETREAT} <= visited(navigator)
    assert navigator.belief.objects[0].status is Status.PARKED
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


@pytest.mark.parametrize("moves", [True, False])
def test_only_what_stands_still_is_called_immovable_once_it_has_been_called_movable(moves: bool) -> None:
    """Later looks foresee no motion; the box goes on, or sticks."""

    def worsens(world: World, navigator: Navigator) -> None:
        if navigator.mode is Mode.PUSH:
            world.foreseen, world.movable = False, moves

    navigator, _ = run(1, happens=worsens)
    assert ("registered as an obstacle" in reasons(navigator)) != moves
    assert (navigator.mode is Mode.DONE) == moves


def test_what_rolls_away_after_a_short_touch_can_be_moved_and_is_let_go() -> None:
    """Too little contact for anything but its own motion to tell, which is enough."""

    def rolls(world: World, navigator: Navigator) -> None:
        if navigator.segment is not None and navigator.segment.push is not None:
            world.foreseen = False
            world.box[0] += 0.05 if world.time - navigator.segment.push.started < 0.8 else 0.0
            world.pose[:2] -= 0.05 * np.array([np.cos(world.pose[2]), np.sin(world.pose[2])])

    navigator, _ = run(1, happens=rolls, seconds=25.0)
    began = next(t.t for t in navigator.transitions if t.target is Mode.PROBE)
    judged = next(t for t in navigator.transitions if t.source is Mode.PROBE)
    assert "is manipulable" in judged.reason and judged.t - began < 1.0
    lost = next(t for t in navigator.transitions if t.source is Mode.PUSH)
    assert "lost" in lost.reason and lost.t - began < 6.0


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
    navigator, _ = run(doors=2, movable=False, config=NavigatorConfig(detour=0.1))
    assert navigator.mode is Mode.DONE
    assert navigator.belief.objects[0].status is Status.FIXED
    assert Mode.PUSH not in visited(navigator) and not navigator.decisions[-1].manipulable


def test_the_way_round_one_object_does_not_lead_through_another_that_is_gone_round() -> None:
    """A box in each of two doorways, equally far: it stops to push one, where it once turned from one to the other."""
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
    assert reasons(navigator).count("going round it costs") == 1


def test_with_no_way_left_it_says_so_after_three_more_tries_and_stands_still() -> None:
    navigator, world = run(doors=1, movable=False)
    assert navigator.mode is Mode.FAILED
    assert "every route to the goal is blocked" in navigator.transitions[-1].reason
    assert "object 0, registered as an obstacle, is tried again" in said(navigator)
    assert sum(t.target is Mode.PROBE for t in navigator.transitions) == 1 + navigator.config.chances
    assert np.linalg.norm(world.velocity) < 0.15
    navigator.head_for([5.0, 2.0], world.time)
    assert navigator.belief.objects[0].chances == 0


def test_what_holds_the_hands_and_is_never_felt_is_given_up() -> None:
    """As where two objects carry each other's tags: what is felt is said of the other one."""

    def numb(seen: Observation) -> Observation:
        return seen._replace(wrench=np.zeros_like(seen.wrench))

    navigator, _ = run(1, movable=False, sees=numb, seconds=300.0)
    assert navigator.mode is Mode.FAILED
    assert Mode.PROBE not in visited(navigator) and "was not felt" in reasons(navigator)


@pytest.mark.parametrize("held", [0.0, 1.3])
def test_the_verdict_waits_for_what_holds_at_first(held: float) -> None:
    """The roll-outs foresee motion all along; the box holds for a while."""
    places: list[tuple[np.ndarray, np.ndarray]] = []

    def holds(world: World, navigator: Navigator) -> None:
        push = None if navigator.segment is None else navigator.segment.push
        if navigator.mode is Mode.PROBE and push is not None and push.contact_time < held:
            places.append((world.box.copy(), world.pose.copy()))
            world.box[:], world.pose[:] = places[0]

    navigator, _ = run(1, happens=holds)
    began = next(t.t for t in navigator.transitions if t.target is Mode.PROBE)
    believed = next(t.t for t in navigator.transitions if t.target is Mode.PUSH)
    first = navigator.decisions[0]
    assert first.manipulable and first.probability > navigator.config.sure
    assert held - DT <= believed - began < max(held, 1.0) + 1.0


@pytest.mark.parametrize(
    ("decides_by", "doors", "verdict", "longest"),
    [("mobility", 2, False, 3.5), ("mobility", 1, False, 6.5), ("K", 1, True, 1.5)],
)
def test_what_holds_is_immovable_whatever_the_model_foresees(
    decides_by: Any, doors: int, verdict: bool, longest: float
) -> None:
    """By K, the paper's rule, the model is believed after a second; where there is no way round, the probe goes on
    until it stalls."""

    def holds(world: World, navigator: Navigator) -> None:
        world.movable, navigator.setup.controller.foresees = False, True

    config = NavigatorConfig(decides_by=decides_by, detour=0.1)
    navigator, _ = run(doors, movable=False, happens=holds, config=config, seconds=30.0)
    began = next(t.t for t in navigator.transitions if t.target is Mode.PROBE)
    judged = next(t for t in navigator.transitions if t.source is Mode.PROBE)
    assert navigator.decisions[0].manipulable == verdict
    assert longest / 2 - 1.0 < judged.t - began < longest


@pytest.mark.parametrize("movable", [True, False])
def test_the_probe_leans_in_firmly_until_the_object_moves(movable: bool) -> None:
    navigator, _ = run(1, movable=movable)
    rooms = navigator.setup.controller.rooms
    firm = [room == PROBE_ROOM for room in rooms]
    assert firm[0]
    assert all(firm) != movable


def test_without_another_chance_it_gives_up_at_once() -> None:
    navigator, _ = run(doors=1, movable=False, config=NavigatorConfig(chances=0))
    assert navigator.mode is Mode.FAILED and "tried again" not in said(navigator)


def test_an_object_that_was_registered_and_becomes_free_is_pushed_after_all() -> None:
    def release(world: World, navigator: Navigator) -> None:
        if navigator.belief.objects and navigator.belief.objects[0].status is Status.FIXED:
            world.movable = True

    navigator, _ = run(doors=1, movable=False, happens=release)
    assert navigator.mode is Mode.DONE
    assert "is tried again" in said(navigator)
    assert [d.manipulable for d in navigator.decisions][-1]
    assert not navigator.decisions[0].manipulable


def test_a_registered_object_that_somebody_moves_counts_as_unknown_again() -> None:
    moved_at = []

    def carry(world: World, navigator: Navigator) -> None:
        known = navigator.belief.objects.get(0)
        if known is not None and known.status is Status.FIXED and not moved_at:
            world.box[:] = (4.6, 1.0, 0.3)
            moved_at.append(world.time)

    # Going round is far: the robot is still in sight of the object when it is carried away.
    navigator, _ = run(doors=2, movable=False, config=NavigatorConfig(detour=0.1), happens=carry)
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
    config = NavigatorConfig(chances=0)
    navigator, world = run(doors=2, config=config, first_status=[Status.FIXED])
    assert navigator.mode is Mode.DONE and Mode.APPROACH not in visited(navigator)
    np.testing.assert_allclose(world.box[:2], (3.0, 2.025))
    blocked, _ = run(doors=1, config=config, first_status=[Status.FIXED])
    assert blocked.mode is Mode.FAILED and Mode.APPROACH not in visited(blocked)


def test_a_policy_that_never_goes_round_pushes_until_it_gives_up() -> None:
    config = replace(NavigatorConfig(goes_round=False), planner=ObjectPlannerConfig(threshold=0.0))
    navigator, _ = run(doors=2, movable=False, config=config, seconds=200.0)
    assert navigator.mode is Mode.FAILED
    assert "going round is not allowed" in navigator.transitions[-1].reason
    assert navigator.belief.objects[0].pushes == config.max_pushes


def test_the_toy_scenario_is_what_it_says() -> None:
    grid, _ = toy_scenario(2, True)
    assert isinstance(grid, OccupancyGrid)
    assert grid.values_at((3.0, 2.0)) == 0 and grid.values_at((3.0, 0.6)) == 0 and grid.values_at((3.0, 3.2)) == 100
    assert toy_scenario(1, True)[0].values_at((3.0, 0.6)) == 100


def test_runs_keep_to_the_transition_table() -> None:
    for doors, movable in ((1, True), (2, False), (1, False)):
        navigator, _ = run(doors, movable)
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
    at_once, _ = run(1)
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

    def blind(*given: Any) -> Any:
        u, state, _ = lost(*given)
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
def test_what_has_given_way_before_and_sticks_is_not_tried_on_the_same_face_for_ever(doors: int) -> None:
    """One face can be reached. With a way round it is pushed once, without one three times more."""

    def sticks(world: World, navigator: Navigator) -> None:
        if navigator.mode is Mode.PUSH and world.box[0] > 3.15:
            world.foreseen = world.movable = False

    navigator, _ = run(doors, happens=sticks, seconds=90.0, config=NavigatorConfig(detour=0.1))
    assert "given way before, and is left where it is" in reasons(navigator)
    assert navigator.mode is (Mode.FAILED if doors == 1 else Mode.DONE)
    assert [t.target for t in navigator.transitions].count(Mode.PROBE) == (4 if doors == 1 else 1)


def test_an_object_that_sticks_on_the_way_to_its_goal_is_pushed_straight_ahead() -> None:
    """It turns no further, say, but gives way straight ahead."""

    def sticks(world: World, navigator: Navigator) -> None:
        segment = navigator.segment
        if navigator.mode is Mode.PUSH and segment is not None and world.box[0] > 3.15:
            world.foreseen = world.movable = segment.straight_from is not None

    navigator, world = run(1, happens=sticks, seconds=90.0)
    assert "pushes it straight ahead" in said(navigator)
    assert navigator.mode is Mode.DONE and world.box[0] > 3.3


def test_an_object_out_of_reach_is_not_given_up_twice_in_one_sample() -> None:
    """It closes a corridor so that no face can be stood off from; the second try comes later, not at once."""
    cells = np.full((80, 120), OCCUPIED, dtype=np.int8)
    cells[31:49, 6:114] = FREE
    world = World((0.8, 2.0, 0.0), (1.45, 2.0, 0.0), movable=True)
    navigator = Navigator(OccupancyGrid(cells, 0.05), [5.2, 2.0], [HALF], Stand(world))
    seen = world.observe()
    while not navigator.finished and world.time < 15.0:
        seen = world.step(navigator.tick(seen))
    given_up = [t.t for t in navigator.transitions if "registered as an obstacle" in t.reason]
    assert navigator.mode is Mode.FAILED
    assert len(given_up) == 1 + navigator.config.chances and np.diff(given_up).min() > 1.0


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
    recorded = Recorded(stacked[0], stacked[1], np.repeat(np.array([scenario.goal], dtype=float), 80, axis=0))
    assert differences(fresh(), recorded) is None
    changed = stacked[0].robot_pose.copy()
    changed[40, 0, 0] += 1e-6
    found = differences(fresh(), recorded._replace(observations=stacked[0]._replace(robot_pose=changed)))
    assert found is not None and found.sample == 40 and "sample 40" in str(found)
