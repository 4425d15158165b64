"""Algorithm 1, line by line, on arrays small enough to check by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.planning.object_planner import CONE, ObjectPlannerConfig, goal_grid, initial_goal, planning_stage

HERE = np.array([5.0, -3.0, 0.7])


def all_free(poses: np.ndarray) -> np.ndarray:
    return np.ones(len(poses), dtype=bool)


def none_free(poses: np.ndarray) -> np.ndarray:
    return np.zeros(len(poses), dtype=bool)


def beside(dx: float, dy: float, turn: float = 0.0) -> np.ndarray:
    return HERE + np.array([dx, dy, turn])


def ends(*offsets: tuple[float, float]) -> np.ndarray:
    return np.array([beside(dx, dy, 0.1) for dx, dy in offsets])


def assert_pose(pose: np.ndarray | None, expected: np.ndarray) -> None:
    assert pose is not None
    np.testing.assert_allclose(pose, expected, atol=1e-9)


def test_grid_covers_two_by_two_metres_round_the_object() -> None:
    grid = goal_grid(HERE)
    assert grid.shape == (21 * 21, 3)
    np.testing.assert_allclose(grid[:, :2].min(axis=0), HERE[:2] - 1)
    np.testing.assert_allclose(grid[:, :2].max(axis=0), HERE[:2] + 1)
    np.testing.assert_array_equal(grid[:, 2], HERE[2])
    np.testing.assert_allclose(np.abs(grid[:, :2] - HERE[:2]).sum(axis=1).min(), 0, atol=1e-9)


def test_initial_goal_is_the_closest_collision_free_one() -> None:
    # Only the half plane 0.65 m and more to the left is clear of the path.
    first = initial_goal(HERE, lambda p: p[:, 1] >= HERE[1] + 0.65)
    assert_pose(first.goal, beside(0, 0.7))
    assert len(first.candidates) == 4 * 21
    assert (first.candidates[:, 1] >= HERE[1] + 0.65).all()
    distance = np.linalg.norm(first.candidates[:, :2] - HERE[:2], axis=1)
    assert (np.diff(distance) > -1e-6).all()
    assert_pose(first.goal, first.candidates[0])


def test_initial_goal_keeps_the_least_displacement() -> None:
    first = initial_goal(HERE, all_free, cfg=ObjectPlannerConfig(min_displacement=0.8))
    assert first.goal is not None
    assert np.linalg.norm(first.goal[:2] - HERE[:2]) == pytest.approx(0.8)


def test_initial_goal_lies_where_the_robot_can_push() -> None:
    first = initial_goal(HERE, all_free, push_directions=np.array([np.pi / 2, np.pi]))
    assert first.goal is not None and first.direction in (0, 1)
    offsets = first.candidates[:, :2] - HERE[:2]
    bearing = np.arctan2(offsets[:, 1], offsets[:, 0])
    near = np.minimum(abs(bearing - np.pi / 2), np.pi - abs(bearing))
    assert near.max() <= CONE + 1e-9
    # Straight ahead wins over an equally close goal to the side.
    only_left = initial_goal(HERE, all_free, push_directions=np.array([-np.pi, np.pi / 2]))
    assert only_left.direction == 0
    assert_pose(initial_goal(HERE, all_free, np.array([np.pi / 2])).goal, beside(0, 0.6))


def test_initial_goal_says_why_there_is_none() -> None:
    blocked = initial_goal(HERE, none_free)
    assert blocked.goal is None and blocked.candidates.shape == (0, 3) and "collision-free" in blocked.reason
    unreachable = initial_goal(HERE, all_free, push_directions=np.zeros(0))
    assert unreachable.goal is None and unreachable.direction is None and "direction" in unreachable.reason


def test_k_sums_the_squared_displacements_of_the_three_cheapest() -> None:
    poses = ends((0.3, 0.0), (0.0, 0.4), (-0.3, -0.4), (2.0, 0.0), (0.0, 9.0))
    decision = planning_stage(poses, np.array([3.0, 1.0, 2.0, 8.0, 9.0]), HERE, all_free)
    np.testing.assert_allclose(decision.K, 0.09 + 0.16 + 0.25)
    np.testing.assert_allclose(decision.G, 0.0, atol=1e-9)  # mean end position of those three: no net displacement
    assert decision.manipulable
    np.testing.assert_allclose(planning_stage(ends((2.0, 0.0)), np.ones(1), HERE, all_free).G, 2.0)


@pytest.mark.parametrize(("distance", "manipulable"), [(0.31, False), (0.32, True)])
def test_threshold_is_0_3_square_metres(distance: float, manipulable: bool) -> None:
    decision = planning_stage(ends(*[(distance, 0.0)] * 4), np.zeros(4), HERE, all_free)
    assert decision.manipulable is manipulable
    assert (decision.goal is not None) is manipulable
    assert f"{decision.K:.3f}" in decision.reason


def test_a_first_goal_is_far_enough_for_k_to_reach_its_threshold() -> None:
    first = initial_goal(HERE, all_free)
    assert first.goal is not None
    assert planning_stage(np.tile(first.goal, (3, 1)), np.zeros(3), HERE, all_free).manipulable
    with pytest.raises(ValueError, match="min_displacement"):
        ObjectPlannerConfig(min_displacement=0.3)


def test_not_manipulable_does_not_ask_for_a_goal() -> None:
    def must_not_run(poses: np.ndarray) -> np.ndarray:
        raise AssertionError("the collision check belongs to the other branch")

    assert not planning_stage(ends((0.0, 0.0)), np.zeros(1), HERE, must_not_run).manipulable


def test_goal_is_the_closest_collision_free_end_of_any_rollout() -> None:
    poses = ends((0.9, 0.0), (0.8, 0.0), (0.7, 0.0), (0.1, 0.0), (0.5, 0.0), (0.6, 0.0))
    decision = planning_stage(poses, np.arange(6.0), HERE, lambda p: p[:, 0] > HERE[0] + 0.45)
    assert_pose(decision.goal, beside(0.5, 0, 0.1))
    assert len(decision.candidates) == 5
    assert_pose(decision.goal, decision.candidates[0])


def test_movable_but_nowhere_to_go() -> None:
    decision = planning_stage(ends((1.0, 0.0)), np.zeros(1), HERE, none_free)
    assert decision.manipulable and decision.goal is None and "none of 1" in decision.reason


def test_broken_rollouts_are_left_out() -> None:
    poses = ends((0.4, 0.0), (9.0, 0.0), (7.0, 0.0))
    poses[1, 2] = np.nan
    decision = planning_stage(poses, np.array([1.0, 0.0, np.inf]), HERE, all_free)
    np.testing.assert_allclose(decision.K, 3 * 0.16)
    assert len(decision.candidates) == 1
    nothing = planning_stage(np.full((4, 3), np.nan), np.zeros(4), HERE, all_free)
    assert not nothing.manipulable and np.isnan(nothing.K) and nothing.goal is None and "finite" in nothing.reason


@given(st.floats(-5, 5), st.floats(-5, 5), st.integers(0, 10**6))
@settings(max_examples=50, deadline=None)
def test_decision_moves_with_the_world(dx: float, dy: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses, costs, move = HERE + rng.normal(size=(20, 3)), rng.normal(size=20), np.array([dx, dy, 0.0])
    here = planning_stage(poses, costs, HERE, lambda p: p[:, 0] > HERE[0])
    there = planning_stage(poses + move, costs, HERE + move, lambda p: p[:, 0] > HERE[0] + dx)
    np.testing.assert_allclose([there.K, there.G], [here.K, here.G])
    assert len(there.candidates) == pytest.approx(len(here.candidates), abs=1)
