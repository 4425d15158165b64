"""Each term of the push cost against numbers worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.control.cost import (
    PushCost,
    change,
    effort,
    face_misalignment,
    pose_distance,
    push_cost,
    terminal_speed,
)
from shmoo_mjx.control.obstacles import (
    HAND_MARGIN,
    Margins,
    clearance_at,
    clearance_near,
    clearance_penalty,
    footprint_points,
)
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import REACH
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.types import SystemState

BARE = PushCost(effort=0.0, change=0.0)


def rollouts(samples: int = 2, steps: int = 3, **leaves: Any) -> SystemState:
    """Roll-outs [S, T] of a robot at rest 1 m behind a 0.6 m wide object, with the given leaves broadcast in."""
    sizes = dict.fromkeys(SystemState._fields, 3) | {"lean": 2, "lean_rate": 2, "last_force": 2, "face": 4}
    state = {k: np.zeros((samples, steps, n)) for k, n in sizes.items()} | {"size": np.zeros((samples, steps))}
    state["robot_pose"][..., 0] = -1.0
    state["face"][:] = [-0.3, 0.0, 0.0, 0.3]
    for name, value in leaves.items():
        state[name] = np.broadcast_to(value, state[name].shape)
    return SystemState(**{k: jnp.asarray(v) for k, v in state.items()})


def test_equation_9_as_printed() -> None:
    traj = rollouts(1, 2, object_pose=np.array([[[9.0, 9.0, 9.0], [1.0, 2.0, 0.5]]]))
    controls = jnp.array([[[0.3, 0.4, 0.0], [0.3, 0.4, 1.0]]])
    cfg = PushCost(yaw_weight=1.0, effort=0.1, change=0.01)
    # distance sqrt(1 + 4 + 0.25); ||u|| = 0.5 and sqrt(1.25); first change from last_u = (0.3, 0, 0): 0.4, then 1
    expected = np.sqrt(5.25) + 0.1 * (0.5 + np.sqrt(1.25)) + 0.01 * (0.4 + 1.0)
    cost = push_cost(cfg, jnp.zeros(3))(traj, controls, jnp.array([0.3, 0.0, 0.0]))
    np.testing.assert_allclose(cost, [expected], rtol=1e-5)


def test_norms_are_not_squared() -> None:
    controls = jnp.full((1, 4, 3), 0.2)
    np.testing.assert_allclose(effort(3 * controls), 3 * effort(controls), rtol=1e-6)
    np.testing.assert_allclose(change(3 * controls, jnp.zeros(3)), 3 * change(controls, jnp.zeros(3)), rtol=1e-6)


@given(st.floats(-10, 10), st.floats(-3, 3), st.integers(-3, 3))
@settings(max_examples=30, deadline=None)
def test_yaw_error_lives_on_the_circle(yaw: float, error: float, turns: int) -> None:
    goal, pose = np.array([0.0, 0.0, yaw]), np.array([0.0, 0.0, yaw + error + 2 * np.pi * turns])
    assert float(pose_distance(goal, pose, 0.5)) == pytest.approx(0.5 * abs(error), abs=1e-3)
    assert float(pose_distance(goal, pose, 0.0)) == 0.0


def test_extra_terms_are_off_by_default() -> None:
    traj = rollouts(object_twist=[1.0, 0.0, 0.0], robot_pose=[-1.0, 0.4, 0.3])
    field = DistanceField(jnp.zeros((4, 4)), jnp.zeros(3), 0.1)
    cost_fn = push_cost(PushCost(), jnp.zeros(3), clearance=field, half_extents=jnp.ones(2))
    np.testing.assert_array_equal(cost_fn(traj, jnp.zeros((2, 3, 3)), jnp.zeros(3)), np.zeros(2))


def ramp(yaw: float = 0.0) -> DistanceField:
    """Clearance = 0.1 m + distance along the grid's x from its corner, over 4 m x 2 m, corner at (1, -1)."""
    x = (np.arange(40) + 0.5) * 0.1
    return DistanceField(jnp.asarray(np.tile(x + 0.1, (20, 1))), jnp.array([1.0, -1.0, yaw]), 0.1)


@given(st.floats(0.06, 3.9), st.floats(0.06, 1.9), st.floats(-3, 3))
@settings(max_examples=30, deadline=None)
def test_clearance_is_bilinear_in_the_grids_own_frame(x: float, y: float, yaw: float) -> None:
    field = ramp(yaw)
    point = se2.transform_point(np.asarray(field.origin, dtype=float), np.array([x, y]))
    assert float(clearance_at(field, point)) == pytest.approx(x + 0.1, abs=1e-4)


def test_clearance_rows_run_along_y() -> None:
    values = jnp.zeros((3, 5)).at[2, 1].set(7.0)
    field = DistanceField(values, jnp.array([0.0, 0.0, 0.0]), 1.0)
    assert float(clearance_at(field, jnp.array([1.5, 2.5]))) == 7.0
    assert float(clearance_at(ramp(), jnp.array([1.0 + 5.0, 0.0]))) == 0.0  # off the grid nothing is clear


def test_footprint_points_turn_with_the_object() -> None:
    points = np.asarray(footprint_points(jnp.array([1.0, 2.0, np.pi / 2]), jnp.array([0.5, 0.2])))
    assert points.shape == (8, 2)
    np.testing.assert_allclose(points.min(axis=0), [0.8, 1.5], atol=1e-6)
    np.testing.assert_allclose(points.max(axis=0), [1.2, 2.5], atol=1e-6)


def test_clearance_penalty_counts_robot_and_outline_inside_their_margins() -> None:
    cfg, margins = replace(BARE, clearance_weight=2.0), Margins(object=0.5, robot=0.6)
    # Robot at x = 1.4: clearance 0.5, 0.1 short. Object centred at 1.6, half length 0.3: clearance 0.4, 0.1 short.
    traj = rollouts(1, 10, robot_pose=[1.4, 0.0, 0.0], object_pose=[1.6, 0.0, 0.0])
    field, half = ramp(), jnp.array([0.3, 0.1])
    np.testing.assert_allclose(clearance_penalty(margins, traj, field, half), [0.2], rtol=1e-4)  # 0.2 m over 1 s
    goal, args = jnp.zeros(3), (traj, jnp.zeros((1, 10, 3)), jnp.zeros(3))
    cost_fn = push_cost(cfg, goal, margins=margins, clearance=field, half_extents=half)
    np.testing.assert_allclose(cost_fn(*args) - push_cost(BARE, goal)(*args), [0.4], rtol=1e-4)
    clear = rollouts(1, 10, robot_pose=[2.4, 0.0, 0.0], object_pose=[2.6, 0.0, 0.0])
    np.testing.assert_array_equal(clearance_penalty(margins, clear, field, half), [0.0])
    coarse = replace(margins, stride=3)
    np.testing.assert_allclose(clearance_penalty(coarse, traj, field, half), [0.2], rtol=1e-4)
    with pytest.raises(ValueError, match="half_extents"):
        push_cost(cfg, goal, margins=margins, clearance=field)(*args)


@given(st.floats(0.06, 3.9), st.floats(0.06, 1.9), st.floats(-3, 3))
@settings(max_examples=30, deadline=None)
def test_near_clearance_is_that_of_the_cell(x: float, y: float, yaw: float) -> None:
    field = ramp(yaw)
    point = se2.transform_point(np.asarray(field.origin, dtype=float), np.array([x, y]))
    assert float(clearance_near(field, point)) == pytest.approx(x + 0.1, abs=0.0501)
    far = se2.transform_point(np.asarray(field.origin, dtype=float), np.array([-0.01, y]))
    assert float(clearance_near(field, far)) == 0.0


def test_a_hand_swept_into_a_wall_costs() -> None:
    margins = Margins(object=0.0, robot=0.0)
    field, half = ramp(), jnp.array([0.1, 0.1])
    field = field._replace(values=field.values + HAND_MARGIN - 0.25)
    # Clearance grows with x. Looking back, the hands are REACH nearer to the wall than the robot's centre.
    ahead, back = (rollouts(1, 10, robot_pose=[1.5, 0.0, yaw], object_pose=[2.5, 0.0, 0.0]) for yaw in (0.0, np.pi))
    np.testing.assert_array_equal(clearance_penalty(margins, ahead, field, half), [0.0])
    depth = 0.25 - (1.5 - REACH - 1.0 + 0.1)
    np.testing.assert_allclose(clearance_penalty(margins, back, field, half), [depth], atol=0.0501)
    # Steering puts the left hand forward, here towards the wall.
    turned = rollouts(1, 10, robot_pose=[1.5, 0.0, np.pi], object_pose=[2.5, 0.0, 0.0], last_u=[0.0, 0.0, 0.4])
    assert float(clearance_penalty(margins, turned, field, half)[0]) > depth + 0.01


def test_face_misalignment_of_hands_and_heading() -> None:
    # Robot at (-1, 0) turned by 0.2 rad: its hands are REACH sin 0.2 beside the centre line of the face.
    lateral, heading = face_misalignment(rollouts(robot_pose=[-1.0, 0.0, 0.2]))
    np.testing.assert_allclose(lateral, REACH * np.sin(0.2), rtol=1e-5)
    np.testing.assert_allclose(heading, 0.2, rtol=1e-5)


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3))
@settings(max_examples=30, deadline=None)
def test_face_misalignment_moves_with_the_scene(x: float, y: float, yaw: float) -> None:
    move = np.array([x, y, yaw])
    robot, thing = np.array([-1.0, 0.1, 0.2]), np.array([0.0, 0.05, -0.1])
    plain = face_misalignment(rollouts(robot_pose=robot, object_pose=thing))
    moved = face_misalignment(rollouts(robot_pose=se2.compose(move, robot), object_pose=se2.compose(move, thing)))
    np.testing.assert_allclose(moved, plain, atol=1e-5)


def test_running_and_speed_terms() -> None:
    poses = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    twists = np.array([[[9.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.3, 0.4, 5.0]]])
    traj = rollouts(1, 3, object_pose=poses, object_twist=twists)
    np.testing.assert_allclose(terminal_speed(traj), [0.5], rtol=1e-6)
    goal, args = jnp.zeros(3), (traj, jnp.zeros((1, 3, 3)), jnp.zeros(3))
    for cfg, expected in (
        (replace(BARE, running_weight=3.0), 3.0),
        (replace(BARE, speed_weight=2.0), 1.0),
        (replace(BARE, lateral_weight=1.0), 0.0),
    ):
        np.testing.assert_allclose(
            push_cost(cfg, goal)(*args) - push_cost(BARE, goal)(*args), np.array([expected]), atol=1e-6
        )
