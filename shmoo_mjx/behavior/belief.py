"""The robot's belief: the map, and pose and status of each detected object."""

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
"""Displacement from the registered pose above which somebody else must have moved an object [m]."""
_WIDER = 0.05
"""Increase of the margin around an object for each time after the first that it blocks a planned detour [m]. From afar
a gap may look wide enough although it is not, and without the margin the robot would return to it forever."""
_LOST = 0.5
"""Age of a detection from which an object counts as not detected [s]. A camera misses single frames, and sometimes half
a second."""


class Status(StrEnum):
    """Status of an object."""

    UNKNOWN = "unknown"
    """Detected but never touched; assumed to be movable."""
    PARKED = "parked"
    """Pushed out of the way."""
    FIXED = "fixed"
    """Registered in the map as an obstacle: it cannot be moved, or there is no place to move it to."""


def all_faces(half_extents: tuple[float, float]) -> Float[np.ndarray, "8 4"]:
    """Sides and corners as faces to push on."""
    return np.concatenate([faces_of(half_extents), corners_of(half_extents)])


@dataclass(frozen=True, eq=False)
class ObjectBelief:
    """Belief about one object: perceived pose and size, status, and learned dynamics."""

    pose: Float[np.ndarray, "3"]
    """Pose in {W}."""
    half_extents: tuple[float, float]
    """Half sizes of the footprint along {O} [m]."""
    kind: str | None = None
    """Recognised kind: "box", "cart" or "wheelchair"; None for other objects."""
    status: Status = Status.UNKNOWN
    """What the robot may do with it."""
    pushes: int = 0
    """Number of pushes started."""
    adapt: LearnerState | None = None
    """Learner state from the contact so far (`online.LearnerState`)."""
    age: float = 0.0
    """Time since the last detection [s]."""
    registered: Float[np.ndarray, "3"] | None = None
    """Pose at which the object was registered or parked."""
    given_up: int | None = None
    """Total number of pushes of all objects when it was registered as an obstacle; None if it never was."""
    manipulable: bool | None = None
    """Result of the last decision; None before the first."""
    failed_faces: tuple[int, ...] = ()
    """Faces on which a push did not free the path. A face occurs once per failed push."""
    push_errors: tuple[float, ...] = ()
    """Errors of the pushes towards a pose so far, in the units of `planning.search.ERROR`."""
    price: float | None = None
    """Expected time to push it out of the way, failures included [s]; None before the first evaluation."""
    in_the_way: int = 0
    """Number of times that it blocked a path planned around it."""

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
        """Region that paths avoid: the footprint, or a larger one."""
        return self.polygon.buffer(_WIDER * max(self.in_the_way - 1, 0))

    @property
    def displaced(self) -> bool:
        """Whether it is away from its registered pose."""
        return self.registered is not None and _distance(self.pose, self.registered) > _DISPLACED


@dataclass(frozen=True, eq=False)
class Belief:
    """The map and the known objects. It is immutable; every change makes a new one."""

    grid: OccupancyGrid
    """The map."""
    wall_clearance: DistanceField
    """Distance to the walls."""
    objects: Mapping[int, ObjectBelief] = field(default_factory=dict)
    """The known objects by index."""

    def with_object(self, index: int, **changes: Any) -> Belief:
        """The belief with these fields of object ``index`` changed."""
        return replace(self, objects={**self.objects, index: replace(self.objects[index], **changes)})

    @property
    def pushes(self) -> int:
        """Total number of pushes so far."""
        return sum(item.pushes for item in self.objects.values())

    def polygons(
        self, statuses: tuple[Status, ...] = tuple(Status), without: int | None = None
    ) -> list[shapely.Polygon]:
        """Footprints of the known objects with one of ``statuses``, except ``without``."""
        return [o.polygon for i, o in self.objects.items() if o.status in statuses and i != without]

    def clearance(self, without: int | None = None) -> DistanceField:
        """Distance to walls and to every known object except ``without``."""
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
        """Updates poses, sizes and kinds from an observation.

        Markers on an object's corners provide them. An observation does not contain dynamics.

        Args:
            obs: observation of one world; the pose of an object that was never detected is NaN.
            sizes: half extents of each object [m].
            pushed: index of the object that the robot is pushing.
            first_status: initial status of each object; UNKNOWN if not given. If given, the status FIXED is permanent.
            kinds: recognised kind of each object, see `ObjectBelief`.

        Returns:
            The new belief and notes on noticed changes.
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
        # The person who moved it may have released its brakes, so the learned dynamics no longer hold.
        new = replace(new, status=Status.UNKNOWN, adapt=None, failed_faces=())
        text += "; it counts as unknown again"
    return new, [*notes, text]


def _distance(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> float:
    return float(np.linalg.norm(a[:2] - b[:2]))
