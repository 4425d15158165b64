"""ShmooNavigate: through the demo's three rooms, where a box can be pushed away and a locked wheelchair can't."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from shmoo_mjx.arrays import Array
from shmoo_mjx.geometry import se2
from shmoo_mjx.gym.task import ACTIONS, BODY, Outcome, Part, Start, body, command, config_of, flat, in_robot, widened
from shmoo_mjx.planning.floorplan import RESOLUTION, demo_scenario
from shmoo_mjx.planning.line_costs import PathConfig
from shmoo_mjx.planning.maps import OccupancyGrid, occupied_rectangles
from shmoo_mjx.planning.paths import cost_to_go
from shmoo_mjx.planning.scenario import ROBOT_RADIUS
from shmoo_mjx.sensing.rays import cast
from shmoo_mjx.types import Command, Observation

_OBJECTS = 2
"""The demo's box and wheelchair."""
_RAYS = 32
_FAR = 1e6


@dataclass(frozen=True)
class NavigateConfig:
    """Choices of the task, SI units."""

    reach: float = 3.5
    """Longest of the ranges [m]; the observation space is as wide."""
    arrived: float = 0.25
    """Distance from the goal that counts as success [m]."""
    slow: float = 0.1
    """Speed below which arriving there counts [m/s]."""
    lookahead: float = 0.4
    """How far ahead the direction of the way is looked up [m]."""
    fall: float = -1.0
    bonus: float = 1.0
    bump: float = -0.05
    """Per 0.1 s in contact with a wall."""


class Rooms(NamedTuple):
    """What differs between worlds. K walls, N objects."""

    goal: np.ndarray
    """``[W, 2]`` in {W}."""
    half_extents: np.ndarray
    """``[W, N, 2]`` of the objects [m]."""
    wall_pose: np.ndarray
    """``[W, K, 3]`` in {W}."""
    wall_half: np.ndarray
    """``[W, K, 2]`` [m]"""
    way: np.ndarray
    """``[W, rows, columns]`` length of the way to the goal [m]."""


def _object_parts(i: int) -> tuple[Part, ...]:
    return (
        Part(f"object{i}_seen", 1, 0.0, 1.0, "1", "1 if the object is detected; else all about it is 0"),
        Part(f"object{i}", 4, -10.0, 10.0, "m, 1", "its x, y, and cos and sin of its yaw"),
        Part(f"object{i}_twist", 3, -10.0, 10.0, "m/s, rad/s", "its velocity (x, y) and yaw rate"),
        Part(f"object{i}_wrench", 3, -500.0, 500.0, "N, N m", "of the hands on it about its centre, mean over 0.1 s"),
        Part(f"object{i}_half_extents", 2, 0.0, 2.0, "m", "half its length and half its width"),
    )


class NavigateTask:
    """The robot knows the map, not what stands in it; it sees what its senses show."""

    observation: tuple[Part, ...] = (
        *BODY,
        Part("goal", 2, -20.0, 20.0, "m", "the goal's x and y"),
        Part("way", 3, -1.0, 40.0, "m, 1", "length of the way to the goal on the map; cos and sin of its direction"),
        Part("ranges", _RAYS, 0.0, 3.5, "m", "to the next wall or known object, each 11.25 deg from ahead to the left"),
        *(part for i in range(_OBJECTS) for part in _object_parts(i)),
    )  # fmt: skip
    action: tuple[Part, ...] = (*ACTIONS, Part("arms", 1, 0.0, 1.0, "1", "from folded (0) to extended in front (1)"))
    poses_known = False

    def __init__(self, config: NavigateConfig | None = None) -> None:
        self.config = config_of(NavigateConfig, config)
        self.observation = widened(type(self).observation, ("ranges",), self.config.reach)
        self.fall, self.bonus, self.bump = self.config.fall, self.config.bonus, self.config.bump
        angles = 2 * np.pi * np.arange(_RAYS) / _RAYS
        self._rays = np.stack([np.cos(angles), np.sin(angles)], axis=-1)

    def draw(self, rng: np.random.Generator, same_world: Start | None = None) -> Start:
        """A floor plan with its objects as ``shmoo demo`` draws them; in the same world the same once more."""
        if same_world is not None:
            return same_world
        grid, scenario = demo_scenario(int(rng.integers(2**31)))
        return Start(
            conditions=tuple(o.condition() for o in scenario.objects),
            object_poses=np.array([o.pose for o in scenario.objects]),
            robot_pose=np.array(scenario.start),
            goal=np.array(scenario.goal),
            walls=np.array(occupied_rectangles(grid, unknown_borders=True)),
            way=_way_to(grid, np.array(scenario.goal)),
        )

    def gather(self, starts: Sequence[Start]) -> Rooms:
        """Goals, footprints, walls and maps; what is missing in the smaller ones lies far away."""
        count = max(len(s.walls) for s in starts)
        walls = np.full((len(starts), count, 4), [_FAR, _FAR, 0.0, 0.0])
        way = np.full((len(starts), *np.max([s.way.shape for s in starts], axis=0)), 40.0, dtype=np.float32)
        for i, start in enumerate(starts):
            walls[i, : len(start.walls)] = start.walls
            way[i, : start.way.shape[0], : start.way.shape[1]] = start.way
        pose = np.concatenate([walls[..., :2], np.zeros((*walls.shape[:2], 1))], axis=-1)
        half = np.array([[c.half_extents for c in s.conditions] for s in starts], dtype=float)
        return Rooms(np.stack([s.goal for s in starts]), half, pose, walls[..., 2:], way)

    def command(self, actions: np.ndarray, observed: Observation) -> Command:
        """The last action folds and extends the arms."""
        return command(actions, observed, actions[:, 4])

    def observe(self, context: Rooms, observed: Observation) -> np.ndarray:
        """See ``observation``."""
        yaw, position = observed.robot_pose[:, 2], observed.robot_pose[:, :2]
        rays = se2.rotate(self._rays[None], yaw[:, None])
        object_pose = np.where(np.isfinite(observed.object_pose), observed.object_pose, _FAR)
        pose = np.concatenate([context.wall_pose, object_pose], axis=1)
        half = np.concatenate([context.wall_half, context.half_extents], axis=1)
        values = body(observed) | {
            "goal": se2.inverse_transform_point(observed.robot_pose, context.goal),
            "way": self._way(context, observed),
            "ranges": cast(position, rays, pose, half, reach=self.config.reach),
        }
        shown = np.asarray(observed.detected, dtype=bool)
        for i in range(_OBJECTS):
            about = {
                "": in_robot(observed, np.where(shown[:, i, None], observed.object_pose[:, i], 0.0)),
                "_twist": se2.rotate(observed.object_twist[:, i], -yaw),
                "_wrench": se2.rotate(observed.wrench[:, i], -yaw),
                "_half_extents": context.half_extents[:, i],
                "_seen": np.ones((len(yaw), 1)),
            }
            values |= {f"object{i}{name}": np.where(shown[:, i, None], value, 0.0) for name, value in about.items()}
        return flat(self.observation, values)

    def judge(self, context: Rooms, true: Observation) -> Outcome:
        """The potential is minus the length of the way to the goal on the map, whatever stands in it."""
        position = true.robot_pose[:, :2]
        distance = np.linalg.norm(position - context.goal, axis=-1)
        slow = np.linalg.norm(true.robot_twist[:, :2], axis=-1) < self.config.slow
        way = _look_up(context.way, position[:, None])[:, 0]
        return Outcome(-way, distance, (distance < self.config.arrived) & slow)

    def _way(self, context: Rooms, observed: Observation) -> np.ndarray:
        """``[W, 3]`` length, and direction in {R} of the point round the robot from which the way is shortest."""
        points = observed.robot_pose[:, None, :2] + self.config.lookahead * self._rays
        best = np.argmin(_look_up(context.way, points), axis=1)
        here = _look_up(context.way, observed.robot_pose[:, None, :2])
        return np.concatenate([here, se2.rotate(self._rays[best], -observed.robot_pose[:, 2])], axis=-1)


def _way_to(grid: OccupancyGrid, goal: np.ndarray) -> np.ndarray:
    """Length ``[H, W]`` [m] of the robot's shortest way to the goal; near walls, by the nearest free cell."""
    length = cost_to_go(grid, goal, robot_radius=ROBOT_RADIUS, cfg=PathConfig(soft_weight=0.0))
    away, (rows, columns) = distance_transform_edt(~np.isfinite(length), return_indices=True)
    return length[rows, columns] + away * grid.resolution


def _look_up(way: np.ndarray, points: Array) -> np.ndarray:
    """Bilinear ``[W, P]`` at ``points [W, P, 2]`` in {W}; a floor plan's origin is its lower-left corner."""
    cells = points / RESOLUTION - 0.5
    world = np.broadcast_to(np.arange(len(way))[:, None], cells.shape[:2])
    return map_coordinates(way, np.stack([world, cells[..., 1], cells[..., 0]]), order=1, mode="nearest")
