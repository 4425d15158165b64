"""What the robot knows, and what it answers about ways through it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from shmoo_mjx.behavior.belief import ObjectBelief, Status, belief_of
from shmoo_mjx.behavior.push_options import path_clear, predict_pushes
from shmoo_mjx.behavior.routes import PACE, PUSH, Routes
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.planning.maps import FREE, OCCUPIED, OccupancyGrid
from shmoo_mjx.planning.paths import path_blocked_by
from shmoo_mjx.planning.reach import STEPS, Options, Outcomes
from shmoo_mjx.types import Observation

HALF = (0.25, 0.25)


def rooms(doors: tuple[float, ...]) -> OccupancyGrid:
    """6 x 6 m with a wall at x = 3 m and doorways of 1.2 m centred at the given y."""
    cells = np.full((120, 120), FREE, dtype=np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = OCCUPIED
    cells[:, 59:61] = OCCUPIED
    for y in doors:
        cells[round((y - 0.6) / 0.05) : round((y + 0.6) / 0.05), 59:61] = FREE
    return OccupancyGrid(cells, 0.05)


def observation(robot: tuple[float, float], *objects: tuple[float, float, float]) -> Observation:
    zero = np.zeros((1, 2))
    poses = np.array([objects])
    return Observation(
        np.zeros(1),
        np.array([[*robot, 0.0]]),
        np.zeros((1, 3)),
        zero,
        zero,
        np.zeros((1, 2, 3)),
        poses,
        0 * poses,
        0 * poses,
        np.zeros(1),
        np.zeros((1, len(objects))),
        np.ones((1, len(objects)), dtype=bool),
    )


def test_what_was_never_detected_stays_unknown_and_what_was_is_kept() -> None:
    unseen = (np.nan, np.nan, np.nan)
    belief, _ = belief_of(rooms((1.0,))).update(observation((1.0, 5.0), (2.0, 4.0, 0.1), unseen), [HALF] * 2)
    assert set(belief.objects) == {0}
    np.testing.assert_allclose(belief.objects[0].pose, (2.0, 4.0, 0.1))
    later, _ = belief.update(observation((1.0, 5.0), (2.1, 4.0, 0.1), (2.5, 5.0, 0.0)), [HALF] * 2)
    assert set(later.objects) == {0, 1} and later.objects[0].pose[0] == 2.1
    assert belief.objects[0].pose[0] == 2.0  # the one before is as it was


def test_it_is_said_when_a_pushed_object_is_lost_and_found() -> None:
    belief, said = belief_of(rooms((1.0,))), []
    for age in (0.0, 0.1, 0.6, 0.9, 0.0):
        seen = observation((1.0, 5.0), (2.0, 4.0, 0.1))._replace(object_age=np.array([[age]]))
        belief, notes = belief.update(seen, [HALF], pushed=0)
        said += notes
    assert ["not detected" in what for what in said] == [True, False]
    assert "detected again after 0.9 s" in said[1]


@pytest.mark.parametrize(("told", "status"), [(None, Status.UNKNOWN), ([Status.FIXED], Status.FIXED)])
def test_what_somebody_moves_counts_as_unknown_again_unless_its_status_was_told(
    told: list[Status] | None, status: Status
) -> None:
    belief, _ = belief_of(rooms((1.0,))).update(observation((1.0, 5.0), (2.0, 4.0, 0.1)), [HALF], first_status=told)
    belief = belief.with_object(0, status=Status.FIXED)
    belief, notes = belief.update(observation((1.0, 5.0), (2.0, 4.3, 0.1)), [HALF], first_status=told)
    assert belief.objects[0].status is status and "somebody has moved it" in notes[0]


def test_what_is_only_remembered_is_not_taken_to_have_been_moved() -> None:
    belief, _ = belief_of(rooms((1.0,))).update(observation((1.0, 5.0), (2.0, 4.0, 0.1)), [HALF])
    old = observation((1.0, 5.0), (2.0, 4.3, 0.1))._replace(object_age=np.array([[3.0]]))
    belief, notes = belief.update(old, [HALF])
    assert not notes


def test_what_an_object_is_taken_for_at_first_sight_can_be_told() -> None:
    seen = observation((1.0, 5.0), (2.0, 4.0, 0.1))
    belief, _ = belief_of(rooms((1.0,))).update(seen, [HALF], first_status=[Status.FIXED])
    assert belief.objects[0].status is Status.FIXED


def routes(doors: tuple[float, ...], pose: tuple[float, float, float]) -> tuple[Routes, ObjectBelief]:
    known = ObjectBelief(np.array(pose), HALF)
    belief = replace(belief_of(rooms(doors)), objects={0: known})
    return Routes(belief, np.array([5.0, 3.0])), known


@pytest.mark.parametrize(("y", "clear"), [(3.0, False), (4.6, True)])
def test_the_path_is_clear_once_the_object_stands_beside_it(y: float, clear: bool) -> None:
    ways, _ = routes((3.0,), (3.6 if clear else 3.0, y, 0.0))
    assert path_clear(ways, np.array([1.0, 3.0]), 0) is clear


def test_the_way_through_another_door_is_not_a_clear_path() -> None:
    ways, known = routes((3.0, 5.0), (3.0, 3.0, 0.0))
    assert ways.plan(np.array([1.0, 3.0]), [known.polygon]) is not None
    assert not path_clear(ways, np.array([1.0, 3.0]), 0)


@pytest.mark.parametrize("x", [3.0, 3.3, 3.6, 3.9, 4.2])
@pytest.mark.parametrize("y", [2.6, 3.0, 3.4])
def test_a_push_ends_where_its_prediction_says_that_the_path_is_free(x: float, y: float) -> None:
    """Otherwise the predicted goal is always just ahead of the object, and the push goes on."""
    ways, target = routes((3.0,), (x, y, 0.0))
    here, clearance = np.array([1.0, 3.0]), ways.belief.clearance(without=0)
    through = ways.quickest(here, without=0)
    assert through is not None

    def stays(adapt: Any, kind: Any, pose: Any, half: Any, options: Options, seed: int) -> Outcomes:
        """Nothing moves; the robot is where it hits no wall."""
        count = len(options.goal)
        robot = np.tile(np.array([1.0, 3.0, 0.0]), (count, 1, STEPS, 1))
        return Outcomes(np.tile(pose, (count, 1, STEPS, 1)), robot)

    at_once = predict_pushes(stays, target, through.path, clearance=clearance, sides=[0], places={})
    assert path_clear(ways, here, 0) == np.isfinite(at_once[0].free).all()


@pytest.mark.parametrize(
    ("prices", "goes_through"), [((None, None), {0}), ((1.0, 9.0), {0}), ((30.0, 1.0), {1}), ((1e4, 1e4), {0})]
)
def test_the_quickest_way_leads_through_what_is_cheapest_to_push(
    prices: tuple[float | None, float | None], goes_through: set[int]
) -> None:
    """An object in each of two doorways, the nearer one first; without a third way one of them has to be pushed."""
    objects = {
        i: ObjectBelief(np.array((3.0, y, 0.0)), HALF, price=price)
        for i, (y, price) in enumerate(zip((3.0, 5.0), prices, strict=True))
    }
    ways = Routes(replace(belief_of(rooms((3.0, 5.0))), objects=objects), np.array([5.0, 3.0]))
    here = np.array([1.0, 3.0])
    way = ways.quickest(here)
    assert way is not None
    met = {i for i, o in objects.items() if path_blocked_by(way.path, o.polygon, 0.2)[0]}
    assert met == goes_through
    told = [PUSH if p is None else p for p in prices]
    assert way.seconds == pytest.approx(way.path.length / PACE + sum(told[i] for i in met))
    other = ways.quickest(here, {next(iter(met)): 0.0})
    assert other is not None and other.seconds >= way.seconds
    free = ways.quickest(here, without=next(iter(met)))
    assert free is not None and free.seconds <= way.seconds
    assert ways.quickest(here, {0: 0.0, 1: 0.0}) is None


def test_goals_keep_off_walls_and_the_path() -> None:
    ways, known = routes((3.0,), (3.0, 3.0, 0.0))
    here = np.array([1.0, 3.0])
    check = ways.collision_free(here, known, ways.belief.clearance(without=0), ways.free_path(here, known))
    poses = np.array([(4.0, 3.0, 0.0), (4.0, 4.0, 0.0), (3.1, 4.5, 0.0), (2.0, 2.0, 0.0)])
    #       on the path, beside it, in the wall, beside it on this side
    assert check(poses).tolist() == [False, True, False, True]


def test_where_no_goal_leaves_the_path_another_path_may_do() -> None:
    ways, known = routes((3.0,), (3.0, 3.0, 0.0))
    here = np.array([1.0, 3.0])
    check = ways.collision_free(here, known, ways.belief.clearance(without=0), ways.free_path(here, known))
    on_path, in_door = np.array([(4.0, 3.0, 0.0)]), np.array([(3.0, 3.0, 0.0)])
    assert check(on_path).tolist() == [True]  # the room is wide enough to pass it
    assert check(in_door).tolist() == [False]


def test_the_way_to_a_face_ends_at_its_stand_off_pose() -> None:
    ways, _ = routes((3.0,), (3.0, 3.0, 0.0))
    rear, _, front, _ = faces_of(HALF)
    way = ways.path_to_face(np.array([1.0, 3.0]), 0, rear, ways.belief.clearance())
    assert way is not None and way[1] == 0.12
    np.testing.assert_allclose(way[0].points[-1], (3.0 - 0.25 - 0.12 - 0.42 - 0.04, 3.0), atol=1e-6)
    assert (
        ways.path_to_face(np.array([1.0, 3.0]), 0, front, ways.belief.clearance()) is None
    )  # the object closes the only door
    fixed = replace(ways, belief=ways.belief.with_object(0, status=Status.FIXED))
    assert fixed.plan(np.array([1.0, 3.0]), fixed.belief.polygons((Status.FIXED,))) is None


@pytest.mark.parametrize(("failed", "lateral"), [(0, 0.0), (1, 0.2), (2, -0.2), (3, 0.0)])
def test_a_face_that_has_failed_is_pushed_at_one_end_then_at_the_other(failed: int, lateral: float) -> None:
    ways, _ = routes((3.0,), (3.0, 3.0, 0.0))
    way = ways.path_to_face(np.array([1.0, 3.0]), 0, faces_of(HALF)[0], ways.belief.clearance(), failed=failed)
    assert way is not None and way[1:] == (0.12, lateral)


def test_a_retreat_leads_straight_back_or_aslant_to_where_there_is_room() -> None:
    ways, known = routes((3.0,), (3.0, 3.0, 0.0))
    assert ways.retreat_path(np.array([2.4, 3.0]), known.pose) is None, "straight back will do"
    corner = ways.retreat_path(np.array([0.45, 0.45]), np.array([1.0, 0.5, 0.0]))
    assert corner is not None and ways.belief.wall_clearance.at(corner.points[-1]) > 0.2


def test_where_a_wall_stands_behind_the_middle_of_a_face_the_way_leads_beside_it() -> None:
    """A pillar 0.25 m to the left of the stand-off pose, at any distance from the face."""
    ways, _ = routes((3.0,), (3.0, 3.0, 0.0))
    cells = ways.belief.grid.cells.copy()
    cells[65, 32:45] = OCCUPIED
    grid = replace(ways.belief.grid, cells=cells)
    belief, _ = belief_of(grid).update(observation((1.0, 2.0), (3.0, 3.0, 0.0)), [HALF])
    way = replace(ways, belief=belief).path_to_face(np.array([1.0, 2.0]), 0, faces_of(HALF)[0], belief.clearance())
    assert way is not None and way[1:] == (0.12, -0.1)
    np.testing.assert_allclose(way[0].points[-1], (3.0 - 0.25 - 0.12 - 0.42 - 0.04, 2.9), atol=1e-6)
