"""Sequences of goals in one world, for the lifelong form of the navigation experiment."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import shapely

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.scenarios import Generated, Kind, ScenarioConfig, Truth, draw_scenario, largest_room
from shmoo_mjx.navigation.footprints import footprint_polygon
from shmoo_mjx.navigation.maps import ClearanceField, OccupancyGrid, clearance_field
from shmoo_mjx.navigation.paths import Path, path_blocked_by, plan_path
from shmoo_mjx.navigation.scenario import ROBOT_RADIUS, Limits

__all__ = ["GoalSequence", "draw_sequence"]

_TRIES = 60
"""Draws of each further goal."""


class GoalSequence(NamedTuple):
    """A world and the goals that the robot is given in it, one after the other."""

    generated: Generated
    """The world, and the first goal."""
    goals: tuple[tuple[float, float], ...]
    """The first one included."""
    shortest: tuple[float, ...]
    """Length of the path to each goal past no object, from the goal before [m]."""


def draw_sequence(
    grid: OccupancyGrid,
    kind: Kind,
    rng: np.random.Generator,
    first_seed: int,
    count: int,
    truth: Truth,
    cfg: ScenarioConfig,
) -> GoalSequence:
    """Draw a scenario of ``kind`` and further goals in it.

    Each goal can be reached from the one before if those objects are gone that stand in the way and can be moved. Every
    second path leads through an object where it stood at first, if such a goal is found: what the robot has learned of
    that object, or done to it, is of use then. What its own pushes have blocked meanwhile is its own affair.

    The first leg is of ``kind``, as `draw_scenario` draws it; the time limit of ``cfg`` is that of each goal.

    Raises:
        ShmooError: the map has no place for such a sequence.
    """
    found = draw_scenario(grid, kind, rng, first_seed, truth, cfg)
    walls = clearance_field(grid)
    goals, shortest = [found.scenario.goal], [found.shortest]
    while len(goals) < count:
        leg = _next_leg(grid, walls, found, goals[-1], len(goals) % 2 == 1, rng, cfg)
        if leg is None:
            raise ShmooError(f"{grid.source or 'the map'}: no {count} goals in a row were found; give another map.")
        goals.append((round(float(leg.points[-1][0]), 3), round(float(leg.points[-1][1]), 3)))
        shortest.append(leg.length)
    limits = Limits(time_s=cfg.time_s * count)
    scenario = found.scenario.model_copy(update={"limits": limits})
    return GoalSequence(found._replace(scenario=scenario), tuple(goals), tuple(shortest))


def _next_leg(
    grid: OccupancyGrid,
    walls: ClearanceField,
    found: Generated,
    start: tuple[float, float],
    blocked: bool,
    rng: np.random.Generator,
    cfg: ScenarioConfig,
) -> Path | None:
    """The path past no object to a goal in reach, if possible one that an object has ``blocked`` or has not."""
    shapes = [_shape(entry) for entry in found.scenario.objects]
    gone = [movable and in_the_way for movable, in_the_way in zip(found.movable, found.blocking, strict=True)]
    staying = [shape for shape, is_gone in zip(shapes, gone, strict=True) if not is_gone]
    centres = grid.cell_to_world(largest_room(np.asarray(walls.values), cfg.start_clearance))
    distance = np.linalg.norm(centres - np.asarray(start), axis=1)
    clear = shapely.distance(shapely.MultiPolygon(shapes), shapely.points(centres)) > ROBOT_RADIUS + 0.15
    near = rng.permutation(np.flatnonzero((distance > 0.6 * cfg.path[0]) & (distance < cfg.path[1]) & clear))
    other = None
    for index in near[:_TRIES]:
        path = plan_path(grid, start, centres[index], robot_radius=ROBOT_RADIUS, field=walls)
        if path is None or not cfg.path[0] <= path.length <= cfg.path[1]:
            continue
        through = any(path_blocked_by(path, shape, ROBOT_RADIUS)[0] for shape in shapes)
        if through != blocked and other is not None:
            continue
        if plan_path(grid, start, centres[index], staying, ROBOT_RADIUS, field=walls) is None:
            continue
        if through == blocked:
            return path
        other = path
    return other


def _shape(entry: Any) -> shapely.Polygon:
    half = entry.condition().half_extents
    return footprint_polygon(entry.pose, half)
