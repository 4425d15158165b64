"""Navigation scenarios on any map: objects block doorways and corridors, and each scenario has a certificate.

A scenario is drawn for a range of the extra length of the way round. The certificate (`certify`) then shows whether its
objects can be pushed out of the way, and this gives the kind of the scenario.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import cycle, pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
import shapely
from pydantic import BaseModel, ConfigDict, Field
from scipy import ndimage

from shmoo_mjx.arrays import Array, Numbers
from shmoo_mjx.base.schema import Number
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.certify import Certificate, certify
from shmoo_mjx.evaluation.manipulable import IMMOVABLE, SteadyPush, draw_immovable
from shmoo_mjx.geometry import se2
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.footprints import add_obstacles, footprint_polygon, footprints_free, wall_distance
from shmoo_mjx.planning.maps import OccupancyGrid, distance_field
from shmoo_mjx.planning.paths import Path, path_blocked_by, plan_path, point_at, tangent_at
from shmoo_mjx.planning.scenario import ROBOT_RADIUS, Limits, ObjectEntry, Scenario
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.objects import FAMILIES, draw_condition

Kind = Literal["push only", "detour only", "either", "unsolvable"]
KINDS: tuple[Kind, ...] = ("push only", "detour only", "either")
"""Kinds of scenarios that can be solved."""
Extra = tuple[float, float] | None
"""Range of the extra length of the way round, compared with the path without objects [m]; None for no way round."""
_BOUNDS = np.geomspace(1.0, 60.0, 9).round(2).tolist()
EXTRAS: tuple[Extra, ...] = (*pairwise(_BOUNDS[:5]), None, *pairwise(_BOUNDS[4:]), None)
"""Ranges for which scenarios are drawn in turn: uniform in the logarithm from 1 to 60 m, and one in five without a way
round."""


@dataclass(frozen=True)
class ScenarioConfig:
    """Settings of the drawn scenarios."""

    path: tuple[float, float] = (4.0, 14.0)
    """Minimum and maximum length of the path from start to goal without objects [m]."""
    start_clearance: float = 0.45
    """Minimum distance of start and goal from walls [m]."""
    narrow: tuple[float, float] = (0.75, 1.80)
    """Minimum and maximum width of a doorway or corridor that an object may block [m]."""
    movable: float = 0.8
    """Share of objects that are drawn as any of their family. The others are heavy, have locked wheels or are fixed."""
    ahead: tuple[float, float] = (1.6, 1.0)
    """Minimum distances of a blocked place from the start and from the goal, along the path [m]."""
    objects: int = 4
    """Maximum number of objects. The wanted number is drawn uniformly, and objects that block nothing fill it up."""
    margin: float = 0.04
    """Minimum gap between an object and walls or other objects [m]."""
    attempts: int = 150
    """Maximum number of draws of start and goal for a range of the extra length."""
    time_s: float = 240.0
    """Time limit of the run [s]."""


class Generated(BaseModel):
    """A scenario and its known properties."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    scenario: Scenario
    kind: Kind
    movable: tuple[bool, ...]
    """For each object, whether some push of the certificate moves it along the push. An object that was not tried
    counts as it was drawn."""
    blocking: tuple[bool, ...]
    """For each object, whether it was placed to block a path. False for objects beside the path."""
    shortest: Number = Field(gt=0)
    """Length of the path without objects [m]."""
    detour: Number | None
    """Length of the path round all objects [m]; None if there is none."""
    certificate: Certificate | None = None
    """Outcomes of all options; None in scenario sets without certificates."""

    @property
    def extra(self) -> float | None:
        """Extra length of the way round [m]; None if there is no way round."""
        return None if self.detour is None else self.detour - self.shortest


@dataclass
class _Placed:
    """An object placed in a scenario that is being drawn."""

    condition: Condition
    pose: np.ndarray
    movable: bool
    blocking: bool

    @property
    def polygon(self) -> shapely.Polygon:
        return footprint_polygon(self.pose, self.condition.half_extents)


@dataclass
class _Site:
    """A scenario that is being drawn: map, start, goal, path, placed objects, and random state."""

    grid: OccupancyGrid
    walls: DistanceField
    rng: np.random.Generator
    seeds: Iterator[int]
    """Seeds of the objects."""
    cfg: ScenarioConfig
    start: np.ndarray
    goal: np.ndarray
    path: Path
    placed: list[_Placed] = field(default_factory=list)

    def way(self, start: Array, obstacles: list[shapely.Polygon], end: Array | None = None) -> Path | None:
        end = self.goal if end is None else end
        return plan_path(self.grid, start, end, obstacles, robot_radius=ROBOT_RADIUS, wall_clearance=self.walls)

    def polygons(self, without: _Placed | None = None) -> list[shapely.Polygon]:
        return [p.polygon for p in self.placed if p is not without]


def draw_scenario(
    grid: OccupancyGrid,
    extra: Extra,
    rng: np.random.Generator,
    first_seed: int,
    *,
    cfg: ScenarioConfig = ScenarioConfig(),
    certifier: Callable[[OccupancyGrid, Scenario], Certificate] = certify,
) -> Generated:
    """Draw a scenario with an extra length of the way round within ``extra``.

    Args:
        grid: map.
        extra: range of the extra length [m]; None for no way round.
        rng: random state.
        first_seed: first of the 1,000 consecutive seeds that the objects may have.
        cfg: settings.
        certifier: makes the certificate of the scenario.

    Raises:
        ShmooError: the map has no place for such a scenario.
    """
    walls = distance_field(grid)
    seeds = cycle(first_seed + rng.permutation(1000).astype(int))
    room = largest_room(np.asarray(walls.values), cfg.start_clearance)
    for _ in range(cfg.attempts if len(room) else 0):
        ends = _draw_ends(grid, walls, room, rng, cfg=cfg)
        if ends is None:
            continue
        site = _Site(grid, walls, rng, seeds, cfg, *ends)
        if _block(site, extra):
            _add_bystanders(site)
            return _certified(site, certifier)
    wanted = "no way round" if extra is None else f"a way round longer by {extra[0]:g} to {extra[1]:g} m"
    source = grid.source or "the map"
    raise ShmooError(f"{source}: no scenario with {wanted} was found in {cfg.attempts} draws; give another map.")


def largest_room(clearance: np.ndarray, radius: float) -> np.ndarray:
    """Cells with enough clearance in the connected region that has most of them.

    Args:
        clearance: ``[H, W]`` distance of each cell from walls [m]. The robot can drive between connected cells.
        radius: minimum clearance of the returned cells [m].

    Returns:
        Row and column ``[N, 2]`` of the cells.
    """
    labels, count = ndimage.label(clearance >= radius, np.ones((3, 3)))
    if count == 0:
        return np.zeros((0, 2), dtype=int)
    connected, _ = ndimage.label(clearance >= ROBOT_RADIUS, np.ones((3, 3)))
    sizes = np.bincount(connected[labels > 0])
    return np.argwhere((labels > 0) & (connected == sizes.argmax()))


def _draw_ends(
    grid: OccupancyGrid, walls: DistanceField, room: np.ndarray, rng: np.random.Generator, *, cfg: ScenarioConfig
) -> tuple[np.ndarray, np.ndarray, Path] | None:
    start = grid.cell_to_world(room[rng.integers(len(room))])
    centres = grid.cell_to_world(room)
    distance = np.linalg.norm(centres - start, axis=1)
    near = np.flatnonzero((distance > 0.6 * cfg.path[0]) & (distance < cfg.path[1]))
    if not near.size:
        return None
    goal = centres[near[rng.integers(near.size)]]
    path = plan_path(grid, start, goal, robot_radius=ROBOT_RADIUS, wall_clearance=walls)
    if path is None or not cfg.path[0] <= path.length <= cfg.path[1]:
        return None
    return start, goal, path


class _Narrow(NamedTuple):
    """A place where a path passes between two walls."""

    centre: np.ndarray
    """Point ``[2]`` in {W} midway between the walls [m]."""
    along: float
    """Direction of the path in {W} [rad]."""
    width: float
    """Distance between the walls [m]."""


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


def _block(site: _Site, extra: Extra) -> bool:
    """Place objects on the path and on the ways round it; whether the extra length then lies within ``extra``."""
    path = site.path
    while _block_path(site, path):
        around = site.way(site.start, site.polygons())
        if around is None:
            return extra is None
        longer = around.length - site.path.length
        if extra is not None and longer >= extra[0]:
            return longer < extra[1]
        if len(site.placed) >= site.cfg.objects:
            return False
        path = around
    return False


def _block_path(site: _Site, path: Path) -> bool:
    """Place one object in a narrow place of ``path``, so that the robot cannot pass it there; whether this succeeds."""
    places = _narrow_places(site, path)
    for i in site.rng.permutation(len(places))[:6]:
        for _ in range(3):
            movable = bool(site.rng.random() < site.cfg.movable)
            placed = _place(places[i], _draw_object(site, movable), movable, site.rng)
            if _fits(site, placed) and _stops(path, places[i], placed):
                site.placed.append(placed)
                return True
    return False


def _place(narrow: _Narrow, condition: Condition, movable: bool, rng: np.random.Generator) -> _Placed:
    """The object across or along a narrow place, with a small random yaw error and offset."""
    yaw = narrow.along + rng.integers(4) * np.pi / 2 + rng.uniform(-0.12, 0.12)
    pose = np.array([*(narrow.centre + rng.uniform(-0.05, 0.05, 2)), se2.wrap(yaw)])
    return _Placed(condition, pose, movable, True)


def _draw_object(site: _Site, movable: bool) -> Condition:
    """An object with the next seed: any of its family, or one that should not move."""
    seed, rng = int(next(site.seeds)), site.rng
    family, sort = FAMILIES[rng.integers(3)], IMMOVABLE[rng.integers(len(IMMOVABLE))]
    return draw_condition(family, seed) if movable else draw_immovable(sort, family, seed)


def _fits(site: _Site, placed: _Placed) -> bool:
    """Whether the object is clear of walls, other objects, start and goal."""
    others = add_obstacles(site.walls, site.polygons())
    free = footprints_free(others, placed.pose, placed.condition.half_extents, wall_clearance=site.cfg.margin)[0]
    ends = shapely.MultiPoint([site.start, site.goal])
    room = bool(free) and placed.polygon.distance(ends) > ROBOT_RADIUS + 0.15
    # `footprints_free` samples the footprint at points, and the corner of a wall may lie between them.
    return room and wall_distance(site.grid, placed.polygon, 0.0) > 0


def _stops(path: Path, narrow: _Narrow, placed: _Placed) -> bool:
    """Whether the gaps on both sides of the object are too narrow for the robot."""
    normal = np.array([-np.sin(narrow.along), np.cos(narrow.along)])
    across = (shapely.get_coordinates(placed.polygon) - narrow.centre) @ normal
    widest = max(narrow.width / 2 - across.max(), narrow.width / 2 + across.min())
    return widest < 2 * ROBOT_RADIUS and path_blocked_by(path, placed.polygon, ROBOT_RADIUS)[0]


def _add_bystanders(site: _Site) -> None:
    """Add objects beside the path that block nothing, up to a random number of objects."""
    rng = site.rng
    wanted = int(rng.integers(1, site.cfg.objects + 1))
    for _ in range(20):
        if len(site.placed) >= wanted:
            return
        movable = bool(rng.random() < site.cfg.movable)
        s, side = rng.uniform(0.0, site.path.length), rng.choice([-1.0, 1.0])
        along = tangent_at(site.path, s)
        place = point_at(site.path, s) + side * rng.uniform(0.8, 1.8) * np.array([-along[1], along[0]])
        placed = _Placed(_draw_object(site, movable), np.array([*place, rng.uniform(-np.pi, np.pi)]), movable, False)
        open_floor = _fits(site, placed) and not path_blocked_by(site.path, placed.polygon, ROBOT_RADIUS)[0]
        if open_floor and _leaves_ways(site, placed):
            site.placed.append(placed)


def _leaves_ways(site: _Site, placed: _Placed) -> bool:
    before, after = (site.way(site.start, [*site.polygons(), *added]) for added in ([], [placed.polygon]))
    if before is None or after is None:
        return before is after
    return after.length < before.length + 0.3


def _certified(site: _Site, certifier: Callable[[OccupancyGrid, Scenario], Certificate]) -> Generated:
    """The finished scenario with its certificate and kind."""
    around = site.way(site.start, site.polygons())
    along = tangent_at(site.path, 0.3)
    start = (*site.start, np.arctan2(along[1], along[0]))
    scenario = Scenario(
        start=_rounded(start),
        goal=_rounded(site.goal),
        objects=tuple(entry_of(p.condition, p.pose) for p in site.placed),
        limits=Limits(time_s=site.cfg.time_s),
        seed=int(site.rng.integers(10**6)),
    )
    certificate = certifier(site.grid, scenario)
    pushes = any(a.result == "free" for a in certificate.attempts)
    with_way_round: tuple[Kind, Kind] = ("detour only", "either")
    without: tuple[Kind, Kind] = ("unsolvable", "push only")
    return Generated(
        scenario=scenario,
        kind=(without if around is None else with_way_round)[pushes],
        movable=tuple(certificate.moves(i, SteadyPush().distance, p.movable) for i, p in enumerate(site.placed)),
        blocking=tuple(p.blocking for p in site.placed),
        shortest=site.path.length,
        detour=None if around is None else around.length,
        certificate=certificate,
    )


def entry_of(condition: Condition, pose: Array | Numbers) -> ObjectEntry:
    """The object with all its properties given explicitly, at ``pose [3]`` in {W}."""
    stated = {k: v for k, v in condition.to_dict().items() if k not in ("family", "seed") and v != ()}
    properties: dict[str, Any] = {k: list(v) if isinstance(v, tuple) else v for k, v in stated.items()}
    return ObjectEntry(family=condition.family, pose=_rounded(pose), seed=condition.seed, properties=properties)


def _rounded(values: Array | Numbers) -> Any:
    return tuple(round(float(v), 3) for v in values)
