"""The scenario file: the map, start and goal of the robot, and the objects that the map does not show.

map: office.yaml          # ROS map_server YAML, relative to this file; optional if the command line gives it
start: [1.0, 1.0, 0.0]    # x, y [m], yaw [rad] in {W}
goal: [5.0, 2.0]          # x, y [m] in {W}; or push_to: [x, y, yaw], a pose for the first object
objects:
  - family: box           # box, cart or wheelchair
    pose: [3.0, 1.5, 0.2]
    seed: 4               # seed of the properties that are not given
    properties: {mass: 3.0}
seed: 0
limits: {time_s: 180}
senses: real              # or perfect
"""

from __future__ import annotations

import math
import os
import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, field_validator, model_validator

from shmoo_mjx.arrays import Array
from shmoo_mjx.base.files import write_whole
from shmoo_mjx.base.options import SENSES, SensesName
from shmoo_mjx.base.schema import Angle, Number, WholeNumber, validated
from shmoo_mjx.base.yaml_input import read_mapping, yaml_text
from shmoo_mjx.errors import ShmooError

if TYPE_CHECKING:
    from shmoo_mjx.planning.maps import OccupancyGrid
    from shmoo_mjx.plant.condition import Condition

FAMILIES = ("box", "cart", "wheelchair")
ROBOT_RADIUS = 0.29
"""Radius of the disc that paths keep clear [m]. It contains the body, the folded hands and a margin."""
MOST_OBJECTS = 50
"""Maximum number of objects in a scene; each one adds a body to the simulation."""
Pose = tuple[Number, Number, Angle]
Property = bool | FiniteFloat

_OVERLAP = 1e-4
"""Maximum overlap of two footprints that counts as touching [m^2]."""
_DEPTH = 0.005
"""Maximum depth of a footprint in a wall [m]. It allows for poses that are rounded in the file."""
_NEVER_NEGATIVE = ("size", "mass", "payload", "friction", "rolling", "swivel_friction")
"""Properties that must not be negative. The plant checks names and ranges."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ObjectEntry(_Strict):
    """An object of a scenario."""

    family: str
    """One of FAMILIES, or an object file (*.json) made by ``shmoo object add``."""
    pose: Pose
    """Pose (x, y, yaw) of the object's centre in {W} [m, m, rad]."""
    seed: WholeNumber = Field(default=0, ge=0)
    """Seed of the properties that are not given. If a mass but no load is given, the load is zero."""
    properties: dict[str, Property | list[Property]] = Field(default_factory=dict)
    """Given properties in SI units, by name."""

    def condition(self) -> Condition:
        """The object with all its properties.

        Raises:
            ShmooError: a property is unknown or out of range for the family.
        """
        from shmoo_mjx.plant.objects import draw_condition

        # A given mass means the total mass, so the seed must not add a load to it.
        load = {"payload": 0.0} if "mass" in self.properties else {}
        return draw_condition(self.family, self.seed, load | self.properties)

    @field_validator("family", mode="before")
    @classmethod
    def _known_family(cls, value: object) -> object:
        if value not in FAMILIES and not str(value).endswith(".json"):
            names = ", ".join(repr(name) for name in FAMILIES)
            raise ValueError(
                f"is {reprlib.repr(value)}, no object family; choose one of {names} or an object file (*.json)."
            )
        return value

    @field_validator("properties", mode="before")
    @classmethod
    def _numbers_that_make_sense(cls, value: object) -> object:
        if not isinstance(value, dict):
            raise ValueError(f"is {reprlib.repr(value)}; give a mapping such as {{mass: 3.0}}.")
        for name, entry in value.items():
            for number in entry if isinstance(entry, list | tuple) else [entry]:
                if not isinstance(number, int | float) or not math.isfinite(number):
                    raise ValueError(
                        f"gives {name} = {number!r}; give a finite number, true, false or a list such as [0.5,0.5,0.6]."
                    )
                if isinstance(number, bool) and name != "locked":
                    raise ValueError(f"gives {name} = {str(number).lower()}; give a number.")
                if number < 0 and name in _NEVER_NEGATIVE:
                    raise ValueError(f"gives {name} = {number:g}, which must not be negative; give a positive number.")
        return value


class Limits(_Strict):
    """Limits at which a run ends, and the tolerance of its goal."""

    time_s: Number = Field(default=180.0, ge=0.1, le=86_400)
    """Maximum simulated time [s]."""
    goal_tolerance_m: Number = Field(default=0.25, ge=0.05)
    """Maximum distance from the goal that counts as reached [m]."""


class Scenario(_Strict):
    """Content of a scenario file: everything that defines a run, except for the cells of the map."""

    map: str | None = None
    """Path of the map's YAML file; None if the caller provides the map."""
    start: Pose
    """Start pose (x, y, yaw) of the robot in {W} [m, m, rad]."""
    goal: tuple[Number, Number]
    """Goal position (x, y) of the robot in {W} [m]; with ``push_to``, the position of that pose."""
    push_to: Pose | None = None
    """Goal pose (x, y, yaw) of the first object in {W} [m, m, rad], in place of a goal for the robot."""
    objects: tuple[ObjectEntry, ...] = Field(default=(), max_length=MOST_OBJECTS)
    """Objects that the map does not show."""
    seed: WholeNumber = Field(default=0, ge=0)
    """Seed of all noise in the run."""
    limits: Limits = Limits()
    """Limits of the run."""
    senses: SensesName | None = None
    """Sensing, real or perfect; None means that the caller decides (real by default)."""

    @model_validator(mode="before")
    @classmethod
    def _place_of_the_object(cls, values: Any) -> Any:
        pose = values.get("push_to") if isinstance(values, dict) else None
        return values if not isinstance(pose, list | tuple) or "goal" in values else {**values, "goal": pose[:2]}

    @model_validator(mode="after")
    def _one_goal(self) -> Scenario:
        if self.push_to is None:
            return self
        if not self.objects:
            raise ValueError("push_to: there is no object to push; add one under 'objects'.")
        if self.goal != self.push_to[:2]:
            raise ValueError("goal and push_to are two places; give 'goal' for the robot or 'push_to' for the object.")
        return self

    @field_validator("senses", mode="before")
    @classmethod
    def _known_senses(cls, value: object) -> object:
        if value is not None and value not in SENSES:
            raise ValueError(f"is {reprlib.repr(value)}; choose {' or '.join(SENSES)}.")
        return value


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file. Paths of map and object files are relative to it.

    Raises:
        ShmooError: the file is missing or wrong; the message names field and remedy.
    """
    path = Path(path)
    return located(validated(Scenario, read_mapping(path, "scenario"), path), path.parent)


def located(scenario: Scenario, folder: Path) -> Scenario:
    """The scenario with paths relative to the current folder, from one with paths relative to ``folder``."""
    objects = tuple(_with_file(entry, str(folder / entry.family)) for entry in scenario.objects)
    map_path = None if scenario.map is None else str(folder / scenario.map)
    return scenario.model_copy(update={"map": map_path, "objects": objects})


def portable(scenario: Scenario, folder: Path) -> Scenario:
    """The scenario with paths relative to ``folder``; the inverse of `located`.

    Paths that name no file, and a relative map path that is already valid in ``folder``, do not change.
    """

    def seen_from_there(path: str) -> str:
        if not Path(path).is_file():
            return path
        real = Path(path).parent.resolve() / Path(path).name  # resolves symbolic links before ".."
        return Path(os.path.relpath(real, folder.resolve())).as_posix()

    objects = tuple(_with_file(entry, seen_from_there(entry.family)) for entry in scenario.objects)
    map_path = scenario.map
    if map_path is not None and (Path(map_path).is_absolute() or not (folder / map_path).is_file()):
        map_path = seen_from_there(map_path)
    return scenario.model_copy(update={"map": map_path, "objects": objects})


def with_own_objects(scenario: Scenario, folder: Path) -> Scenario:
    """Copy the object files into ``folder / "objects"``, so that the folder can be moved, and return the scenario.

    Files inside ``folder`` are not copied. A copy never replaces another file; its name gets a number instead.

    Raises:
        ShmooError: an object file is missing or wrong.
    """
    from shmoo_mjx.plant.object_file import read_object

    def copied(path: str) -> str:
        read_object(path)
        source, number = Path(path), 1
        if source.resolve().is_relative_to(folder.resolve()):
            return path
        content, target = source.read_bytes(), folder / "objects" / source.name
        while target.exists() and not (target.is_file() and target.read_bytes() == content):
            number += 1
            target = target.with_name(f"{source.stem}-{number}.json")
        return str(target if target.exists() else write_whole(target, content))

    objects = tuple(_with_file(e, copied(e.family)) if e.family.endswith(".json") else e for e in scenario.objects)
    return scenario.model_copy(update={"objects": objects})


def _with_file(entry: ObjectEntry, path: str) -> ObjectEntry:
    """The entry with ``path`` as its object file; unchanged if it has none."""
    return entry.model_copy(update={"family": path}) if entry.family.endswith(".json") else entry


def save_scenario(scenario: Scenario, path: str | Path) -> None:
    """Write a scenario file. Paths in it are relative to the file (`portable`), as `load_scenario` expects."""
    data = portable(scenario, Path(path).parent).model_dump(mode="json", exclude_none=True)
    write_whole(path, yaml_text(data))


def check_scenario(grid: OccupancyGrid, scenario: Scenario, robot_radius: float, name: str = "scenario") -> None:
    """Check that start and goal are free and that a path connects them. Ignores objects, which can be moved.

    Args:
        grid: the map.
        scenario: start and goal in the map's {W}.
        robot_radius: radius of the robot's footprint [m].
        name: file or option of the scenario, for error messages.

    Raises:
        ShmooError: start or goal is off the map or too near a wall, or no path connects them.
    """
    from shmoo_mjx.planning.paths import plan_path

    if scenario.push_to is not None:
        check_point(grid, scenario.start[:2], robot_radius, f"{name}: 'start'")
        return
    for label, point in (("start", scenario.start[:2]), ("goal", scenario.goal)):
        check_point(grid, point, robot_radius, f"{name}: '{label}'")
    if plan_path(grid, scenario.start[:2], scenario.goal, robot_radius=robot_radius) is None:
        goal = f"({scenario.goal[0]:g}, {scenario.goal[1]:g})"
        raise ShmooError(
            f"{name}: 'goal' {goal} can't be reached from 'start' on this map by a robot of radius "
            f"{robot_radius:.2f} m; choose a goal in the same connected free space."
        )


def check_point(grid: OccupancyGrid, point: Sequence[float], robot_radius: float, name: str) -> None:
    """Check that the robot fits at ``point`` (x, y) in {W} [m]. Error messages call the point ``name``.

    Raises:
        ShmooError: the point is off the map or too near a wall.
    """
    import shapely

    from shmoo_mjx.planning.footprints import wall_distance
    from shmoo_mjx.planning.maps import distance_field

    where = f"{name} ({point[0]:g}, {point[1]:g})"
    if not bool(grid.inside(grid.world_to_cell(point))):
        x0, y0, x1, y1 = grid.bounds
        span = f"x {x0:.2f} to {x1:.2f} and y {y0:.2f} to {y1:.2f} m"
        raise ShmooError(f"{where} lies off the map; choose a point within {span}.")
    if grid.values_at(point) != 0:
        kind = "unknown space" if grid.values_at(point) < 0 else "a wall"
        raise ShmooError(f"{where} lies inside {kind}; choose a point on free floor.")
    # The distance field, which path planning uses, can overestimate the distance to a wall of a coarse map.
    exact = wall_distance(grid, shapely.Point(point), robot_radius)
    distance = min(float(distance_field(grid).at(point)), exact)
    if distance < robot_radius:
        need = f"{distance:.2f} m from a wall, but the robot needs {robot_radius:.2f} m"
        raise ShmooError(f"{where} is only {need}; move it away from the wall.")


def check_places(
    grid: OccupancyGrid, scenario: Scenario, sizes: Sequence[tuple[float, float]], name: str = "scenario"
) -> None:
    """Check that no object overlaps a wall, the robot or another object.

    Args:
        grid: the map.
        scenario: scenario with the poses of the objects.
        sizes: half extents of each object along {O} [m].
        name: file or option of the scenario, for error messages.

    Raises:
        ShmooError: an object overlaps; the message names the first one.
    """
    before: dict[str, tuple[Sequence[float], tuple[float, float]]] = {}
    for i, (entry, half) in enumerate(zip(scenario.objects, sizes, strict=True)):
        what = f"{name}: 'objects[{i}].pose' ({entry.pose[0]:g}, {entry.pose[1]:g}): the {Path(entry.family).stem}"
        check_place(grid, what, entry.pose, half, robot=scenario.start[:2], others=before)
        before[f"objects[{i}]"] = (entry.pose, half)
    if scenario.push_to is not None:
        (x, y), thing = scenario.goal, Path(scenario.objects[0].family).stem
        before.pop("objects[0]")
        nowhere = (np.inf, np.inf)
        check_place(
            grid,
            f"{name}: 'push_to' ({x:g}, {y:g}): the {thing}",
            scenario.push_to,
            sizes[0],
            robot=nowhere,
            others=before,
        )


def check_place(
    grid: OccupancyGrid,
    what: str,
    pose: Sequence[float],
    half_extents: tuple[float, float],
    *,
    robot: Sequence[float] | Array,
    others: Mapping[str, tuple[Sequence[float] | Array, tuple[float, float]]],
) -> None:
    """Check that an object at ``pose`` overlaps neither a wall, nor the robot, nor another object.

    Args:
        grid: the map.
        what: name of the object, for error messages.
        pose: pose (x, y, yaw) of the object in {W} [m, m, rad].
        half_extents: half extents of the object's footprint along {O} [m].
        robot: position (x, y) of the robot in {W} [m].
        others: pose and half extents of each other object, by name.

    Raises:
        ShmooError: the object overlaps something or is off the map.
    """
    import shapely

    from shmoo_mjx.planning.footprints import footprint_polygon, wall_distance
    from shmoo_mjx.plant.robot import shmoobot

    polygon = footprint_polygon(pose, half_extents)
    if not np.all(grid.inside(grid.world_to_cell(np.asarray(polygon.exterior.coords)))):
        raise ShmooError(f"{what} reaches off the map; move it inwards.")
    if wall_distance(grid, polygon.buffer(-_DEPTH), 0.0) == 0:
        raise ShmooError(f"{what} stands in a wall or in unknown space; move it away.")
    if polygon.distance(shapely.Point(robot)) < shmoobot().radius:
        raise ShmooError(f"{what} stands where the robot is; move one of them.")
    for name, (place, half) in others.items():
        if polygon.intersection(footprint_polygon(place, half)).area > _OVERLAP:
            raise ShmooError(f"{what} stands in {name}; move one of them.")
