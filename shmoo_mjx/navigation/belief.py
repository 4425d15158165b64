"""What the robot knows of the world: the map, and of each object it has seen where it stands and what became of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
import shapely

from shmoo_mjx.learning.adaptation import AdaptState
from shmoo_mjx.navigation.footprints import add_obstacles, footprint_polygon
from shmoo_mjx.navigation.maps import ClearanceField, OccupancyGrid, clearance_field
from shmoo_mjx.types import Observation

__all__ = ["Belief", "KnownObject", "Status", "visible"]

Array = Any


class Status(StrEnum):
    """What became of an object so far."""

    UNKNOWN = "unknown"
    """Seen, never touched: taken to be movable."""
    PARKED = "parked"
    """Pushed out of the way."""
    FIXED = "fixed"
    """Registered in the map as an obstacle: can't be moved, or can't be put anywhere."""


@dataclass
class KnownObject:
    """One object as perceived (pose and size) and as experienced (status, coefficients)."""

    pose: np.ndarray
    half_extents: tuple[float, float]
    status: Status = Status.UNKNOWN
    pushes: int = 0
    """How often a push has been started."""
    adapt: AdaptState | None = None
    """Coefficients learned from contact so far."""

    @property
    def polygon(self) -> shapely.Polygon:
        """Footprint in {W}."""
        return footprint_polygon(self.pose, self.half_extents)


def visible(
    seen: Observation, index: int, half_extents: tuple[float, float], walls: ClearanceField, reach: float
) -> bool:
    """Whether object ``index`` is within ``reach`` metres and some corner of it is in line of sight over the map."""
    robot = seen.robot_pose[0, :2]
    corners = np.asarray(footprint_polygon(seen.object_pose[0, index], half_extents).exterior.coords)[:4]
    targets = corners + 0.1 * (seen.object_pose[0, index, :2] - corners)
    near = np.linalg.norm(targets - robot, axis=1) <= reach
    fractions = np.linspace(0.05, 0.95, 60)[:, None, None]
    clear = walls.at(robot + fractions * (targets - robot)) > 0.3 * float(walls.resolution)
    return bool(np.any(near & clear.all(axis=0)))


@dataclass
class Belief:
    """The map and the known objects."""

    grid: OccupancyGrid
    sensing_range: float = 3.5
    """How far objects are perceived [m]."""
    objects: dict[int, KnownObject] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.walls = clearance_field(self.grid)

    def update(self, seen: Observation, sizes: list[tuple[float, float]]) -> None:
        """Take in what is in sight: poses and sizes, as markers on an object's corners give them; never dynamics."""
        for index, size in enumerate(sizes):
            if visible(seen, index, size, self.walls, self.sensing_range):
                pose = np.array(seen.object_pose[0, index])
                if index in self.objects:
                    self.objects[index].pose = pose
                else:
                    self.objects[index] = KnownObject(pose, size)

    def polygons(
        self, statuses: tuple[Status, ...] = tuple(Status), without: int | None = None
    ) -> list[shapely.Polygon]:
        """Footprints of the known objects with one of ``statuses``, except ``without``."""
        return [o.polygon for i, o in self.objects.items() if o.status in statuses and i != without]

    def clearance(self, without: int | None = None) -> ClearanceField:
        """Distance to walls and to every known object but ``without``."""
        return add_obstacles(self.walls, self.polygons(without=without))
