"""Certificates: the outcome of each option in a scenario, from scripted pushes with perfect knowledge.

The search pushes each object in the way on every reachable face, at several places and steering angles, and on every
reachable corner. Pushes run in the scene itself in C MuJoCo. Walks are not simulated; they count with the robot's usual
walking time. Cheap attempts come first, and the attempts on an object end once one has freed the way past it. If one
push is not enough, the search continues from the state after that push.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
import shapely
from pydantic import BaseModel, ConfigDict, Field, model_validator

from shmoo_mjx.arrays import single_precision
from shmoo_mjx.base.schema import Number, WholeNumber
from shmoo_mjx.evaluation.scripted import WORLDS, PushEnd, ScriptConfig, ScriptedPush, run_pushes
from shmoo_mjx.geometry.faces import corners_of, faces_of, stand_off
from shmoo_mjx.planning.footprints import add_obstacles, footprint_polygon
from shmoo_mjx.planning.maps import OccupancyGrid, distance_field, occupied_rectangles
from shmoo_mjx.planning.paths import path_blocked_by, plan_path
from shmoo_mjx.planning.scenario import ROBOT_RADIUS, Scenario
from shmoo_mjx.plant.scene import Scene, build_scene

AttemptResult = Literal["free", "passed", "moved", "stuck", "failed"]

_PASSED = 1.0
"""Extra length up to which the way past an object counts as free, compared with the way without the object [m]."""
_GAPS = (0.12, 0.25, 0.4)
"""Distances between the hands and the face at the start of a push [m]. The first one that is reachable is used."""
_WINDOW = 5.0
"""Half side of the square around a pushed object in which walls are simulated [m]."""
_GIVES_WAY = 0.1
"""Displacement that the best push of a batch must reach [m]. Below it, no further attempts are made on the object."""
_MOVED = 0.3
"""Displacement above which the search continues from the new pose of an object that is still in the way [m]."""


@dataclass(frozen=True)
class CertifyConfig:
    """Settings of the search, in SI units."""

    script: ScriptConfig = ScriptConfig()
    pace: float = 0.455
    """Walking speed [m/s], taken from runs in which the robot always goes round objects."""
    stop: float = 1.0
    """Additional time of each walk for starting, stopping and turning [s]."""
    lateral: tuple[float, ...] = (0.0, 0.5, -0.5)
    """Contact places along a face, as fractions of its half width. Positive is to the robot's left."""
    steering: float = 0.3
    """Magnitude of the steering angle in later attempts [rad]."""
    pushes: int = 4
    """Maximum number of pushes in a sequence."""


class Attempt(BaseModel):
    """One push of one object, starting at the stand-off pose."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    object: WholeNumber = Field(ge=0)
    face: WholeNumber = Field(ge=0, le=7)
    """Index of the face in `faces_of`, or 4 plus the index of the corner in `corners_of`."""
    lateral: Number
    """Distance of the contact place from the centre of the face, positive to the robot's left [m]."""
    steering: Number
    """Steering angle during the push [rad]."""
    start: tuple[Number, Number, Number]
    """Pose of the robot in {W} at the start of the push [m, m, rad]."""
    after: WholeNumber | None = None
    """Index of the preceding push in the list of attempts; None for the first push of a sequence."""
    result: AttemptResult
    """free: the way to the goal is free. passed: the object is out of the way, but others are not. moved: the object
    has moved, but it is still in the way. stuck: the object has not moved. failed: the robot fell or touched a wall, an
    object toppled, or the simulation diverged."""
    progress: Number
    """Displacement of the object along the heading of the push [m]."""
    seconds: Number
    """Time from the start of the scenario to the end of the retreat [s]. If the result is free, it includes the walk to
    the goal."""


class Certificate(BaseModel):
    """Outcomes of all options of a scenario."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    attempts: tuple[Attempt, ...]
    round_s: Number | None
    """Time of going round all objects [s]; None if there is no way round."""
    reference_s: Number | None
    """Shortest time of all options [s]; None if no option works."""
    best: tuple[WholeNumber, ...]
    """Indices of the attempts of the fastest option, in order. Empty if going round is fastest or no option works."""

    @model_validator(mode="after")
    def _attempts_exist(self) -> Certificate:
        earlier = all(a.after is None or 0 <= a.after < i for i, a in enumerate(self.attempts))
        if not earlier or any(not 0 <= i < len(self.attempts) for i in self.best):
            raise ValueError("names an attempt that is not in 'attempts'; make the certificate again.")
        return self

    @property
    def pushed(self) -> tuple[int, ...]:
        """Objects that the fastest option pushes, in order."""
        return tuple(self.attempts[i].object for i in self.best)

    def options(self) -> dict[int | None, float]:
        """Shortest certified time of each first action [s].

        Returns:
            Time by index of the object that is pushed first. The key None stands for going round.
        """
        times: dict[int | None, float] = {} if self.round_s is None else {None: self.round_s}
        for attempt in self.attempts:
            if attempt.result == "free":
                first = attempt
                while first.after is not None:
                    first = self.attempts[first.after]
                times[first.object] = min(times.get(first.object, np.inf), attempt.seconds)
        return times

    def moves(self, index: int, distance: float, untried: bool = False) -> bool:
        """Whether some attempt moves object ``index`` by at least ``distance`` along the push.

        Args:
            index: index of the object.
            distance: displacement along the push [m].
            untried: value to return if the object has no attempts.
        """
        tried = [a.progress for a in self.attempts if a.object == index]
        return max(tried) >= distance if tried else untried


class _State(NamedTuple):
    """State of the world after some pushes."""

    qpos: np.ndarray
    robot: np.ndarray
    objects: np.ndarray
    seconds: float
    pushed: tuple[int, ...] = ()
    last: int | None = None

    def then(self, attempt: Attempt, number: int, end: PushEnd) -> _State:
        """The state after attempt ``number``, whose push ended as ``end``."""
        pushed = (*self.pushed, attempt.object)
        return _State(end.qpos, end.robot, end.objects, attempt.seconds, pushed, number)


@dataclass
class _Search:
    """Search over the options of one scenario."""

    grid: OccupancyGrid
    scenario: Scenario
    cfg: CertifyConfig
    attempts: list[Attempt] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.walls = distance_field(self.grid)
        self.conditions = [entry.condition() for entry in self.scenario.objects]
        self.faces = [np.concatenate([faces_of(c.half_extents), corners_of(c.half_extents)]) for c in self.conditions]
        self.scenes: dict[tuple[int, int], Scene] = {}

    def polygons(self, objects: np.ndarray, which: Iterator[int] | list[int] | range) -> list[shapely.Polygon]:
        return [footprint_polygon(objects[i], self.conditions[i].half_extents) for i in which]

    def length(self, start: np.ndarray, obstacles: list[shapely.Polygon], end: np.ndarray | None = None) -> float:
        """Length of the path to ``end``, by default the goal [m]; infinite if there is none."""
        goal = np.asarray(self.scenario.goal) if end is None else end
        path = plan_path(self.grid, start[:2], goal, obstacles, robot_radius=ROBOT_RADIUS, wall_clearance=self.walls)
        return np.inf if path is None else path.length

    def walk(self, length: float) -> float:
        """Time of a walk of ``length`` metres [s]."""
        return self.cfg.stop + length / self.cfg.pace if length > 0.05 else 0.0

    def start(self) -> _State:
        poses = np.array([entry.pose for entry in self.scenario.objects])
        scene = self.scene(poses[0, :2])
        return _State(scene.qpos0, np.asarray(self.scenario.start), poses, 0.0)

    def scene(self, place: np.ndarray) -> Scene:
        """Scene with the robot, all objects, and the walls near ``place``."""
        key = (round(float(place[0])), round(float(place[1])))
        if key not in self.scenes:
            x, y = key
            window = (x - _WINDOW, y - _WINDOW, x + _WINDOW, y + _WINDOW)
            walls = occupied_rectangles(self.grid, window, unknown_borders=True)
            objects = [(c, o.pose) for c, o in zip(self.conditions, self.scenario.objects, strict=True)]
            self.scenes[key] = build_scene(objects, self.scenario.start, walls, float(self.grid.origin[2]))
        return self.scenes[key]

    def in_the_way(self, state: _State) -> list[tuple[int, list[int]]]:
        """Objects that block the way to the goal.

        The first path ignores all objects. Each further path treats the blocking objects found so far as walls.

        Returns:
            For each path, the first object on it and the objects that it treats as walls.
        """
        fixed: list[int] = []
        blockers: list[tuple[int, list[int]]] = []
        while True:
            path = plan_path(
                self.grid, state.robot[:2], self.scenario.goal, self.polygons(state.objects, fixed),
                robot_radius=ROBOT_RADIUS, wall_clearance=self.walls,
            )  # fmt: skip
            if path is None:
                return blockers
            met = []
            for i in set(range(len(self.conditions))) - set(fixed):
                blocked, s = path_blocked_by(path, self.polygons(state.objects, [i])[0], ROBOT_RADIUS - 0.03)
                if blocked and s is not None:
                    met.append((s, i))
            if not met:
                return blockers
            blockers.append((min(met)[1], list(fixed)))
            fixed.append(min(met)[1])

    def starts(self, state: _State, index: int, face: int, lateral: float) -> np.ndarray | None:
        """Pose ``[3]`` of the robot in {W} at which a push on a face starts; None if the robot cannot walk to it."""
        obstacles = self.polygons(state.objects, range(len(self.conditions)))
        room = add_obstacles(self.walls, obstacles)
        for gap in _GAPS:
            pose = stand_off(state.objects[index], self.faces[index][face], gap, lateral).round(3)
            if room.at(pose[:2]) >= ROBOT_RADIUS and np.isfinite(self.length(state.robot, obstacles, pose[:2])):
                return pose
        return None

    def stages(self, state: _State, index: int, fixed: list[int]) -> Iterator[list[tuple[int, ScriptedPush]]]:
        """Batches of attempts on an object as (index of the face, push), cheap ones first.

        A push is left out if the object does not block the way from its start pose, because a robot that walks to this
        pose has already gone round the object.
        """
        cfg, faces = self.cfg, self.faces[index]

        def pushes(face: int, places: list[tuple[float, float]]) -> Iterator[tuple[int, ScriptedPush]]:
            for share, steering in places:
                lateral = round(share * (faces[face][3] if face < 4 else 0.0), 3)
                start = self.starts(state, index, face, lateral)
                if start is not None and not self.passes(index, fixed, start, state.objects)[0]:
                    yield face, ScriptedPush(index, faces[face], lateral, steering, start)

        yield [p for face in range(4) for p in pushes(face, [(share, 0.0) for share in cfg.lateral])]
        aside, angle = cfg.lateral[1], cfg.steering
        turned = [(0.0, angle), (0.0, -angle), (aside, angle), (-aside, -angle)]
        later = [p for face in range(4) for p in pushes(face, turned)]
        later += [p for face in range(4, 8) for p in pushes(face, [(0.0, 0.0)])]
        for first in range(0, len(later), WORLDS):
            yield later[first : first + WORLDS]

    def explore(self, state: _State) -> None:
        """Try the objects in the way, and continue from the states that pushes lead to."""
        for index, fixed in self.in_the_way(state):
            ends: list[tuple[int, PushEnd]] = []
            for batch in self.stages(state, index, fixed):
                if not batch:
                    continue
                tried = self.tried(state, index, fixed, batch)
                ends += tried
                results = [self.attempts[i].result for i, _ in tried]
                if {"free", "passed"} & set(results) or max(end.moved for _, end in tried) < _GIVES_WAY:
                    break
            self.go_on(state, index, ends)

    def go_on(self, state: _State, index: int, ends: list[tuple[int, PushEnd]]) -> None:
        """Continue from the fastest push that passed, or else from the one that moved the object farthest."""
        if len(state.pushed) + 1 >= self.cfg.pushes or any(self.attempts[i].result == "free" for i, _ in ends):
            return
        passed = [(self.attempts[i].seconds, i, end) for i, end in ends if self.attempts[i].result == "passed"]
        moved = [(-end.moved, i, end) for i, end in ends if self.attempts[i].result == "moved" and end.moved > _MOVED]
        again = moved if state.pushed.count(index) < 1 else []
        for _, i, end in sorted(passed or again, key=lambda item: item[:2])[:1]:
            self.explore(state.then(self.attempts[i], i, end))

    def tried(
        self, state: _State, index: int, fixed: list[int], batch: list[tuple[int, ScriptedPush]]
    ) -> list[tuple[int, PushEnd]]:
        """Run a batch of attempts, add them to the list, and return the index and the end of each."""

        def passes(which: int, robot: np.ndarray, objects: np.ndarray) -> bool:
            return self.passes(which, fixed, robot, objects)[0]

        pushes = [push for _, push in batch]
        ends = run_pushes(self.scene(state.objects[index, :2]), state.qpos, pushes, passes, cfg=self.cfg.script)
        obstacles = self.polygons(state.objects, range(len(self.conditions)))
        done = []
        for (face, push), end in zip(batch, ends, strict=True):
            seconds = state.seconds + self.walk(self.length(state.robot, obstacles, push.start[:2])) + end.seconds
            result: AttemptResult = "failed"
            if end.ok:
                passed, whole = self.passes(index, fixed, end.robot, end.objects)
                result = "moved" if end.moved > 0.05 else "stuck"
                if passed and end.moved > 0.05:
                    result = "free" if np.isfinite(whole) else "passed"
                    seconds += self.walk(whole) if np.isfinite(whole) else 0.0
            self.attempts.append(
                Attempt(
                    object=index, face=face, lateral=push.lateral, steering=push.steering,
                    start=tuple(push.start.tolist()), after=state.last, result=result,
                    progress=round(end.progress, 2), seconds=round(seconds, 1),
                )
            )  # fmt: skip
            done.append((len(self.attempts) - 1, end))
        return done

    def passes(self, index: int, fixed: list[int], robot: np.ndarray, objects: np.ndarray) -> tuple[bool, float]:
        """Whether the way past object ``index`` is free, and the length of the way past all objects [m].

        The length is infinite if any object blocks the way.
        """
        walls = self.polygons(objects, fixed)
        without = self.length(robot, walls)
        past = self.length(robot, [*walls, *self.polygons(objects, [index])])
        if not past <= without + _PASSED:
            return False, np.inf
        whole = self.length(robot, self.polygons(objects, range(len(objects))))
        return True, whole if whole <= without + _PASSED else np.inf


@single_precision
def certify(grid: OccupancyGrid, scenario: Scenario, cfg: CertifyConfig = CertifyConfig()) -> Certificate:
    """The certificate of a scenario, from trying all its options. It takes about 10 s.

    Args:
        grid: map of the scenario.
        scenario: scenario with at least one object.
        cfg: settings of the search.
    """
    search = _Search(grid, scenario, cfg)
    state = search.start()
    length = search.length(state.robot, search.polygons(state.objects, range(len(state.objects))))
    search.explore(state)
    return _certificate(search.attempts, None if np.isinf(length) else search.walk(length))


def _certificate(attempts: list[Attempt], round_s: float | None) -> Certificate:
    free = [(a.seconds, i) for i, a in enumerate(attempts) if a.result == "free"]
    best: list[int] = []
    if free and (round_s is None or min(free)[0] < round_s):
        link: int | None = min(free)[1]
        while link is not None:
            best.insert(0, link)
            link = attempts[link].after
    reference = min([s for s, _ in free] + ([] if round_s is None else [round_s]), default=None)
    return Certificate(
        attempts=tuple(attempts),
        round_s=None if round_s is None else round(round_s, 1),
        reference_s=None if reference is None else round(reference, 1),
        best=tuple(best),
    )


@single_precision
def replay(
    grid: OccupancyGrid, scenario: Scenario, certificate: Certificate, cfg: CertifyConfig = CertifyConfig()
) -> list[Attempt]:
    """Repeat the pushes of the fastest option in the scene. Each push starts from the state after the one before.

    Args:
        grid: map of the scenario.
        scenario: scenario of the certificate.
        certificate: certificate whose pushes are repeated.
        cfg: settings of the pushes.

    Returns:
        The repeated attempts, in order.
    """
    search = _Search(grid, scenario, cfg)
    state = search.start()
    for old in (certificate.attempts[i] for i in certificate.best):
        push = ScriptedPush(
            old.object, search.faces[old.object][old.face], old.lateral, old.steering, np.array(old.start)
        )
        fixed = next(fixed for index, fixed in search.in_the_way(state) if index == old.object)
        ((number, end),) = search.tried(state, old.object, fixed, [(old.face, push)])
        state = state.then(search.attempts[number], number, end)
    return search.attempts
