"""Which pushes bring an object to a pose: sequences of displacements that are known."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.planning import reach
from shmoo_mjx.planning.reach import Options
from shmoo_mjx.planning.search import (
    ERROR,
    Choice,
    PushDisplacements,
    choose_push,
    push_displacements,
    push_error,
    residual,
)

HALF = (0.35, 0.25)
FACES = faces_of(HALF)
NEAR = [1.0, 1.0, 1.0, 1.0]
ORIGIN = np.zeros(3)


class Arcs:
    """Foresees an object that follows the arc to its goal exactly, 0.01 m in a sample of time."""

    def median_poses(self, adapt: Any, kind: Any, half_extents: Any, options: Options) -> np.ndarray:
        bearing = se2.wrap(np.arctan2(options.goal[:, 1], options.goal[:, 0]) - options.face[:, 2])
        curvature = 2.0 * np.sin(bearing) / np.hypot(options.goal[:, 0], options.goal[:, 1])
        ahead = np.abs(bearing) < 1.2
        way = 0.01 * np.arange(1, 240)
        turn = np.where(ahead, curvature, 0.0)[:, None] * way
        chord = way * np.sinc(turn / (2.0 * np.pi))
        along = options.face[:, 2:3] + turn / 2.0
        return np.stack([chord * np.cos(along), chord * np.sin(along), turn], axis=-1)


def everywhere(poses: np.ndarray) -> np.ndarray:
    return np.ones(len(poses), bool)


def chosen(
    pose: Any, goal: Any, ways: Any = NEAR, free: Any = everywhere, foresight: Any = None, error: float = ERROR
) -> Choice | None:
    pose, goal = np.array(pose, float), np.array(goal, float)
    reached = push_displacements(
        foresight or Arcs(), adapt=None, kind=None, half_extents=HALF, goal=np.asarray(se2.relative(pose, goal))
    )
    return choose_push(reached, pose, goal, faces=FACES, ways=ways, free=free, error=error)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 3), st.floats(-3, 3), st.floats(0.3, 2.0))
def test_a_goal_straight_ahead_of_a_face_is_pushed_to_from_there(side: int, yaw: float, distance: float) -> None:
    pose = np.array([0.1, 0.3, yaw])
    along = np.array([distance * np.cos(FACES[side][2]), distance * np.sin(FACES[side][2]), 0.0])
    goal = np.asarray(se2.compose(pose, along))
    choice = chosen(pose, goal)
    assert choice is not None
    assert choice.side == side
    np.testing.assert_array_equal(choice.goal, goal)
    assert choice.cost == pytest.approx(ERROR * (1.0 + distance), abs=0.03)


def test_what_went_past_its_goal_is_pushed_back_from_the_other_side() -> None:
    choice = chosen([1.4, 0.0, 0.0], [1.0, 0.0, 0.0])
    assert choice is not None and choice.side == 2


def test_a_push_has_to_mend_what_it_costs() -> None:
    assert chosen([1.0, 0.0, 0.0], [1.0, 0.04, 0.0]) is None
    assert chosen([1.0, 0.0, 0.0], [1.0, 0.2, 0.0]) is not None


def test_of_an_object_whose_pushes_err_less_is_asked() -> None:
    assert chosen(ORIGIN, [1.0, 1.0, 0.0]) is not None
    assert chosen(ORIGIN, [1.0, 1.0, 0.0], error=1.0) is None
    assert chosen([1.0, 0.0, 0.0], [1.0, 0.25, 0.0]) is not None
    assert chosen([1.0, 0.0, 0.0], [1.0, 0.25, 0.0], error=0.25) is None


@given(st.lists(st.floats(0.0, 1.0), max_size=6))
def test_the_expected_error_lies_between_those_so_far(errors: list[float]) -> None:
    assert push_error([]) == pytest.approx(ERROR)
    assert min([ERROR, *errors]) - 1e-9 <= push_error(errors) <= max([ERROR, *errors]) + 1e-9


def test_a_face_that_can_not_be_reached_is_left_alone() -> None:
    choice = chosen(ORIGIN, [1.0, 0.0, 0.0], [None, 1.0, 1.0, 1.0])
    assert choice is not None and choice.side != 0
    assert chosen(ORIGIN, [1.0, 0.0, 0.0], [None] * 4) is None


def test_a_goal_across_takes_two_pushes() -> None:
    """No arc leads 45 deg across without a turn; a push ahead and one from the side do."""
    goal = [1.0, 1.0, 0.0]
    choice = chosen(ORIGIN, goal)
    assert choice is not None and choice.side in (0, 1)
    np.testing.assert_allclose(choice.goal, [1, 0, 0] if choice.side == 0 else [0, 1, 0], atol=0.15)
    # Where only one face can be reached there is but one push, and it leaves more.
    alone = chosen(ORIGIN, goal, [1.0, None, None, None])
    assert alone is not None
    np.testing.assert_array_equal(alone.goal, goal)
    assert alone.cost > choice.cost + 0.2


def test_no_stop_on_the_way_is_where_the_object_may_not_stand() -> None:
    goal = [1.0, 1.0, 0.0]
    first = chosen(ORIGIN, goal)
    assert first is not None
    other = chosen(ORIGIN, goal, free=lambda poses: residual(poses, first.goal) > 0.5)
    assert other is not None and residual(other.goal, first.goal) > 0.5
    single = chosen(ORIGIN, goal, free=lambda poses: np.zeros(len(poses), bool))
    assert single is not None
    np.testing.assert_array_equal(single.goal, goal)


def test_what_does_not_move_is_not_pushed() -> None:
    class Stuck(Arcs):
        def median_poses(self, adapt: Any, kind: Any, half_extents: Any, options: Options) -> np.ndarray:
            return np.full((len(options.face), 5, 3), 1e-4)

    assert chosen(ORIGIN, [1.0, 0.0, 0.0], foresight=Stuck()) is None


def test_a_roll_out_that_diverges_leads_nowhere() -> None:
    class Lost(Arcs):
        def median_poses(self, adapt: Any, kind: Any, half_extents: Any, options: Options) -> np.ndarray:
            poses = super().median_poses(adapt, kind, half_extents, options)
            return np.where((options.face[:, 2] == 0.0)[:, None, None], np.nan, poses)

    choice = chosen(ORIGIN, [1.0, 0.0, 0.0], foresight=Lost())
    assert choice is not None and choice.side != 0


@pytest.mark.parametrize("kind", ["box", "wheelchair", None])
def test_an_object_that_nobody_touched_goes_left_as_it_goes_right(kind: str | None) -> None:
    reached = expected(kind)
    behind = PushDisplacements(*(part[(reached.side == 0) & ~reached.aimed] for part in reached))
    turned = np.abs(behind.moved[:, 2])
    assert turned.min() < 0.1 and turned.max() > 0.5
    # A straight push is the first option; it stays straight for a metre.
    straight = behind.moved[:50]
    assert np.abs(straight[:, 1]).max() < 0.05 and straight[-1, 0] > 0.9
    left, right = (behind.moved[np.sign(behind.moved[:, 2]) == sign] * [1, sign, sign] for sign in (1, -1))
    # With 8 iterations of the contact model in place of 5 it is below 0.05.
    assert np.mean([residual(pose, right[np.argmin(residual(right, pose))]) for pose in left[::20]]) < 0.1


@cache
def expected(kind: str | None) -> PushDisplacements:
    from shmoo_mjx.control.presets import PushConfig

    return push_displacements(
        reach.contact_foresight(None, PushConfig()),
        adapt=None,
        kind=kind,
        half_extents=HALF,
        goal=np.array([1.0, 0.0, 0.0]),
    )


def test_a_yaw_error_is_taken_on_the_circle() -> None:
    assert residual(np.array([0, 0, 3.1]), np.array([0, 0, -3.1])) == pytest.approx(0.25 * (2 * np.pi - 6.2))
