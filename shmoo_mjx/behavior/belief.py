"""Belief of the robot: the map, and pose and status of each detected object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
import shapely

from shmoo_mjx.arrays import Float
from shmoo_mjx.geometry.faces import corners_of, faces_of
from shmoo_mjx.learning.online import LearnerState
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.footprints import add_obstacles, footprint_polygon
from shmoo_mjx.planning.maps import OccupancyGrid, distance_field
from shmoo_mjx.types import Observation

_DISPLACED = 0.15
"""An object that stands this far from where it was left has been moved by somebody else [m]."""
_WIDER = 0.05
"""What paths keep more from an object for each time after the first that it stood in a path round it [m]: from afar a
gap may look wide enough that is not, and the robot would come back to it for ever."""
_LOST = 0.5
"""Age from which an object counts as not detected [s]: a camera misses frames, and now and then half a second."""


class Status(StrEnum):
    """Status of an object."""

    UNKNOWN = "unknown"
    """Seen, never touched: taken to be movable."""
    PARKED = "parked"
    """Pushed out of the way."""
    FIXED = "fixed"
    """Registered in the map as an obstacle: can't be moved, or can't be put anywhere."""


def all_faces(half_extents: tuple[float, float]) -> Float[np.ndarray, "8 4"]:
    """Sides and corners as faces to push on."""
    return np.concatenate([faces_of(half_extents), corners_of(half_extents)])


@dataclass(frozen=True, eq=False)
class ObjectBelief:
    """One object as perceived (pose and size) and as experienced (status, coefficients)."""

    pose: Float[np.ndarray, "3"]
    """In {W}."""
    half_extents: tuple[float, float]
    kind: str | None = None
    """What it looks like, "box", "cart" or "wheelchair"; None for none of them."""
    status: Status = Status.UNKNOWN
    pushes: int = 0
    """How often a push has been started."""
    adapt: LearnerState | None = None
    """What was learned from contact so far (`online.LearnerState`)."""
    age: float = 0.0
    """Time since the object was last detected [s]."""
    registered: Float[np.ndarray, "3"] | None = None
    """Pose at which it was registered or parked."""
    given_up: int | None = None
    """How many pushes of anything there had been when it was registered as an obstacle; None where it never was."""
    manipulable: bool | None = None
    """What the last decision has found; None before."""
    failed_faces: tuple[int, ...] = ()
    """Faces on which a push did not free the way, each as often as that was tried."""
    price: float | None = None
    """Expected time that it takes to push it out of the way, failures included [s]; None before that was looked at."""
    in_the_way: int = 0
    """How often it has stood in a path that was planned round it."""

    @property
    def faces(self) -> Float[np.ndarray, "8 4"]:
        """Sides and corners as faces to push on."""
        return all_faces(self.half_extents)

    @property
    def polygon(self) -> shapely.Polygon:
        """Footprint in {W}."""
        return footprint_polygon(self.pose, self.half_extents)

    @property
    def avoided(self) -> shapely.Polygon:
        """What paths lead round: the footprint, or a wider one."""
        return self.polygon.buffer(_WIDER * max(self.in_the_way - 1, 0))

    @property
    def displaced(self) -> bool:
        """Whether it stands elsewhere than where it was registered."""
        return self.registered is not None and _distance(self.pose, self.registered) > _DISPLACED


@dataclass(frozen=True, eq=False)
class Belief:
    """The map and the known objects; every change makes a new one."""

    grid: OccupancyGrid
    wall_clearance: DistanceField
    """Distance to the walls."""
    objects: Mapping[int, ObjectBelief] = field(default_factory=dict)

    def with_object(self, index: int, **changes: Any) -> Belief:
        """The belief with these fields of object ``index`` changed."""
        return replace(self, objects={**self.objects, index: replace(self.objects[index], **changes)})

    @property
    def pushes(self) -> int:
        """How many pushes there have been."""
        return sum(item.pushes for item in self.objects.values())

    def polygons(
        self, statuses: tuple[Status, ...] = tuple(Status), without: int | None = None
    ) -> list[shapely.Polygon]:
        """Footprints of the known objects with one of ``statuses``, except ``without``."""
        return [o.polygon for i, o in self.objects.items() if o.status in statuses and i != without]

    def clearance(self, without: int | None = None) -> DistanceField:
        """Distance to walls and to every known object but ``without``."""
        return add_obstacles(self.wall_clearance, self.polygons(without=without))

    def update(
        self,
        obs: Observation,
        sizes: Sequence[tuple[float, float]],
        *,
        pushed: int | None = None,
        first_status: Sequence[Status] | None = None,
        kinds: Sequence[str | None] | None = None,
    ) -> tuple[Belief, list[str]]:
        """Take in an observation: poses, sizes and kinds, as markers on an object's corners give them; never dynamics.

        Args:
            obs: one world; the pose of an object that was never detected is NaN.
            sizes: half extents of each object [m].
            pushed: the object that the robot itself is dealing with.
            first_status: what each object is taken to be at first sight; UNKNOWN if not given. Such a status stays.
            kinds: what each object looks like, see `ObjectBelief`.

        Returns:
            The new belief and what was noticed.
        """
        objects, notes = dict(self.objects), []
        for index, size in enumerate(sizes):
            pose = np.array(obs.object_pose[0, index])
            if not np.isfinite(pose).all():
                continue
            before, age = objects.get(index), float(obs.object_age[0, index])
            if before is None:
                status = Status.UNKNOWN if first_status is None else first_status[index]
                objects[index] = ObjectBelief(
                    pose, size, kinds[index] if kinds else None, status, age=age, registered=pose
                )
                continue
            objects[index], remarks = _perceived(
                before, pose, age, pushed=index == pushed, fixed_for_good=first_status is not None
            )
            notes += [f"object {index} {text}" for text in remarks]
        return replace(self, objects=objects), notes


def belief_of(grid: OccupancyGrid) -> Belief:
    """Belief with the map and no objects."""
    return Belief(grid, distance_field(grid))


def _perceived(
    before: ObjectBelief, pose: Float[np.ndarray, "3"], age: float, *, pushed: bool, fixed_for_good: bool
) -> tuple[ObjectBelief, list[str]]:
    new, notes = replace(before, pose=pose, age=age), []
    if before.age > _LOST >= age:
        notes.append(f"is detected again after {before.age:.1f} s")
    elif age > _LOST >= before.age and pushed:
        notes.append("is not detected; it is expected to move on as it did")
    if before.registered is None or (pushed and before.status is not Status.FIXED):
        if _distance(pose, before.pose) > _DISPLACED:
            notes.append("is suddenly elsewhere: somebody has moved it")
        return new, notes
    if not new.displaced or age > _LOST:
        return new, notes
    text = (
        f"({before.status}) stands {_distance(pose, before.registered):.2f} m from where it was: somebody has moved it"
    )
    new = replace(new, registered=pose, price=None)
    if before.status is Status.FIXED and not fixed_for_good:
        # Whoever moved it may have released its brakes: what was learned no longer holds.
        new = replace(new, status=Status.UNKNOWN, adapt=None, failed_faces=())
        text += "; it counts as unknown again"
    return new, [*notes, text]


def _distance(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> float:
    return float(np.linalg.norm(a[:2] - b[:2]))
