"""Expected times of options: outcomes that are made up, in a corridor and in a wide room."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from shmoo_mjx.navigation import decide
from shmoo_mjx.navigation.belief import KnownObject
from shmoo_mjx.navigation.maps import OCCUPIED, OccupancyGrid, clearance_field
from shmoo_mjx.navigation.paths import Path
from shmoo_mjx.planning.reach import STEPS, Options, Outcomes
from shmoo_mjx.types import DT

HALF = (0.3, 0.45)
SAMPLES = 4
KNOWN = KnownObject(np.array([3.0, 1.0, 0.0]), HALF)
PATH = Path(np.array([[1.0, 1.0], [5.0, 1.0], [8.0, 1.0]]), 7.0)


class Moves:
    """A foresight in which the object follows its push at a speed [m/s], in the first samples not at all."""

    def __init__(self, speed: float, stuck: int = 0) -> None:
        self.speed, self.stuck = speed, stuck

    def __call__(self, adapt: Any, kind: Any, pose: Any, half: Any, options: Options, seed: int) -> Outcomes:
        ahead = np.asarray(options.goal)[:, :2] - pose[:2]
        ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
        way = self.speed * DT * np.arange(1, STEPS + 1)[:, None] * np.ones((len(ahead), SAMPLES, 1, 1))
        way[:, : self.stuck] = 0.0
        place = pose[:2] + way * ahead[:, None, None]
        yaw = np.full((*place.shape[:3], 1), pose[2])
        robot = place - 0.75 * ahead[:, None, None]
        return Outcomes(np.concatenate([place, yaw], -1), np.concatenate([robot, yaw], -1))


def room(width: float) -> Any:
    """A corridor along x of this width [m], its middle at y = 1, that opens to twice the width at x = 6."""
    cells = np.full((160, 200), OCCUPIED, np.int8)
    y = -3.0 + 0.05 * (np.arange(160) + 0.5)
    cells[np.abs(y - 1.0) < width / 2, 5:195] = 0
    cells[np.abs(y - 1.0) < width, 120:195] = 0
    return clearance_field(OccupancyGrid(cells, 0.05, (0.0, -3.0, 0.0)))


def pushed(foresight: Any, width: float, sides: tuple[int, ...] = (0, 1, 2, 3)) -> dict[int, decide.Push]:
    return {p.side: p for p in decide.pushes(foresight, KNOWN, PATH, room(width), sides, {})}


def test_in_a_wide_room_a_push_across_frees_the_path_soonest() -> None:
    found = pushed(Moves(0.25), 2.0)
    assert found[1].probability == found[3].probability == 1.0
    # The robot passes between wall and object once 0.64 m are free; 0.55 m are.
    assert found[1].takes < 4.0
    assert abs(found[1].goal[1] - 1.0) > 0.1


def test_in_a_corridor_only_a_push_along_it_does() -> None:
    found = pushed(Moves(0.4), 1.2)
    assert found[1].probability == found[3].probability == 0.0
    assert found[0].probability == 1.0
    assert 6.0 < found[0].takes < 12.0
    assert found[0].goal[0] > 5.0


def test_the_probability_is_the_share_of_samples_and_failures_cost_what_follows() -> None:
    push = pushed(Moves(0.25, stuck=1), 2.0, (1,))[1]
    assert push.probability == 0.75
    quick, slow = (decide.expected(push, before=8.0, rest=10.0, otherwise=otherwise) for otherwise in (20.0, 60.0))
    assert slow - quick == pytest.approx(0.25 * 40.0)
    never = pushed(Moves(0.0), 2.0, (1,))[1]
    assert never.probability == 0.0 and np.isnan(never.takes)
    assert decide.expected(never, 8.0, 10.0, 20.0) > 28.0


def test_roll_outs_that_diverge_count_as_failures() -> None:
    class Diverges(Moves):
        def __call__(self, *given: Any) -> Outcomes:
            found = super().__call__(*given)
            found.object_pose[:, 0] = np.nan
            return found

    assert pushed(Diverges(0.25), 2.0, (1,))[1].probability == 0.75
