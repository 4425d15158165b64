"""The input/output table, and that nothing in it depends on where the scene stands."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shmoo_mjx.dynamics import core, features
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_RADIUS, REACH, SEPARATION
from shmoo_mjx.types import DT, SystemState

number = st.floats(-1.0, 1.0, width=32)


def scene(values: list[float]) -> SystemState:
    v = np.asarray(values, np.float32)
    return SystemState(
        robot_pose=v[0:3],
        robot_twist=v[3:6],
        lean=0.1 * v[6:8],
        lean_rate=0.1 * v[8:10],
        object_pose=v[0:3] + np.array([REACH + HAND_RADIUS + 0.3, 0.1, 0.0], np.float32) + 0.2 * v[10:13],
        object_twist=v[13:16],
        last_object_twist=v[16:19],
        last_wrench=30 * v[19:22],
        last_force=30 * v[19:21],
        last_u=0.2 * v[21:24],
        face=np.array([-0.3, 0.05, 0.1, 0.3], np.float32),
        size=np.float32(0.42),
    )


def moved(state: SystemState, by: np.ndarray) -> SystemState:
    """The whole scene moved and turned by the pose ``by``."""
    return state._replace(
        robot_pose=se2.compose(by, state.robot_pose),
        object_pose=se2.compose(by, state.object_pose),
        robot_twist=se2.rotate(state.robot_twist, by[2]),
        object_twist=se2.rotate(state.object_twist, by[2]),
    )


def test_widths_are_the_papers() -> None:
    tables = (features.ROBOT_INPUTS, features.ROBOT_OUTPUTS, features.OBJECT_INPUTS, features.OBJECT_OUTPUTS)
    assert [features.width(t) for t in tables] == [28, 5, 13, 3]
    state = scene([0.1] * 24)
    assert features.robot_inputs(state, np.zeros(3, np.float32)).shape == (28,)
    assert len(features.markdown_table(features.ROBOT_INPUTS).splitlines()) == 2 + len(features.ROBOT_INPUTS)


def test_hands_on_an_aligned_face() -> None:
    state = scene([0.0] * 24)._replace(
        object_pose=np.array([REACH + HAND_RADIUS + 0.3 - 0.02, 0.0, 0.0], np.float32),
        face=np.array([-0.3, 0.0, 0.0, 0.3], np.float32),
        robot_twist=np.array([0.2, 0.0, 0.0], np.float32),
    )
    touch = features.contact(features.facing(state), 0.0)
    np.testing.assert_allclose(touch.gap, [-0.02, -0.02], atol=1e-6)
    np.testing.assert_allclose(touch.lateral, [SEPARATION / 2, -SEPARATION / 2], atol=1e-6)
    np.testing.assert_allclose(touch.rate, [-0.2, -0.2], atol=1e-6)
    steered = features.contact(features.facing(state), 0.2)
    assert steered.gap[0] < touch.gap[0] < steered.gap[1]  # positive gamma moves the left hand forward


@settings(max_examples=20, deadline=None)
@given(st.lists(number, min_size=24, max_size=24))
def test_gap_rate_is_the_derivative_of_the_gap(values: list[float]) -> None:
    state, dt = scene(values), 1e-3
    later = state._replace(
        robot_pose=state.robot_pose + dt * state.robot_twist, object_pose=state.object_pose + dt * state.object_twist
    )
    numerical = (
        features.contact(features.facing(later), 0.1).gap - features.contact(features.facing(state), 0.1).gap
    ) / dt
    np.testing.assert_allclose(features.contact(features.facing(state), 0.1).rate, numerical, atol=2e-2)


@settings(max_examples=20, deadline=None)
@given(st.lists(number, min_size=24, max_size=24), st.lists(st.floats(-3, 3, width=32), min_size=3, max_size=3))
def test_moving_the_scene_moves_the_prediction(values: list[float], by: list[float]) -> None:
    state, by_pose, u = scene(values), np.asarray(by, np.float32), np.array([0.1, -0.05, 0.1], np.float32)
    other = moved(state, by_pose)
    np.testing.assert_allclose(features.robot_inputs(state, u), features.robot_inputs(other, u), atol=2e-4)
    here, wrench = _STEP(state, u)
    there, same = _STEP(other, u)
    np.testing.assert_allclose(wrench, same, atol=1e-3)
    expected = moved(here, by_pose)
    for name in ("robot_twist", "object_twist", "last_object_twist", "last_wrench", "last_force"):
        np.testing.assert_allclose(getattr(expected, name), getattr(there, name), atol=1e-3)
    for name in ("robot_pose", "object_pose"):
        error = np.array(getattr(expected, name) - getattr(there, name))
        error[2] = se2.wrap(error[2])
        np.testing.assert_allclose(error, 0.0, atol=1e-3)


_FRESH = core.init(jax.random.key(0))
_PARAMS = _FRESH._replace(coefficients=jax.random.normal(jax.random.key(1), _FRESH.coefficients.shape))
_STEP = jax.jit(lambda state, u: core.step(_PARAMS, state, u))


@pytest.mark.parametrize("table", [features.ROBOT_INPUTS, features.OBJECT_INPUTS])
def test_slices_cover_the_vector_in_order(table: tuple[features.Entry, ...]) -> None:
    covered = [i for where in features.slices(table).values() for i in range(where.start, where.stop)]
    assert covered == list(range(features.width(table)))


@settings(max_examples=20, deadline=None)
@given(st.lists(number, min_size=13, max_size=13))
def test_inputs_tell_what_happened_a_sample_ago(values: list[float]) -> None:
    """The last wrench and both twists give back the last sample's acceleration, in the convention of the labels."""
    v = np.asarray(values, np.float32)
    last, wrench, acceleration, now = v[:3], v[3:6], v[6:9], v[9:12]
    turn = last[2] * DT + 0.5 * acceleration[2] * DT**2
    twist = se2.rotate(last + acceleration * DT, -turn)
    inputs = features.object_inputs(twist, now, last_twist=last, size=np.float32(0.4), last_wrench=wrench)
    before, happened = features.last_sample(inputs)
    np.testing.assert_allclose(happened, acceleration, atol=1e-4)
    where = features.slices(features.OBJECT_INPUTS)
    for name, expected in (("object_twist", last), ("wrench", wrench), ("size", [0.4])):
        np.testing.assert_allclose(before[where[name]], expected, rtol=1e-6)
