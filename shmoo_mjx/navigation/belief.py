"""What the robot knows of the world: the map, and of each object it has seen where it stands and what became of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
import shapely

from shmoo_mjx.learning.adaptation import AdaptState
from shmoo_mjx.navigation.footprints import add_obstacles, footprint_polygon
from shmoo_mjx.navigation.maps import ClearanceField, OccupancyGrid, clearance_field
from shmoo_mjx.types import DT, Observation

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
    twist: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """``[3]`` in {W}, when last perceived."""
    blind: float = 0.0
    """For how long its pose has been missing though it ought to be in sight [s]."""
    registered: np.ndarray | None = None
    """Pose at which it was registered or parked."""
    retried: bool = False
    """Has it been given another chance after its registration."""
    manipulable: bool | None = None
    """What the planning stage has found; None before."""
    failed_faces: set[int] = field(default_factory=set)
    """Faces from which it could not be moved."""

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
    first_status: Sequence[Status] | None = None
    """What each object is taken to be at first sight; UNKNOWN if not given."""
    foresight: float = 1.0
    """For how long a missing pose is carried on by the last twist; after that the object is taken to rest [s]."""
    displaced: float = 0.15
    """An object that stands this far from where it was left has been moved by somebody else [m]."""
    objects: dict[int, KnownObject] = field(default_factory=dict)
    events: list[tuple[float, str]] = field(default_factory=list)
    """(time [s], what happened): what the robot noticed without having done it."""

    def __post_init__(self) -> None:
        self.walls = clearance_field(self.grid)

    def update(self, seen: Observation, sizes: list[tuple[float, float]], pushed: int | None = None) -> Observation:
        """Take in what is in sight: poses and sizes, as markers on an object's corners give them; never dynamics.

        Args:
            seen: one world; a pose that was not detected is NaN.
            sizes: half extents of each object.
            pushed: the object that the robot itself is dealing with.

        Returns:
            The observation with missing poses of known objects filled in.
        """
        now = float(seen.time[0])
        for index, size in enumerate(sizes):
            pose = np.array(seen.object_pose[0, index])
            known = self.objects.get(index)
            if not np.isfinite(pose).all():
                self._expect(now, index, known)
            elif visible(seen, index, size, self.walls, self.sensing_range):
                if known is None:
                    status = Status.UNKNOWN if self.first_status is None else self.first_status[index]
                    known = self.objects[index] = KnownObject(pose, size, status, registered=pose)
                self._perceive(now, index, known, pose, np.array(seen.object_twist[0, index]), index == pushed)
        return self._filled(seen)

    def _expect(self, now: float, index: int, known: KnownObject | None) -> None:
        """An object whose marker was not found is taken to move on as it did."""
        if known is None:
            return
        if known.blind == 0.0:
            self.events.append((now, f"object {index} is not detected; it is expected to move on as it did"))
        known.blind += DT
        if known.blind > self.foresight:
            known.twist = np.zeros(3)
        known.pose = known.pose + DT * known.twist

    def _perceive(
        self, now: float, index: int, known: KnownObject, pose: np.ndarray, twist: np.ndarray, pushed: bool
    ) -> None:
        if known.blind > 0.0:
            self.events.append((now, f"object {index} is detected again after {known.blind:.1f} s"))
        jumped = float(np.linalg.norm(pose[:2] - known.pose[:2])) > self.displaced
        known.pose, known.twist, known.blind = pose, twist, 0.0
        if known.registered is None or (pushed and known.status is not Status.FIXED):
            if jumped:
                self.events.append((now, f"object {index} is suddenly elsewhere: somebody has moved it"))
            return
        offset = float(np.linalg.norm(pose[:2] - known.registered[:2]))
        if offset > self.displaced:
            self._moved_by_others(now, index, known, offset)

    def _moved_by_others(self, now: float, index: int, known: KnownObject, offset: float) -> None:
        text = f"object {index} ({known.status}) stands {offset:.2f} m from where it was: somebody has moved it"
        known.registered = known.pose
        if known.status is Status.FIXED and self.first_status is None:
            # Whoever moved it may have released its brakes: what was learned no longer holds.
            known.status, known.adapt, known.pushes = Status.UNKNOWN, None, 0
            known.failed_faces.clear()
            text += "; it counts as unknown again"
        self.events.append((now, text))

    def _filled(self, seen: Observation) -> Observation:
        missing = [i for i, known in self.objects.items() if known.blind > 0.0]
        if not missing:
            return seen
        poses, twists = np.array(seen.object_pose), np.array(seen.object_twist)
        for i in missing:
            poses[0, i], twists[0, i] = self.objects[i].pose, self.objects[i].twist
        return seen._replace(object_pose=poses, object_twist=twists)

    def polygons(
        self, statuses: tuple[Status, ...] = tuple(Status), without: int | None = None
    ) -> list[shapely.Polygon]:
        """Footprints of the known objects with one of ``statuses``, except ``without``."""
        return [o.polygon for i, o in self.objects.items() if o.status in statuses and i != without]

    def clearance(self, without: int | None = None) -> ClearanceField:
        """Distance to walls and to every known object but ``without``."""
        return add_obstacles(self.walls, self.polygons(without=without))
