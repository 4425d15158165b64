"""The pushing task on a plant of a few lines: a robot that speeds up as it leans, and an object that gives way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import shapely

from shmoo_mjx.arrays import finite_numbers
from shmoo_mjx.behavior.push_task import PushTask
from shmoo_mjx.behavior.state import Mode
from shmoo_mjx.control.equilibrium_lean import arms_lean
from shmoo_mjx.control.presets import pose_push_config
from shmoo_mjx.control.quasi_static import QuasiStaticPusher
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_RADIUS, TUCKED_REACH
from shmoo_mjx.planning.footprints import footprint_polygon
from shmoo_mjx.planning.maps import OCCUPIED, OccupancyGrid
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.types import DT, Command, Observation

HALF = (0.30, 0.25)


class _World:
    """Planar: lean accelerates the robot, hands that reach into the object push it, and it stops when they stop."""

    def __init__(self, robot: np.ndarray, thing: np.ndarray, movable: bool = True) -> None:
        self.robot, self.thing, self.movable = robot.astype(float), thing.astype(float), movable
        self.velocity, self.reach, self.time, self.force = np.zeros(2), TUCKED_REACH, 0.0, np.zeros(2)
        self.moved, self.lean = np.zeros(3), np.zeros(2)

    def seen(self) -> Observation:
        hands = np.array([[self.reach, 0.18, 0.4], [self.reach, -0.18, 0.4]])
        twist = np.append(self.velocity, 0.0)
        wrench = np.append(self.force, 0.0)
        lean = self.lean - arms_lean(hands)
        values = (self.time, self.robot, twist, lean, np.zeros(2), hands, [self.thing], [self.moved], [wrench])
        return Observation(
            *(np.array(v, dtype=float)[None] for v in values), np.zeros(1), np.zeros((1, 1)), np.array([[True]])
        )

    def step(self, command: Command) -> None:
        a, _, c = shmoobot().flatness
        self.lean = np.asarray(command.u)[0, :2]
        lean = se2.rotate(self.lean, self.robot[2])
        self.velocity = self.velocity + DT * (c / a * lean - self.force / 60.0)
        self.robot[:2] += DT * self.velocity
        self.robot[2] += np.clip(se2.wrap(command.yaw[0] - self.robot[2]), -0.08, 0.08)
        self.reach += np.clip(command.reach[0] - self.reach, -0.06, 0.06)
        self._touch(float(np.asarray(command.u)[0, 2]))
        self.time += DT

    def _touch(self, gamma: float) -> None:
        """The hands' line, wherever it reaches into the object, pushes it out along the robot's heading."""
        ahead = np.array([np.cos(self.robot[2]), np.sin(self.robot[2])])
        front = se2.transform_point(self.robot, np.array([[self.reach + HAND_RADIUS, y] for y in (-0.18, 0.18)]))
        probe = shapely.LineString([front[0] - 0.15 * ahead, front[0], front[1], front[1] - 0.15 * ahead]).convex_hull
        inside = probe.intersection(footprint_polygon(self.thing, HALF))
        depth = 0.0 if inside.is_empty else float(np.ptp(np.asarray(inside.envelope.exterior.coords) @ ahead))
        depth = min(depth, 0.1)
        self.moved = np.zeros(3)
        self.force = 600.0 * min(depth, 0.04) * ahead
        if depth > 0.02 and self.movable:
            turn = np.clip(-0.5 * gamma, -0.2, 0.2) * (depth - 0.02)
            step = np.append((depth - 0.02) * ahead, turn)
            self.thing, self.moved = self.thing + step, step / DT


def _grid(corridor: bool = False) -> OccupancyGrid:
    cells = np.zeros((160, 160), np.int8)
    if corridor:
        cells[:68] = cells[92:] = OCCUPIED  # 1.2 m wide, along x
    return OccupancyGrid(cells, 0.05, (-4.0, -4.0, 0.0))


def _task(goal: np.ndarray, grid: OccupancyGrid | None = None) -> PushTask:
    return PushTask(grid or _grid(), [HALF], goal, QuasiStaticPusher(pose_push_config().speed), kinds=["box"])


@pytest.mark.parametrize("goal", [(0.5, 0.0), (0.5, 0.0, 0.0, 1.0), (0.5, np.nan, 0.0), (np.inf, 0.0, 0.0)])
def test_a_goal_that_is_no_pose_is_refused_at_once(goal: Any) -> None:
    with pytest.raises(ShmooError, match=r"3 finite numbers \(x, y, yaw\)"):
        _task(goal)


@pytest.mark.parametrize("given", [0.5, None, ("a", "b"), [[1.0, 2.0]], ((1.0,), 2.0), {"x": 1.0}])
def test_what_is_no_point_is_refused(given: Any) -> None:
    with pytest.raises(ShmooError, match=r"the place must be 2 finite numbers \(x, y\)"):
        finite_numbers("the place", given, "x, y")
    assert finite_numbers("the place", (np.float32(1.0), 2), "x, y").tolist() == [1.0, 2.0]


@pytest.mark.parametrize("index", [1, -1])
def test_an_object_that_is_not_there_is_refused_at_once(index: int) -> None:
    with pytest.raises(ShmooError, match=f"no object {index}"):
        PushTask(_grid(), [HALF], (0.5, 0.0, 0.0), QuasiStaticPusher(pose_push_config().speed), index=index)


def _run(task: PushTask, world: _World, seconds: float = 120.0, meddle: object = None) -> None:
    while not task.finished and world.time < seconds:
        command = task.tick(world.seen())
        if task.mode is Mode.APPROACH:
            gap = footprint_polygon(world.thing, HALF).distance(shapely.Point(world.robot[:2]))
            assert gap > shmoobot().radius, f"the robot runs into the object while approaching, at {world.time:.1f} s"
            assert task.belief.wall_clearance.at(world.robot[:2]) > shmoobot().radius
        if callable(meddle):
            meddle(task, world)
        world.step(command)


def _reasons(task: PushTask) -> str:
    return "\n".join(f"{e.t:.1f} {e.source} -> {e.target}: {e.reason}" for e in task.transitions)


@pytest.mark.parametrize("angle", np.deg2rad([20, 140, 260]))
def test_from_any_start_round_the_object_it_comes_to_its_goal(angle: float) -> None:
    start = np.array([1.5 * np.cos(angle), 1.5 * np.sin(angle), 2 * angle])
    world = _World(start, np.zeros(3))
    task = _task(np.array([1.0, 0.1, 0.15]))
    _run(task, world)
    assert task.mode is Mode.DONE, _reasons(task)
    assert np.linalg.norm(world.thing[:2] - task.goal[:2]) < 0.12, _reasons(task)
    for transition in task.transitions:
        assert transition.target in task.modes[transition.source].leads_to, transition
    assert [e.target for e in task.transitions[:4]] == [Mode.APPROACH, Mode.CONTACT, Mode.PUSH, Mode.RETREAT]
    # Backed away with folded arms.
    assert footprint_polygon(world.thing, HALF).distance(shapely.Point(world.robot[:2])) > TUCKED_REACH
    assert world.reach < TUCKED_REACH + 0.06


def test_in_a_narrow_corridor_only_the_face_it_can_reach_is_pushed() -> None:
    world = _World(np.array([-1.6, 0.0, 0.0]), np.array([0.0, 0.0, 0.0]))
    task = _task(np.array([1.0, 0.0, 0.0]), _grid(corridor=True))
    _run(task, world)
    assert task.mode is Mode.DONE, _reasons(task)
    assert np.linalg.norm(world.thing[:2] - task.goal[:2]) < 0.12, _reasons(task)


def test_what_cannot_be_reached_is_said_to_be_so() -> None:
    """The object fills the corridor; its goal lies behind the robot."""
    world = _World(np.array([-1.6, 0.0, 0.0]), np.array([0.0, 0.0, 0.0]))
    task = _task(np.array([-1.0, 0.0, 0.0]), _grid(corridor=True))
    _run(task, world, 20.0)
    assert task.finished
    assert not np.any(world.thing)
    assert "can be reached" in task.transitions[-1].reason or "no better" in task.transitions[-1].reason


def test_lost_contact_is_noticed_and_made_again() -> None:
    def shove(task: PushTask, world: _World) -> None:
        if task.mode is Mode.PUSH and task.pushes == 1 and world.thing[0] > 0.3:
            world.thing = np.array([0.3, 0.6, 0.0])

    world = _World(np.array([-1.5, 0.0, 0.0]), np.zeros(3))
    task = _task(np.array([1.2, 0.3, 0.0]))
    _run(task, world, meddle=shove)
    assert "contact with object 0 lost" in _reasons(task)
    assert task.pushes > 1
    assert np.linalg.norm(world.thing[:2] - task.goal[:2]) < 0.15, _reasons(task)


def test_what_overshoots_is_pushed_back_from_the_other_side() -> None:
    def coast(task: PushTask, world: _World) -> None:
        if task.mode is Mode.RETREAT and task.pushes == 1 and world.thing[0] < 1.1:
            world.thing = np.array([1.5, 0.0, 0.0])

    world = _World(np.array([-1.5, 0.0, 0.0]), np.zeros(3))
    task = _task(np.array([1.0, 0.0, 0.0]))
    _run(task, world, meddle=coast)
    assert "from the front" in _reasons(task)
    # The first push ended half a metre beyond its goal, the second near it.
    first, *others = task.belief.objects[0].push_errors
    assert first == pytest.approx(0.25, abs=0.03) and others and max(others) < 0.1
    assert np.linalg.norm(world.thing[:2] - task.goal[:2]) < 0.12, _reasons(task)


def test_what_can_not_be_moved_ends_the_task() -> None:
    world = _World(np.array([-1.5, 0.0, 0.0]), np.zeros(3), movable=False)
    task = _task(np.array([1.0, 0.0, 0.0]))
    _run(task, world)
    assert task.finished
    assert "hardly nearer to its goal" in _reasons(task)
    assert task.belief.objects[0].failed_faces


def test_it_goes_on_to_another_pose_with_what_it_knows() -> None:
    world = _World(np.array([-1.5, 0.0, 0.0]), np.zeros(3))
    task = _task(np.array([0.5, 0.0, 0.0]))
    _run(task, world)
    assert task.mode is Mode.DONE and task.segment is None
    task.head_for((1.0, 0.0, 0.0), world.time)
    assert not task.finished and task.pushes == 0 and not task.belief.objects[0].push_errors
    _run(task, world, world.time + 60.0)
    assert task.mode is Mode.DONE, _reasons(task)
    assert np.linalg.norm(world.thing[:2] - (1.0, 0.0)) < 0.12, _reasons(task)


def test_an_object_at_its_goal_is_left_alone() -> None:
    world = _World(np.array([-1.5, 0.0, 0.0]), np.array([0.0, 0.02, 0.05]))
    task = _task(np.zeros(3))
    _run(task, world, 5.0)
    assert task.mode is Mode.DONE
    assert task.pushes == 0


def test_a_detection_that_fails_for_a_while_does_not_stop_the_push() -> None:

    class Blinking(_World):
        def seen(self) -> Observation:
            seen = super().seen()
            if round(self.time / DT) % 10 < 3 and self.time > 1.0:
                seen = seen._replace(object_pose=np.full_like(seen.object_pose, np.nan))
            return seen

    world = Blinking(np.array([-1.5, 0.0, 0.0]), np.zeros(3))
    task = _task(np.array([0.8, 0.0, 0.0]))
    _run(task, world)
    assert np.linalg.norm(world.thing[:2] - task.goal[:2]) < 0.15, _reasons(task)
