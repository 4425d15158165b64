"""Path queries on the belief: to the goal, to an object's face, and past a moved object."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely

from shmoo_mjx.arrays import Array, Bool, Float
from shmoo_mjx.behavior.belief import Belief, ObjectBelief, Status
from shmoo_mjx.behavior.skills.approach import CONTACT_GAP
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import stand_off
from shmoo_mjx.geometry.hands import REACH, TUCKED_REACH
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.footprints import footprint_polygon, footprints_free
from shmoo_mjx.planning.paths import Path, path_blocked_by, plan_path
from shmoo_mjx.planning.scenario import ROBOT_RADIUS
from shmoo_mjx.plant import outline
from shmoo_mjx.plant.robot import shmoobot

PACE = 0.45
"""Driving speed [m/s] for expected times."""
PUSH = 20.0
"""Assumed time to push aside an object that has not been evaluated [s]."""
SLACK = 0.03
"""Distance by which an object may be closer to the path than the robot's radius without blocking it [m]."""
_REACHING_ROOM = (0.06, 0.01)
"""Distance from walls and other objects that body, arms and hands keep between the stand-off pose and contact [m]: the
preferred value, and the value used if the preferred one allows no path."""
_BACK_ROOM = ROBOT_RADIUS + 0.12
"""Preferred distance from everything at the end of a retreat [m]."""
_BACK_ANGLES = np.deg2rad([0, -20, 20, -40, 40, -60, 60])
"""Directions of a retreat relative to straight away from the object [rad]."""
_BACK_LENGTHS = np.array([0.2, 0.3, 0.4, 0.55, 0.7])
"""Lengths of a retreat [m]."""
PATH_MARGIN = 0.05
"""Required distance between the path and a pushed object, in addition to the robot's radius [m]."""
_WALL_MARGIN = 0.05
"""Required distance between walls and a pushed object's goal [m]."""
_OTHER_DETOUR = 1.5
"""Maximum extra length of another path, compared with the current one [m]."""
_OTHER_PATHS = 12
"""Number of goals for which another path is planned if no goal leaves the current path free."""

_ASIDE = (0.0, 0.1, -0.1, 0.2, -0.2)
"""Lateral offsets along a face at which contact is tried, in this order [m]. At least one hand touches the face.
Offsets other than zero require the larger `_REACHING_ROOM`."""
_BESIDE_CORNER = (0.0, 0.05, -0.05)
"""The same for a corner [m]. With larger offsets one hand misses the object when the other touches it."""
_BEGINS = (0, 3, 4)
"""Index of the offset to try first: the middle, after one failure one end, after another failure the other end. If the
middle always came first, 2 of 5 doorways that a second push opens would stay closed, and none of 5 others would open.
"""
_WIDER_GAPS = (0.2, 0.3, 0.4)
"""Larger distances between hands and face from which contact is tried if a wall is too close [m]."""


class Route(NamedTuple):
    """A route to the goal."""

    path: Path
    """The path to the goal."""
    seconds: float
    """Expected time [s], including the time to push aside objects in the path."""


@dataclass(frozen=True)
class Routes:
    """Path queries. ``position`` is always the robot's, in {W} [m]."""

    belief: Belief
    """The belief that is queried."""
    goal: Float[np.ndarray, "2"]
    """Goal position in {W} [m]."""
    pushed: tuple[Status, ...] = (Status.UNKNOWN, Status.PARKED)
    """Statuses of objects that may be pushed aside. Paths avoid all other objects."""
    price: float | None = None
    """Expected time to push aside any object [s]; None to use each object's own."""

    def quickest(
        self, position: Float[Array, "2"], round_it: Mapping[int, float] | None = None, without: int | None = None
    ) -> Route | None:
        """The route to the goal with the least expected time. It avoids some objects and passes through others.

        Best-first search over sets of objects to avoid: each step adds one blocking object, and the sets with the
        lowest bound on the time come first.

        Args:
            position: position of the robot.
            round_it: objects that must not be pushed aside, with the margin to keep from them [m].
            without: index of an object to ignore.
        """
        objects, round_it = self.belief.objects, round_it or {}
        there = {i: o for i, o in objects.items() if i != without}
        soft = {i: o for i, o in there.items() if o.status in self.pushed and i not in round_it}
        hard = [o.avoided.buffer(round_it.get(i, 0.0)) for i, o in there.items() if i not in soft]
        best: Route | None = None
        waiting, met = [(0.0, 0, frozenset[int]())], 0
        while waiting and (best is None or waiting[0][0] < best.seconds):
            _, _, kept_from = heapq.heappop(waiting)
            path = self.plan(position, [*hard, *(soft[i].avoided for i in kept_from)])
            if path is None:
                continue
            walk, near = path.length / PACE, ROBOT_RADIUS - SLACK
            through = [i for i in soft.keys() - kept_from if path_blocked_by(path, soft[i].polygon, near)[0]]
            seconds = walk + sum(self._price(soft[i]) for i in through)
            best = Route(path, seconds) if best is None or seconds < best.seconds else best
            for i in through:
                met += 1
                if all(kept_from | {i} != other for _, _, other in waiting):
                    heapq.heappush(waiting, (walk, met, kept_from | {i}))
        return best

    def _price(self, item: ObjectBelief) -> float:
        own = PUSH if item.price is None else item.price
        return own if self.price is None else self.price

    def free_path(
        self, position: Float[Array, "2"], target: ObjectBelief, instead: shapely.Polygon | None = None
    ) -> Path | None:
        """The path to the goal without ``target``, or with ``instead`` in its place."""
        others = [o.polygon for o in self.belief.objects.values() if o is not target and o.status is not Status.UNKNOWN]
        return self.plan(position, others if instead is None else [*others, instead])

    def collision_free(
        self, position: Float[Array, "2"], target: ObjectBelief, clearance: DistanceField, path: Path | None
    ) -> Callable[[Float[np.ndarray, "P 3"]], Bool[np.ndarray, "P"]]:
        """CollisionCheck(M, P, g): whether the footprint is clear of walls, other objects and the path P.

        If no pose leaves P free, poses are accepted that leave room for another, slightly longer path. This is a
        deviation from the paper, because P is planned before the object's goal is known.
        """
        half = np.array(target.half_extents)
        path_clearance = ROBOT_RADIUS + PATH_MARGIN

        def check(poses: Float[np.ndarray, "P 3"]) -> Bool[np.ndarray, "P"]:
            off_walls = footprints_free(clearance, poses, half, wall_clearance=_WALL_MARGIN)
            if path is None or not off_walls.any():
                return off_walls
            candidates = np.flatnonzero(off_walls)
            off_path = np.zeros(len(poses), dtype=bool)
            off_path[candidates] = footprints_free(
                clearance, poses[candidates], half, path.points, path_clearance=path_clearance
            )
            if off_path.any():
                return off_path
            nearest = np.argsort(np.linalg.norm(poses[candidates, :2] - target.pose[:2], axis=1))
            for i in candidates[nearest][:: max(1, len(nearest) // _OTHER_PATHS)]:
                other = self.free_path(position, target, footprint_polygon(poses[i], half).buffer(PATH_MARGIN))
                off_path[i] = other is not None and other.length < path.length + _OTHER_DETOUR
            return off_path

        return check

    def path_to_face(
        self,
        position: Float[Array, "2"],
        index: int,
        face: Float[np.ndarray, "4"],
        clearance: DistanceField,
        *,
        failed: int = 0,
        corner: bool = False,
    ) -> tuple[Path, float, float] | None:
        """Path to the nearest stand-off pose at a face where the robot has room.

        Places beside the middle of the face are tried only if there is no room at the middle, or after failed pushes: a
        push at its end turns an object that is jammed against a wall. Places at a corner are all near its middle.

        Args:
            position: position of the robot.
            index: index of the object.
            face: the face to push on.
            clearance: distance to everything known.
            failed: number of failed pushes on this face.
            corner: whether the face is a corner.

        Returns:
            The path, and the pose's gap and lateral offset along the face [m]; None if there is no room or no path.
        """
        target, obstacles = self.belief.objects[index], self.belief.polygons()
        others = self.belief.clearance(without=index)
        for reserve, lateral, gap in _stand_off_places(failed, corner):
            wanted = stand_off(target.pose, face, gap, lateral)
            forward = np.stack([stand_off(target.pose, face, g, lateral) for g in np.linspace(gap, 0.0, 4)])
            room = outline.room(others.at, forward, (TUCKED_REACH, REACH)).least
            if float(clearance.at(wanted[:2])) >= ROBOT_RADIUS and float(np.min(room)) >= reserve:
                path = self._path(position, wanted[:2], obstacles)
                return None if path is None else (path, gap, lateral)
        return None

    def plan(self, position: Float[Array, "2"], obstacles: list[shapely.Polygon]) -> Path | None:
        """The path to the goal that avoids walls and ``obstacles``."""
        return self._path(position, self.goal, obstacles)

    def _path(self, start: Float[Array, "2"], end: Float[Array, "2"], obstacles: list[shapely.Polygon]) -> Path | None:
        radius = ROBOT_RADIUS
        return plan_path(
            self.belief.grid, start, end, obstacles, robot_radius=radius, wall_clearance=self.belief.wall_clearance
        )

    def retreat_path(self, position: Float[Array, "2"], object_pose: Float[np.ndarray, "3"]) -> Path | None:
        """A short path away from a touched object to a place where the robot can turn and fold its arms.

        None if moving straight back suffices, or if there is no such place nearby.
        """
        away = np.arctan2(*(position - object_pose[:2])[::-1])
        angles, lengths = (grid.ravel() for grid in np.meshgrid(away + _BACK_ANGLES, _BACK_LENGTHS, indexing="ij"))
        ends = position + lengths[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        room = np.asarray(self.belief.clearance().at(ends))
        # Prefers the shortest path with enough room, and straight over oblique. If none has room, the one with most
        # room.
        cost = lengths + 0.15 * np.abs(se2.wrap(angles - away)) + 5.0 * np.maximum(_BACK_ROOM - room, 0.0)
        best = int(np.argmin(cost))
        if room[best] < shmoobot().radius or best == 0:
            return None
        return Path(np.stack([position, ends[best]]), float(lengths[best]))


def _stand_off_places(failed: int, corner: bool) -> Iterator[tuple[float, float, float]]:
    """Candidates (room to keep, lateral offset along the face, gap) for contact [m], in the order of preference."""
    gaps, (roomy, tight), first = (CONTACT_GAP, *_WIDER_GAPS), _REACHING_ROOM, _BEGINS[failed % len(_BEGINS)]
    if corner:
        return itertools.product((roomy, tight), _BESIDE_CORNER, gaps)
    aside = (*_ASIDE[first:], *_ASIDE[:first])
    return itertools.chain(itertools.product((roomy,), aside, gaps), itertools.product((tight,), (0.0,), gaps))
