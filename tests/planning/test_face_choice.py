"""Which face to push: arcs, one push ahead and two."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.planning.face_choice import arc_ends, choose, residual
from shmoo_mjx.planning.maps import OccupancyGrid, clearance_field

HALF = (0.35, 0.25)
FACES = faces_of(HALF)
OPEN = clearance_field(OccupancyGrid(np.zeros((160, 160), np.int8), 0.05, (-4.0, -4.0, 0.0)))
NEAR = [1.0, 1.0, 1.0, 1.0]


@settings(deadline=None)
@given(st.floats(0.05, 2.5), st.floats(-0.6, 0.6), st.integers(0, 3), st.floats(-3, 3))
def test_arcs_are_what_small_steps_add_up_to(length: float, curvature: float, side: int, yaw: float) -> None:
    start = np.array([0.2, -0.4, yaw])
    pose, n = start.copy(), 400
    for _ in range(n):
        middle = pose[2] + FACES[side][2] + 0.5 * curvature * length / n
        pose[:2] += length / n * np.array([np.cos(middle), np.sin(middle)])
        pose[2] += curvature * length / n
    end = arc_ends(start, FACES[side], np.array([length]), np.array([curvature]))[0, 0]
    assert np.allclose(end[:2], pose[:2], atol=1e-4)
    assert abs(se2.wrap(end[2] - pose[2])) < 1e-6


@settings(deadline=None)
@given(st.integers(0, 3), st.floats(-3, 3), st.floats(0.3, 2.0))
def test_a_goal_straight_ahead_of_a_face_is_pushed_to_from_there(side: int, yaw: float, distance: float) -> None:
    pose = np.array([0.1, 0.3, yaw])
    goal = arc_ends(pose, FACES[side], np.array([distance]), np.array([0.0]))[0, 0]
    choice = choose(pose, goal, FACES, NEAR, OPEN, HALF)
    assert choice is not None
    assert choice.side == side
    assert np.array_equal(choice.goal, goal)


def test_what_went_past_its_goal_is_pushed_back_from_the_other_side() -> None:
    choice = choose(np.array([1.4, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), FACES, NEAR, OPEN, HALF)
    assert choice is not None
    assert choice.side == 2


def test_a_face_that_can_not_be_reached_is_left_alone() -> None:
    goal = np.array([1.0, 0.0, 0.0])
    choice = choose(np.zeros(3), goal, FACES, [None, 1.0, 1.0, 1.0], OPEN, HALF)
    assert choice is not None
    assert choice.side != 0
    assert choose(np.zeros(3), goal, FACES, [None] * 4, OPEN, HALF) is None


def test_a_goal_across_takes_two_pushes() -> None:
    """No arc leads 45 deg across without a turn; a push ahead and one from the side do."""
    goal = np.array([1.2, 1.2, 0.0])
    choice = choose(np.zeros(3), goal, FACES, NEAR, OPEN, HALF)
    assert choice is not None
    assert choice.side in (0, 1)
    assert np.allclose(choice.goal, [1.2, 0, 0] if choice.side == 0 else [0, 1.2, 0], atol=1e-9)
    assert choice.expected < 0.65
    # Where the other two faces can't be reached there is but one push, and it leaves more.
    alone = choose(np.zeros(3), goal, FACES, [1.0, None, None, None], OPEN, HALF)
    assert alone is not None
    assert np.array_equal(alone.goal, goal)
    assert alone.expected > 0.65


def test_no_stop_on_the_way_stands_in_a_wall() -> None:
    cells = np.zeros((160, 160), np.int8)
    cells[90:, :] = 100
    walled = clearance_field(OccupancyGrid(cells, 0.05, (-4.0, -4.0, 0.0)))
    choice = choose(np.zeros(3), np.array([-0.8, 0.8, 0.0]), FACES, NEAR, walled, HALF)
    assert choice is not None
    assert choice.side == 2
    assert choice.goal[1] < 0.5 - HALF[1]


def test_the_yaw_error_is_taken_on_the_circle() -> None:
    assert residual(np.array([0, 0, 3.1]), np.array([0, 0, -3.1]), 1.0) == pytest.approx(2 * np.pi - 6.2)
