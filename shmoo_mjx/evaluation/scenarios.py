"""Navigation scenarios on any map: objects block doorways and corridors, and a way to the goal is known to exist.

A scenario is kept only with a proof of its kind. *Detour*: a path clear of walls and of every object where it stands.
*Push*: a face that can be walked to, a straight push from it through free space, a path to the goal past the object
where that push ends, and a plant in which the robot's steady push on that face moves it. What pushes over and around
several objects could do beyond that is left to the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import cycle
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import shapely
from scipy import ndimage

from shmoo_mjx import se2
from shmoo_mjx.arrays import Array
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.manipulable import IMMOVABLE, draw_immovable, manipulable, near_border
from shmoo_mjx.faces import faces_of, heading, stand_off
from shmoo_mjx.navigation.clearance import ClearanceField
from shmoo_mjx.navigation.footprints import add_obstacles, footprint_polygon, footprints_free, wall_distance
from shmoo_mjx.navigation.maps import OccupancyGrid, clearance_field
from shmoo_mjx.navigation.paths import Path, path_blocked_by, plan_path, point_at, tangent_at
from shmoo_mjx.navigation.scenario import ROBOT_RADIUS, Limits, ObjectEntry, Scenario
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import FAMILIES, draw_condition

Kind = Literal["push only", "detour only", "either"]
KINDS: tuple[Kind, ...] = get_args(Kind)


class Truth(NamedTuple):
    """What is known about a push on a face of an object; each takes (condition, side)."""

    moves: Callable[[Condition, int], bool]
    """Does the robot's push move the object."""
    near: Callable[[Condition, int], bool] = lambda condition, side: False
    """Is it near the border between the two."""


PLANT = Truth(manipulable, near_border)


@dataclass(frozen=True)
class ScenarioConfig:
    """What scenarios look like. Lengths in m."""

    path: tuple[float, float] = (4.0, 14.0)
    """Length of the shortest path from start to goal past no object."""
    longest: float = 32.0
    """Length of the longest way round that counts as one."""
    start_clearance: float = 0.45
    """Room round start and goal."""
    narrow: tuple[float, float] = (0.75, 1.80)
    """Width of a doorway or corridor, for it to be blocked."""
    blocked: float = 1.0
    """A path is blocked by objects that make the way round at least this much longer."""
    ahead: tuple[float, float] = (1.6, 1.0)
    """How far a blocked place is from start and from goal, along the path."""
    objects: int = 4
    """Most objects. How many there shall be is drawn evenly; what blocks nothing is added until there are so many."""
    margin: float = 0.04
    """Room between objects and walls."""
    reach: float = 2.5
    """Longest straight push that is looked at."""
    attempts: int = 150
    """Draws of start and goal before a kind is given up."""
    time_s: float = 240.0
    """Limit of the run [s]."""


class Generated(NamedTuple):
    """A scenario and what is known about it."""

    scenario: Scenario
    kind: Kind
    movable: tuple[bool, ...]
    """Of each object, as the plant says for the face of the proof."""
    blocking: tuple[bool, ...]
    """Of each object: was it put into a blocked place, or does it stand about."""
    shortest: float
    """Length of the path past no object."""
    detour: float | None
    """Length of the path round all of them, if there is one."""
    border: tuple[bool, ...] = ()
    """Of each object: is it near the border of manipulability, so that the verdict hangs on little."""


@dataclass
class _Placed:
    """An object of a scenario in the making."""

    condition: Condition
    pose: np.ndarray
    movable: bool
    blocking: bool

    @property
    def polygon(self) -> shapely.Polygon:
        return footprint_polygon(self.pose, self.condition.half_extents)


@dataclass
class _Site:
    """A scenario in the making: map, start and goal, what has been put there, and what more is drawn by."""

    grid: OccupancyGrid
    walls: ClearanceField
    rng: np.random.Generator
    seeds: Iterator[int]
    """Of the objects."""
    truth: Truth
    cfg: ScenarioConfig
    start: np.ndarray
    goal: np.ndarray
    path: Path
    placed: list[_Placed] = field(default_factory=list)

    def way(self, start: Array, obstacles: list[shapely.Polygon], end: Array | None = None) -> Path | None:
        end = self.goal if end is None else end
        return plan_path(self.grid, start, end, obstacles, ROBOT_RADIUS, field=self.walls)

    def polygons(self, without: _Placed | None = None) -> list[shapely.Polygon]:
        return [p.polygon for p in self.placed if p is not without]


def draw_scenario(
    grid: OccupancyGrid,
    kind: Kind,
    rng: np.random.Generator,
    first_seed: int,
    truth: Truth = PLANT,
    cfg: ScenarioConfig = ScenarioConfig(),
) -> Generated:
    """Draw a scenario of ``kind``, whose objects have some of the 1,000 seeds from ``first_seed`` on.

    Raises:
        ShmooError: the map has no place for such a scenario.
    """
    walls = clearance_field(grid)
    seeds = cycle(first_seed + rng.permutation(1000).astype(int))
    room = largest_room(np.asarray(walls.values), cfg.start_clearance)
    for _ in range(cfg.attempts if len(room) else 0):
        ends = _draw_ends(grid, walls, room, rng, cfg)
        if ends is None:
            continue
        site = _Site(grid, walls, rng, seeds, truth, cfg, *ends)
        if not _block(site, kind):
            continue
        _add_bystanders(site)
        found = _classify(site)
        if found is not None and found.kind == kind:
            return found._replace(scenario=found.scenario.model_copy(update={"seed": int(rng.integers(10**6))}))
    source = grid.source or "the map"
    raise ShmooError(f"{source}: no '{kind}' scenario was found in {cfg.attempts} draws; give another map.")


def largest_room(clearance: np.ndarray, radius: float) -> np.ndarray:
    """Cells ``[N, 2]`` of the largest connected part in which a robot with this much room can go about."""
    labels, count = ndimage.label(clearance >= radius, np.ones((3, 3)))
    if count == 0:
        return np.zeros((0, 2), dtype=int)
    connected, _ = ndimage.label(clearance >= ROBOT_RADIUS, np.ones((3, 3)))
    sizes = np.bincount(connected[labels > 0])
    return np.argwhere((labels > 0) & (connected == sizes.argmax()))


def _draw_ends(
    grid: OccupancyGrid, walls: ClearanceField, room: np.ndarray, rng: np.random.Generator, cfg: ScenarioConfig
) -> tuple[np.ndarray, np.ndarray, Path] | None:
    start = grid.cell_to_world(room[rng.integers(len(room))])
    centres = grid.cell_to_world(room)
    distance = np.linalg.norm(centres - start, axis=1)
    near = np.flatnonzero((distance > 0.6 * cfg.path[0]) & (distance < cfg.path[1]))
    if not near.size:
        return None
    goal = centres[near[rng.integers(near.size)]]
    path = plan_path(grid, start, goal, robot_radius=ROBOT_RADIUS, field=walls)
    if path is None or not cfg.path[0] <= path.length <= cfg.path[1]:
        return None
    return start, goal, path


class _Narrow(NamedTuple):
    """A place where a path passes between two walls."""

    centre: np.ndarray
    """``[2]`` in {W}, midway between the walls."""
    along: float
    """Direction of the path [rad]."""
    width: float
    """From wall to wall [m]."""


def _narrow_places(site: _Site, path: Path) -> list[_Narrow]:
    """Doorways and corridors of ``path`` that one object could block."""
    cfg = site.cfg
    s = np.arange(cfg.ahead[0], path.length - cfg.ahead[1], 0.1)
    if not s.size:
        return []
    tangent, points = tangent_at(path, s), point_at(path, s)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
    reach = np.arange(0.0, cfg.narrow[1], 0.05)
    sides = []
    for sign in (1.0, -1.0):
        rays = points[:, None] + sign * reach[:, None] * normal[:, None]
        wall = np.asarray(site.walls.at(rays)) < 0.3 * float(site.walls.resolution)
        sides.append(np.where(wall.any(axis=1), reach[wall.argmax(axis=1)], np.inf))
    width = sides[0] + sides[1]
    good = np.flatnonzero((width >= cfg.narrow[0]) & (width <= cfg.narrow[1]))
    middle = points[good] + 0.5 * (sides[0][good] - sides[1][good])[:, None] * normal[good]
    along = np.arctan2(tangent[good, 1], tangent[good, 0])
    return [_Narrow(*place) for place in zip(middle, along, width[good], strict=True)]


def _block(site: _Site, kind: Kind) -> bool:
    """Put objects in the way until the kind of solution that is wanted is the one there is, so far as can be seen."""
    path, movable, cfg = site.path, kind != "detour only", site.cfg
    while _block_path(site, path, movable):
        around = site.way(site.start, site.polygons())
        if around is None:
            return kind == "push only"
        if around.length < path.length + cfg.blocked:
            return False
        if kind != "push only":
            return around.length <= cfg.longest
        if len(site.placed) >= cfg.objects:
            return False
        path, movable = around, False
    return False


def _block_path(site: _Site, path: Path, movable: bool) -> bool:
    """Put one object into a narrow place of ``path`` so that nobody gets past it there."""
    places = _narrow_places(site, path)
    for i in site.rng.permutation(len(places))[:6]:
        for _ in range(6):
            placed = _place(places[i], _draw_object(site, movable), movable, site.rng)
            if _fits(site, placed) and _stops(path, places[i], placed) and _as_wanted(site, placed):
                site.placed.append(placed)
                return True
    return False


def _place(narrow: _Narrow, condition: Condition, movable: bool, rng: np.random.Generator) -> _Placed:
    """The object across or along a narrow place, a little askew and off its middle."""
    yaw = narrow.along + rng.integers(4) * np.pi / 2 + rng.uniform(-0.12, 0.12)
    pose = np.array([*(narrow.centre + rng.uniform(-0.05, 0.05, 2)), se2.wrap(yaw)])
    return _Placed(condition, pose, movable, True)


def _draw_object(site: _Site, movable: bool) -> Condition:
    """One that may be of the wanted sort, as the plant has to say. A quarter of the immovable ones are drawn as any."""
    seed, rng = int(next(site.seeds)), site.rng
    family, sort = FAMILIES[rng.integers(3)], int(rng.integers(len(IMMOVABLE) + 1))
    # Only these, which nothing was done to, can be so near the border that they nearly move.
    if movable or sort == len(IMMOVABLE):
        return draw_condition(family, seed)
    return draw_immovable(IMMOVABLE[sort], family, seed)


def _fits(site: _Site, placed: _Placed) -> bool:
    """Clear of walls, of the other objects, and of start and goal."""
    others = add_obstacles(site.walls, site.polygons())
    free = footprints_free(others, placed.pose, placed.condition.half_extents, wall_clearance=site.cfg.margin)[0]
    ends = shapely.MultiPoint([site.start, site.goal])
    room = bool(free) and placed.polygon.distance(ends) > ROBOT_RADIUS + 0.15
    # The corner of a wall may lie between the points at which the footprint is looked at.
    return room and wall_distance(site.grid, placed.polygon, 0.0) > 0


def _stops(path: Path, narrow: _Narrow, placed: _Placed) -> bool:
    """Is too little room left on either side of the object for the robot."""
    normal = np.array([-np.sin(narrow.along), np.cos(narrow.along)])
    across = (shapely.get_coordinates(placed.polygon) - narrow.centre) @ normal
    widest = max(narrow.width / 2 - across.max(), narrow.width / 2 + across.min())
    return widest < 2 * ROBOT_RADIUS and path_blocked_by(path, placed.polygon, ROBOT_RADIUS)[0]


def _as_wanted(site: _Site, placed: _Placed) -> bool:
    """Does the plant agree that it can be moved from a face where a push helps, or can't be from any in reach."""
    sides = _helpful_sides(site, placed) if placed.movable else _reachable_sides(site, placed)
    return any(site.truth.moves(placed.condition, side) for side in sides) == placed.movable


def _reachable_sides(site: _Site, placed: _Placed) -> Iterator[int]:
    obstacles = [*site.polygons(placed), placed.polygon]
    room = add_obstacles(site.walls, obstacles)
    for side, face in enumerate(faces_of(placed.condition.half_extents)):
        stand = stand_off(placed.pose, face, 0.12)[:2]
        if room.at(stand) >= ROBOT_RADIUS and site.way(site.start, obstacles, stand) is not None:
            yield side


def _helpful_sides(site: _Site, placed: _Placed) -> Iterator[int]:
    """Faces from which a straight push through free space opens the way to the goal."""
    others = site.polygons(placed)
    room = add_obstacles(site.walls, others)
    half = placed.condition.half_extents
    for side in _reachable_sides(site, placed):
        face = faces_of(half)[side]
        direction = heading(placed.pose, face)
        steps = np.arange(0.1, site.cfg.reach, 0.1)
        poses = placed.pose + steps[:, None] * np.array([np.cos(direction), np.sin(direction), 0.0])
        free = footprints_free(room, poses, half, wall_clearance=site.cfg.margin)
        count = len(steps) if free.all() else int(np.argmin(free))
        for pose in poses[2:count:3]:
            robot = stand_off(pose, face, 0.12)[:2]
            if room.at(robot) < ROBOT_RADIUS - 0.02:
                break
            if site.way(robot, [*others, footprint_polygon(pose, half)]) is not None:
                yield side
                break


def _add_bystanders(site: _Site) -> None:
    """Objects beside the path that block nothing, until there are as many as drawn."""
    rng = site.rng
    wanted = int(rng.integers(1, site.cfg.objects + 1))
    for _ in range(20):
        if len(site.placed) >= wanted:
            return
        movable = bool(rng.random() < 0.5)
        s, side = rng.uniform(0.0, site.path.length), rng.choice([-1.0, 1.0])
        along = tangent_at(site.path, s)
        place = point_at(site.path, s) + side * rng.uniform(0.8, 1.8) * np.array([-along[1], along[0]])
        condition = _draw_object(site, movable)
        placed = _Placed(condition, np.array([*place, rng.uniform(-np.pi, np.pi)]), movable, False)
        open_floor = _fits(site, placed) and not path_blocked_by(site.path, placed.polygon, ROBOT_RADIUS)[0]
        if open_floor and _leaves_ways(site, placed):
            placed.movable = any(site.truth.moves(condition, face) for face in _reachable_sides(site, placed))
            site.placed.append(placed)


def _leaves_ways(site: _Site, placed: _Placed) -> bool:
    before, after = (site.way(site.start, [*site.polygons(), *more]) for more in ([], [placed.polygon]))
    if before is None or after is None:
        return before is after
    return after.length < before.length + 0.3


def _classify(site: _Site) -> Generated | None:
    """The finished scenario with its kind, or None if no solution is known."""
    around = site.way(site.start, site.polygons())
    pushes = any(_as_wanted(site, p) for p in site.placed if p.movable and p.blocking)
    detour = None if around is None or around.length > site.cfg.longest else around.length
    if detour is None and not pushes:
        return None
    kind: Kind = "detour only" if not pushes else "push only" if around is None else "either"
    along = tangent_at(site.path, 0.3)
    start = (*site.start, np.arctan2(along[1], along[0]))
    scenario = Scenario(
        start=_rounded(start),
        goal=_rounded(site.goal),
        objects=tuple(entry_of(p.condition, p.pose) for p in site.placed),
        limits=Limits(time_s=site.cfg.time_s),
    )
    movable, blocking = tuple(p.movable for p in site.placed), tuple(p.blocking for p in site.placed)
    border = tuple(_near_border(site, p) for p in site.placed)
    return Generated(scenario, kind, movable, blocking, site.path.length, detour, border)


def _near_border(site: _Site, placed: _Placed) -> bool:
    """Of what can be moved: is it so from no face without doubt. Of what can't: is there a face that raises a doubt."""
    truth = site.truth
    if placed.movable:
        sides = _helpful_sides(site, placed) if placed.blocking else _reachable_sides(site, placed)
        near = [truth.near(placed.condition, side) for side in sides if truth.moves(placed.condition, side)]
        return bool(near) and all(near)
    return any(truth.near(placed.condition, side) for side in _reachable_sides(site, placed))


def entry_of(condition: Condition, pose: Array) -> ObjectEntry:
    """The object with every property spelt out, to stand at ``pose [3]``."""
    given = {k: v for k, v in condition.to_dict().items() if k not in ("family", "seed") and v != ()}
    properties: dict[str, Any] = {k: list(v) if isinstance(v, tuple) else v for k, v in given.items()}
    return ObjectEntry(family=condition.family, pose=_rounded(pose), seed=condition.seed, properties=properties)


def _rounded(values: Array) -> Any:
    return tuple(round(float(v), 3) for v in values)
