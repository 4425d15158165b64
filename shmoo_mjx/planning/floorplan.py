"""Random floor plans and the demo's scene.

Three rooms lie in a row: A (start), B and C (goal). One doorway joins A and B. Two doorways join B and C: the near one
close to the straight line to the goal, the far one far off it. A light box stands in the doorway of A. A wheelchair
with locked brakes stands in the near doorway of C. Every path is blocked until the box is moved; then the path through
the far doorway is free. Half of the seeds are mirrored.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.planning.maps import FREE, OCCUPIED, OccupancyGrid
from shmoo_mjx.planning.scenario import ObjectEntry, Scenario

Range = tuple[float, float]


RESOLUTION = 0.05
"""Side of a cell [m]."""
_WALL = 0.10
"""Thickness of every wall [m]."""
# Ranges of the uniform distributions.
_HEIGHT: Range = (6.0, 6.5)
"""Size of the floor plan along y [m]."""
_ROOM_A: Range = (2.9, 3.2)
"""Depth of room A along x [m]."""
_ROOM_B: Range = (2.9, 3.2)
"""Depth of room B along x [m]."""
_ROOM_C: Range = (2.5, 2.8)
"""Depth of room C along x [m]."""
_ENTRY_Y: Range = (0.45, 0.50)
"""Centre of the doorway between A and B, as a fraction of the height."""
_NEAR_Y: Range = (0.79, 0.82)
"""Centre of the near doorway between B and C, as a fraction of the height."""
_FAR_Y: Range = (0.14, 0.19)
"""Centre of the far doorway between B and C, as a fraction of the height."""
_DOOR_WIDTH: Range = (1.10, 1.30)
"""Width of a doorway [m]."""


class Doorway(NamedTuple):
    """A gap in a wall that runs along y."""

    x: float
    """x of the wall's centre line [m]."""
    y: float
    """y of the gap's centre [m]."""
    width: float
    """Width of the gap [m]."""


class Floorplan(NamedTuple):
    """A map and its doorways."""

    grid: OccupancyGrid
    """Walls and floor. The origin is the lower-left outer corner."""
    entry: Doorway
    """Between rooms A and B."""
    near: Doorway
    """Between rooms B and C, near the straight line to the goal."""
    far: Doorway
    """Between rooms B and C, far off that line."""


def draw_floorplan(rng: np.random.Generator, widths: tuple[float, float] | None = None) -> Floorplan:
    """Draws the floor plan of three rooms.

    Args:
        rng: random generator; its state advances.
        widths: widths of the entry and of the near doorway [m], drawn if not given.
    """

    def draw(span: Range, scale: float = 1.0) -> float:
        return _snap(rng.uniform(*span) * scale, RESOLUTION)

    height, wall = draw(_HEIGHT), _WALL
    x1 = wall + draw(_ROOM_A) + wall / 2
    x2 = x1 + wall + draw(_ROOM_B)
    length = x2 + wall / 2 + draw(_ROOM_C) + wall
    entry_width, near_width = widths or (draw(_DOOR_WIDTH), draw(_DOOR_WIDTH))
    entry = Doorway(x1, draw(_ENTRY_Y, height), _snap(entry_width, RESOLUTION))
    near = Doorway(x2, draw(_NEAR_Y, height), _snap(near_width, RESOLUTION))
    far = Doorway(x2, draw(_FAR_Y, height), draw(_DOOR_WIDTH))
    cells = np.full(_cells((height, length), RESOLUTION), FREE, dtype=np.int8)
    edge = round(wall / RESOLUTION)
    cells[:edge] = cells[-edge:] = cells[:, :edge] = cells[:, -edge:] = OCCUPIED
    for x in (x1, x2):
        left = round((x - wall / 2) / RESOLUTION)
        cells[:, left : left + edge] = OCCUPIED
    for door in (entry, near, far):
        left = round((door.x - wall / 2) / RESOLUTION)
        low = round((door.y - door.width / 2) / RESOLUTION)
        cells[low : low + round(door.width / RESOLUTION), left : left + edge] = FREE
    return Floorplan(OccupancyGrid(cells, RESOLUTION), entry, near, far)


def demo_scenario(seed: int) -> tuple[OccupancyGrid, Scenario]:
    """The demo's map and scenario for a seed, including the objects' properties."""
    rng = np.random.default_rng([seed, 0x5F100])
    box_side, chair_width = rng.uniform(0.45, 0.58), rng.uniform(0.54, 0.60)
    # The gap beside each object is narrower than the robot's 0.5 m, but wide enough for the object to turn a little.
    widths = (np.clip(box_side + rng.uniform(0.60, 0.68), 1.1, 1.25), chair_width + rng.uniform(0.58, 0.66))
    plan = draw_floorplan(rng, widths=widths)
    start_y = plan.entry.y + rng.uniform(0.1, 0.6)
    start_x = rng.uniform(0.8, 1.1)
    start_yaw = np.arctan2(plan.entry.y - start_y, plan.entry.x - start_x) + rng.uniform(-0.15, 0.15)
    goal = (plan.near.x + rng.uniform(1.1, 1.5), plan.near.y + rng.uniform(-0.1, 0.2))
    scenario = Scenario(
        start=_rounded(start_x, start_y, start_yaw),
        goal=_rounded(*goal),
        objects=(_draw_box(rng, plan.entry, box_side), _draw_wheelchair(rng, plan.near, chair_width)),
        seed=seed,
    )
    return _mirrored(plan.grid, scenario) if rng.random() < 0.5 else (plan.grid, scenario)


def paper_scenario(seed: int) -> tuple[OccupancyGrid, Scenario]:
    """The paper's scene (Sec. VI-B): a box of 2.8 kg and an empty wheelchair of 11.9 kg with locked wheels.

    The paper gives no floor plan, sizes or friction, so these are the demo's, drawn from ``seed``. All four wheels are
    locked: with only the rear wheels locked the robot could push the empty wheelchair from behind, but the paper's
    wheelchair is not manipulable.
    """
    grid, scenario = demo_scenario(seed)
    box, chair = scenario.objects
    empty: dict[str, Any] = {"payload": 0.0, "payload_x": 0.0}
    properties = (empty | {"mass": 2.8}, empty | {"mass": 11.9, "locked": [True] * 4})
    objects = tuple(
        entry.model_copy(update={"properties": entry.properties | own})
        for entry, own in zip((box, chair), properties, strict=True)
    )
    return grid, scenario.model_copy(update={"objects": objects})


SCENES = {"generated": demo_scenario, "paper": paper_scenario}
"""Scenes of `shmoo demo`. Each takes a seed."""


def _draw_box(rng: np.random.Generator, door: Doorway, side: float) -> ObjectEntry:
    pose = _rounded(door.x + rng.uniform(0.0, 0.2), door.y + rng.uniform(-0.04, 0.04), rng.uniform(-0.22, 0.02))
    properties: dict[str, Any] = {
        "size": list(_rounded(side, side * rng.uniform(0.95, 1.05), rng.uniform(0.6, 0.7))),
        "mass": round(rng.uniform(2.5, 6.0), 2),
        "payload": 0.0,
        "friction": round(rng.uniform(0.3, 0.5), 3),
    }
    return ObjectEntry(family="box", pose=pose, seed=int(rng.integers(10**6)), properties=properties)


def _draw_wheelchair(rng: np.random.Generator, door: Doorway, width: float) -> ObjectEntry:
    yaw = rng.choice([0.0, np.pi]) + rng.uniform(-0.12, 0.12)
    pose = _rounded(door.x - rng.uniform(0.05, 0.30), door.y + rng.uniform(-0.03, 0.03), yaw)
    properties: dict[str, Any] = {
        "size": [0.8, round(width, 3), 0.52],
        "payload": round(rng.uniform(30.0, 70.0), 1),
        "payload_x": round(rng.uniform(0.0, 0.08), 3),
        "friction": round(rng.uniform(0.7, 1.0), 3),
        "locked": [True, True, False, False],
    }
    return ObjectEntry(family="wheelchair", pose=pose, seed=int(rng.integers(10**6)), properties=properties)


def _mirrored(grid: OccupancyGrid, scenario: Scenario) -> tuple[OccupancyGrid, Scenario]:
    """Map and scenario mirrored in y. Lateral payload offsets stay, because their distribution is symmetric."""
    height = grid.cells.shape[0] * grid.resolution

    def flip(x: float, y: float, *yaw: float) -> Any:
        return _rounded(x, height - y, *(-angle for angle in yaw))

    objects = tuple(entry.model_copy(update={"pose": flip(*entry.pose)}) for entry in scenario.objects)
    update = {"start": flip(*scenario.start), "goal": flip(*scenario.goal), "objects": objects}
    flipped = OccupancyGrid(np.ascontiguousarray(grid.cells[::-1]), grid.resolution, grid.origin)
    return flipped, scenario.model_copy(update=update)


def _snap(value: float, step: float) -> float:
    return round(value / step) * step


def _cells(lengths: tuple[float, ...], resolution: float) -> tuple[int, ...]:
    return tuple(round(length / resolution) for length in lengths)


def _rounded(*values: float) -> Any:
    # Three decimals keep a written scenario readable and equal to the one in memory.
    return tuple(round(float(v), 3) for v in values)


def draw_building(rng: np.random.Generator) -> OccupancyGrid:
    """Draws a building with many rooms and corridors.

    Walls divide a rectangle recursively. Each wall has one doorway, so every room can be reached. Some walls have a
    second doorway; the fewer there are, the longer the detours.
    """
    size = np.array([_snap(rng.uniform(14.0, 32.0), RESOLUTION), _snap(rng.uniform(10.0, 22.0), RESOLUTION)])
    cells = np.full(_cells((size[1], size[0]), RESOLUTION), FREE, dtype=np.int8)
    edge = round(_WALL / RESOLUTION)
    cells[:edge] = cells[-edge:] = cells[:, :edge] = cells[:, -edge:] = OCCUPIED
    least, second = rng.uniform(1.4, 3.0) / RESOLUTION, rng.uniform(0.4, 1.0)
    _divide(cells, rng, (edge, edge, cells.shape[1] - edge, cells.shape[0] - edge), least=least, second=second)
    return OccupancyGrid(cells, RESOLUTION)


def _divide(
    cells: np.ndarray, rng: np.random.Generator, room: tuple[int, int, int, int], *, least: float, second: float
) -> None:
    """Divides a room (left, low, right, high) [cells] by a wall, and both parts recursively down to ``least``."""
    left, low, right, high = room
    upright = right - left > high - low
    begin, end = (left, right) if upright else (low, high)
    grid, edge = cells if upright else cells.T, round(_WALL / RESOLUTION)
    bottom, top = (low, high) if upright else (left, right)
    places = [
        at
        for at in range(round(begin + least), round(end - least - edge))
        # A wall must not end in a doorway.
        if (grid[[bottom - 1, top], max(at - 8, 0) : at + edge + 8] == OCCUPIED).all()
    ]
    if end - begin < 2.4 * least or top - bottom < 1.6 / RESOLUTION or not places:
        return
    at = int(rng.choice(places))
    grid[bottom:top, at : at + edge] = OCCUPIED
    for _ in range(2 if rng.random() < second and top - bottom > 3.0 / RESOLUTION else 1):
        width = round(rng.uniform(0.9, 1.4) / RESOLUTION)
        first = int(rng.integers(bottom + 2, top - width - 1))
        grid[first : first + width, at : at + edge] = FREE
    parts = ((begin, at), (at + edge, end))
    for a, b in parts:
        _divide(cells, rng, (a, low, b, high) if upright else (left, a, right, b), least=least, second=second)
