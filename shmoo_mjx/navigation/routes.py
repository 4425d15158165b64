"""Ways through the world as it is known: to the goal, to an object's face, past an object that is moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely

from shmoo_mjx.faces import stand_off
from shmoo_mjx.hands import REACH, TUCKED_REACH
from shmoo_mjx.navigation.belief import Belief, KnownObject, Status
from shmoo_mjx.navigation.footprints import footprint_polygon, footprints_free
from shmoo_mjx.navigation.maps import ClearanceField
from shmoo_mjx.navigation.paths import Path, plan_path
from shmoo_mjx.plant import outline

if TYPE_CHECKING:
    from shmoo_mjx.navigation.records import NavigatorConfig

__all__ = ["Routes"]

_REACHING_ROOM = 0.02
"""Distance from walls and other objects that body, arms and hands keep from the stand-off pose to contact [m]."""
_OFF_WALLS = 0.15
"""Largest speed away from a wall [m/s]: a faster robot would swing from one side of a doorway to the other."""
_PASSING = 0.3
"""A pushed object is out of the way once passing it makes the path at most this much longer [m]."""
_PATH_MARGIN = 0.05
"""What must be free beside the robot's radius between the path and a pushed object [m]."""
_WALL_MARGIN = 0.05
"""What must be free between walls and a pushed object's goal [m]."""
_OTHER_PATHS = 12
"""Goals for which another path is sought when none leaves the path free."""

_WIDER_GAPS = (0.2, 0.3, 0.4)
"""Distances between hands and face from which contact is sought where a wall leaves no room nearer by [m]."""


@dataclass(frozen=True)
class Routes:
    """Questions about ways. All ``position [2]`` are the robot's, in {W} [m]."""

    belief: Belief
    goal: np.ndarray
    """``[2]`` in {W} [m]."""
    config: NavigatorConfig

    def path_clear(self, position: np.ndarray, known: KnownObject) -> bool:
        """Whether the way on passes the object where it stands, little longer than without it."""
        path = self.free_path(position, known)
        around = self.free_path(position, known, known.polygon.buffer(_PATH_MARGIN))
        return path is not None and around is not None and around.length < path.length + _PASSING

    def free_path(
        self, position: np.ndarray, known: KnownObject, instead: shapely.Polygon | None = None
    ) -> Path | None:
        """The way on as if ``known`` were not there, or stood where ``instead`` is."""
        others = [o.polygon for o in self.belief.objects.values() if o is not known and o.status is not Status.UNKNOWN]
        return self.plan(position, others if instead is None else [*others, instead])

    def collision_free(
        self, position: np.ndarray, known: KnownObject, around: ClearanceField, path: Path | None
    ) -> Callable[[np.ndarray], np.ndarray]:
        """CollisionCheck(M, P, g): the footprint clear of walls, other objects and the path P, as if it were not there.

        Where no pose leaves the path free, poses that leave room for another path, little longer, are taken (Reading:
        the path P was planned before anybody knew where the object would go).
        """
        half = np.array(known.half_extents)
        clearance = self.config.robot_radius + _PATH_MARGIN

        def check(poses: np.ndarray) -> np.ndarray:
            off_walls = footprints_free(around, poses, half, wall_clearance=_WALL_MARGIN)
            if path is None or not off_walls.any():
                return off_walls
            candidates = np.flatnonzero(off_walls)
            off_path = np.zeros(len(poses), dtype=bool)
            off_path[candidates] = footprints_free(around, poses[candidates], half, path.points, clearance)
            if off_path.any():
                return off_path
            nearest = np.argsort(np.linalg.norm(poses[candidates, :2] - known.pose[:2], axis=1))
            for i in candidates[nearest][:: max(1, len(nearest) // _OTHER_PATHS)]:
                other = self.free_path(position, known, footprint_polygon(poses[i], half).buffer(_PATH_MARGIN))
                off_path[i] = other is not None and other.length < path.length + self.config.detour
            return off_path

        return check

    def way_to(
        self, position: np.ndarray, index: int, face: np.ndarray, clearance: ClearanceField
    ) -> tuple[Path, float] | None:
        """Way to the nearest stand-off pose at ``face [4]`` of object ``index`` where the robot has room, and that
        pose's gap [m]; None if there is no room or no way. ``clearance`` is that of everything known."""
        known, obstacles = self.belief.objects[index], self.belief.polygons()
        others = self.belief.clearance(without=index)
        for gap in (self.config.skills.contact_gap, *_WIDER_GAPS):
            wanted = stand_off(known.pose, face, gap)
            creeping = np.stack([stand_off(known.pose, face, g) for g in np.linspace(gap, 0.0, 4)])
            room = outline.room(others.at, creeping, (TUCKED_REACH, REACH)).least
            if float(clearance.at(wanted[:2])) >= self.config.robot_radius and float(np.min(room)) >= _REACHING_ROOM:
                path = self._path(position, wanted[:2], obstacles)
                return None if path is None else (path, gap)
        return None

    def plan(self, position: np.ndarray, obstacles: list[shapely.Polygon]) -> Path | None:
        """The path to the goal clear of walls and of ``obstacles``."""
        return self._path(position, self.goal, obstacles)

    def _path(self, start: np.ndarray, end: np.ndarray, obstacles: list[shapely.Polygon]) -> Path | None:
        radius = self.config.robot_radius
        return plan_path(self.belief.grid, start, end, obstacles, radius, field=self.belief.walls)

    def off_walls(self, position: np.ndarray) -> np.ndarray:
        """Velocity ``[2]`` in {W} [m/s] away from a wall that is too near to back past; zero elsewhere."""
        step = 0.05 * np.eye(2)
        walls = self.belief.walls
        slope = (walls.at(position + step) - walls.at(position - step)) / 0.1
        depth = max(self.config.robot_radius + 0.04 - float(walls.at(position)), 0.0)
        return min(2.5 * depth, _OFF_WALLS) * slope
