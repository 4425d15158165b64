"""ShmooNavigate: drive through the demo's three rooms, with a movable box and a locked, immovable wheelchair."""

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
"""Number of objects: the demo's box and wheelchair."""
_RAYS = 32
_FAR = 1e6


@dataclass(frozen=True)
class NavigateConfig:
    """Configuration of the navigation task, SI units."""

    reach: float = 3.5
    """Largest range measurement [m]. Larger values also widen the observation space."""
    arrived: float = 0.25
    """Largest distance from the goal for success [m]."""
    slow: float = 0.1
    """Largest speed of the robot for success [m/s]."""
    lookahead: float = 0.4
    """Distance ahead at which the direction of the path is evaluated [m]."""
    fall: float = -1.0
    """Reward of a fall."""
    bonus: float = 1.0
    """Reward of success."""
    bump: float = -0.05
    """Reward of 0.1 s in contact with a wall."""


class Rooms(NamedTuple):
    """Goals, objects and walls of W worlds with N objects and K walls."""

    goal: np.ndarray
    """Goal positions of the robots in {W} [m], ``[W, 2]``."""
    half_extents: np.ndarray
    """Half extents of the objects' footprints [m], ``[W, N, 2]``."""
    wall_pose: np.ndarray
    """Poses of the walls in {W} [m, rad], ``[W, K, 3]``."""
    wall_half: np.ndarray
    """Half extents of the walls [m], ``[W, K, 2]``."""
    way: np.ndarray
    """Path length from each map cell to the goal [m], ``[W, rows, columns]``."""


def _object_parts(i: int) -> tuple[Part, ...]:
    return (
        Part(f"object{i}_seen", 1, 0.0, 1.0, "1", "1 if the object is detected; otherwise its other values are 0"),
        Part(f"object{i}", 4, -10.0, 10.0, "m, 1", "its x, y, and cos and sin of its yaw"),
        Part(f"object{i}_twist", 3, -10.0, 10.0, "m/s, rad/s", "its velocity (x, y) and yaw rate"),
        Part(
            f"object{i}_wrench",
            3,
            -500.0,
            500.0,
            "N, N m",
            "wrench of the hands on the object about its centre, mean over 0.1 s",
        ),
        Part(f"object{i}_half_extents", 2, 0.0, 2.0, "m", "half its length and half its width"),
    )


class NavigateTask:
    """Navigation task. The robot knows the map but not the objects, which it must detect."""

    observation: tuple[Part, ...] = (
        *BODY,
        Part("goal", 2, -20.0, 20.0, "m", "the goal's x and y"),
        Part("way", 3, -1.0, 40.0, "m, 1", "length of the way to the goal on the map; cos and sin of its direction"),
        Part("ranges", _RAYS, 0.0, 3.5, "m", "distance to walls and known objects, every 11.25 deg to the left"),
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
        """Draw a floor plan with objects like ``shmoo demo``; for the same world, return the same start again."""
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
        """Batch goals, footprints, walls and path lengths. Zero-size walls far away pad worlds with fewer walls."""
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
        """Low-level command; the last action folds and extends the arms."""
        return command(actions, observed, actions[:, 4])

    def observe(self, context: Rooms, observed: Observation) -> np.ndarray:
        """Observations ``[W, n]``; ``observation`` lists the parts."""
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
        """Outcome. The potential is minus the path length to the goal on the map, without regard to objects."""
        position = true.robot_pose[:, :2]
        distance = np.linalg.norm(position - context.goal, axis=-1)
        slow = np.linalg.norm(true.robot_twist[:, :2], axis=-1) < self.config.slow
        way = _look_up(context.way, position[:, None])[:, 0]
        return Outcome(-way, distance, (distance < self.config.arrived) & slow)

    def _way(self, context: Rooms, observed: Observation) -> np.ndarray:
        """Path length, and direction in {R} of the point around the robot with the shortest path, ``[W, 3]``."""
        points = observed.robot_pose[:, None, :2] + self.config.lookahead * self._rays
        best = np.argmin(_look_up(context.way, points), axis=1)
        here = _look_up(context.way, observed.robot_pose[:, None, :2])
        return np.concatenate([here, se2.rotate(self._rays[best], -observed.robot_pose[:, 2])], axis=-1)


def _way_to(grid: OccupancyGrid, goal: np.ndarray) -> np.ndarray:
    """Length of the robot's shortest path from each cell to the goal [m], ``[H, W]``.

    Cells that the robot can't reach get the length of the nearest reachable cell plus the distance to it.
    """
    length = cost_to_go(grid, goal, robot_radius=ROBOT_RADIUS, cfg=PathConfig(soft_weight=0.0))
    away, (rows, columns) = distance_transform_edt(~np.isfinite(length), return_indices=True)
    return length[rows, columns] + away * grid.resolution


def _look_up(way: np.ndarray, points: Array) -> np.ndarray:
    """Bilinear interpolation ``[W, P]`` at ``points [W, P, 2]`` in {W}; the map's origin is its lower-left corner."""
    cells = points / RESOLUTION - 0.5
    world = np.broadcast_to(np.arange(len(way))[:, None], cells.shape[:2])
    return map_coordinates(way, np.stack([world, cells[..., 1], cells[..., 0]]), order=1, mode="nearest")
