"""The smallest scenario of each kind."""

from __future__ import annotations

from typing import Any

import numpy as np

from shmoo_mjx.evaluation.scenarios import Generated
from shmoo_mjx.planning.maps import FREE, OCCUPIED, OccupancyGrid
from shmoo_mjx.planning.scenario import Limits, ObjectEntry, Scenario


def toy_scenario(doors: int, movable: bool) -> tuple[OccupancyGrid, Scenario]:
    """Two rooms, one or two doorways, one box in the first."""
    cells = np.full((80, 120), FREE, dtype=np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = OCCUPIED
    cells[:, 59:61] = OCCUPIED
    for row in (40, 12)[:doors]:
        cells[row - 10 : row + 11, 59:61] = FREE
    weight = {"mass": 3.0, "payload": 0.0, "friction": 0.4} if movable else {"mass": 80.0, "friction": 0.6}
    properties: dict[str, Any] = {"size": [0.5, 0.55, 0.6], **weight}
    box = ObjectEntry(family="box", pose=(3.0, 2.025, 0.0), seed=1, properties=properties)
    scenario = Scenario(start=(1.2, 2.0, 0.0), goal=(5.0, 2.6), objects=(box,), limits=Limits(time_s=120))
    return OccupancyGrid(cells, 0.05), scenario


def toy_generated(*movable: bool, **fields: Any) -> Generated:
    """A scenario with one doorway, with ``fields`` known about it."""
    world: dict[str, Any] = {"kind": "push only", "movable": movable, "blocking": (True,) * len(movable)}
    world |= {"shortest": 4.0, "detour": None} | fields
    return Generated(scenario=toy_scenario(1, True)[1], **world)
