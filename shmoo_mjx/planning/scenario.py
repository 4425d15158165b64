"""The scenario file: which map, from where to where, and which objects stand about.

map: office.yaml          # ROS map_server YAML, relative to this file; may be left out and given on the command line
start: [1.0, 1.0, 0.0]    # x, y [m], yaw [rad] in {W}
goal: [5.0, 2.0]          # x, y [m] in {W}; or push_to: [x, y, yaw], a pose for the first object
objects:
  - family: box           # box, cart or wheelchair
    pose: [3.0, 1.5, 0.2]
    seed: 4               # draws the properties that are not given
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
"""Radius of the disc that paths keep clear: body, folded hands and a reserve [m]."""
MOST_OBJECTS = 50
"""What a scene may hold: each is a body to simulate and to look for."""
Pose = tuple[Number, Number, Angle]
Property = bool | FiniteFloat

_OVERLAP = 1e-4
"""Two footprints that share less touch each other [m^2]."""
_DEPTH = 0.005
"""How far a footprint may reach into a wall [m]: less is how exactly poses are written."""
_NEVER_NEGATIVE = ("size", "mass", "payload", "friction", "rolling", "swivel_friction")
"""Properties of which a negative number makes no sense; the plant checks names and ranges."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ObjectEntry(_Strict):
    """One object on the floor."""

    family: str
    """Kind of object: one of FAMILIES, or an object file (*.json) that ``shmoo object add`` made."""
    pose: Pose
    """(x, y, yaw) of its centre in {W} [m, m, rad]."""
    seed: WholeNumber = Field(default=0, ge=0)
    """Draws every property that is not given; where a mass is given and no load, there is none."""
    properties: dict[str, Property | list[Property]] = Field(default_factory=dict)
    """Properties given instead of drawn, in SI units; the plant checks their names."""

    def condition(self) -> Condition:
        """The object with all its properties.

        Raises:
            ShmooError: a property that no such object can have.
        """
        from shmoo_mjx.plant.objects import draw_condition

        # Whoever says mass: 6 means 6 kg in all, not 6 kg and whatever load the seed puts on it.
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
                    raise ValueError(f"gives {name} = {number!r}; give a finite number, true, false or a list of them.")
                if isinstance(number, bool) and name != "locked":
                    raise ValueError(f"gives {name} = {str(number).lower()}; give a number.")
                if number < 0 and name in _NEVER_NEGATIVE:
                    raise ValueError(f"gives {name} = {number:g}, which must not be negative; give a positive number.")
        return value


class Limits(_Strict):
    """When a run ends without success."""

    time_s: Number = Field(default=180.0, ge=0.1, le=86_400)
    """Simulated time [s]."""
    goal_tolerance_m: Number = Field(default=0.25, ge=0.05)
    """Distance from the goal that counts as reached [m]."""


class Scenario(_Strict):
    """Everything that defines one run, apart from the map's cells."""

    map: str | None = None
    """Path of the map's YAML; None where the map comes from elsewhere."""
    start: Pose
    """(x, y, yaw) of the robot in {W} [m, m, rad]."""
    goal: tuple[Number, Number]
    """(x, y) in {W} [m] for the robot; with ``push_to`` that place."""
    push_to: Pose | None = None
    """(x, y, yaw) in {W} [m, m, rad] to which the first object is to be brought, in place of a goal for the robot."""
    objects: tuple[ObjectEntry, ...] = Field(default=(), max_length=MOST_OBJECTS)
    """What stands in the map and is not drawn in it."""
    seed: WholeNumber = Field(default=0, ge=0)
    """Seeds everything random in the run."""
    limits: Limits = Limits()
    """When to give up."""
    senses: SensesName | None = None
    """What the robot perceives with, real or perfect; None leaves it to whoever runs the scenario (real)."""

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
    """Reads a scenario file; map and object files are taken relative to the file.

    Raises:
        ShmooError: names the file, the field and the remedy.
    """
    path = Path(path)
    return located(validated(Scenario, read_mapping(path, "scenario"), path), path.parent)


def located(scenario: Scenario, folder: Path) -> Scenario:
    """A scenario whose paths are relative to ``folder``, with paths that can be opened from here."""
    objects = tuple(_with_file(entry, str(folder / entry.family)) for entry in scenario.objects)
    map_path = None if scenario.map is None else str(folder / scenario.map)
    return scenario.model_copy(update={"map": map_path, "objects": objects})


def portable(scenario: Scenario, folder: Path) -> Scenario:
    """The reverse of `located`: files that can be opened from here are named relative to ``folder``.

    What is no file here stays as it is, and so does a relative map path that already holds in ``folder``.
    """

    def seen_from_there(path: str) -> str:
        if not Path(path).is_file():
            return path
        real = Path(path).parent.resolve() / Path(path).name  # ".." behind a link leads elsewhere than it looks
        return Path(os.path.relpath(real, folder.resolve())).as_posix()

    objects = tuple(_with_file(entry, seen_from_there(entry.family)) for entry in scenario.objects)
    map_path = scenario.map
    if map_path is not None and (Path(map_path).is_absolute() or not (folder / map_path).is_file()):
        map_path = seen_from_there(map_path)
    return scenario.model_copy(update={"map": map_path, "objects": objects})


def with_own_objects(scenario: Scenario, folder: Path) -> Scenario:
    """The scenario with copies of its object files in ``folder / "objects"``, so that the folder can be moved.

    Files that lie in ``folder`` already are not copied. A copy never replaces another file: it gets a number.

    Raises:
        ShmooError: an object file is missing or is none.
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
    """The entry with another path, if it has an object file."""
    return entry.model_copy(update={"family": path}) if entry.family.endswith(".json") else entry


def save_scenario(scenario: Scenario, path: str | Path) -> None:
    """Writes a scenario file. Map and object files are named relative to it (`portable`), as `load_scenario` reads."""
    data = portable(scenario, Path(path).parent).model_dump(mode="json", exclude_none=True)
    write_whole(path, yaml_text(data))


def check_scenario(grid: OccupancyGrid, scenario: Scenario, robot_radius: float, name: str = "scenario") -> None:
    """Checks what only scenario and map together can tell; objects are left out, since they can be moved.

    Args:
        grid: the map.
        scenario: start and goal in the map's {W}.
        robot_radius: radius of the robot's footprint [m].
        name: the scenario's file or option, for the error.

    Raises:
        ShmooError: the start or goal is off the map or too near a wall, or no route joins them.
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
    """Checks that a robot has room at ``point`` (x, y) in {W} [m], which the error calls ``name``.

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
    # The field, by which paths are planned, can be too large beside a wall of a coarse map.
    exact = wall_distance(grid, shapely.Point(point), robot_radius)
    distance = min(float(distance_field(grid).at(point)), exact)
    if distance < robot_radius:
        need = f"{distance:.2f} m from a wall, but the robot needs {robot_radius:.2f} m"
        raise ShmooError(f"{where} is only {need}; move it away from the wall.")


def check_places(
    grid: OccupancyGrid, scenario: Scenario, sizes: Sequence[tuple[float, float]], name: str = "scenario"
) -> None:
    """Checks that every object stands on free floor, beside the robot and beside the others.

    Args:
        grid: the map.
        scenario: its objects' poses.
        sizes: each object's half extents along {O} [m].
        name: the scenario's file or option, for the error.

    Raises:
        ShmooError: names the first object that does not.
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
    """Checks that an object at ``pose`` (x, y, yaw) stands on free floor, beside the robot and beside the others.

    Args:
        grid: the map.
        what: the object's name, for the error.
        pose: in {W}.
        half_extents: of its footprint along {O} [m].
        robot: (x, y) of the robot in {W} [m].
        others: pose and half extents of each other object, by its name.

    Raises:
        ShmooError: it does not.
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
