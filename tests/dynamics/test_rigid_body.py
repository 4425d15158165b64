"""The hand-written body: laws that any rigid body keeps."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.dynamics import rigid_body
from shmoo_mjx.dynamics.rigid_body import GRAVITY, Body
from shmoo_mjx.hands import HAND_RADIUS, REACH
from shmoo_mjx.types import SystemState


def touching(compression: float = 0.0, twist: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> SystemState:
    z = np.zeros
    pose = np.array([REACH + HAND_RADIUS + 0.3 - compression, 0.0, 0.0])
    return SystemState(
        z(3), z(3), z(2), z(2), pose, np.array(twist), z(3), z(3), z(2), z(3), np.array([-0.3, 0, 0, 0.25]), 0.39
    )


def test_a_coasting_body_stops_where_friction_says() -> None:
    far = touching(-1.0, (0.6, 0.0, 0.0))
    states, wrenches = rigid_body.rollout(Body(friction=0.1), far, jnp.zeros((15, 3)))
    np.testing.assert_array_equal(wrenches, 0.0)
    distance = float(states.object_pose[-1, 0] - far.object_pose[0])
    assert distance == pytest.approx(0.6**2 / (2 * 0.1 * GRAVITY), abs=0.005)
    np.testing.assert_array_equal(states.object_twist[-1], 0.0)


def test_a_push_that_friction_can_hold_moves_nothing() -> None:
    controls = jnp.broadcast_to(jnp.array([0.04, 0.0, 0.0]), (30, 3))
    moved = {}
    for mass in (5.0, 60.0):
        states, wrenches = rigid_body.rollout(Body(mass=mass, friction=0.4), touching(), controls)
        moved[mass] = float(states.object_pose[-1, 0] - touching().object_pose[0])
        if mass > 50:  # it stands: the hands press with what the lean gives
            assert float(wrenches[-1, 0]) == pytest.approx(40.0 * GRAVITY * 0.04, rel=0.05)
    assert moved[5.0] < 0.05 and abs(moved[60.0]) < 1e-3  # 19.6 N and 235 N of friction against 15.7 N
    light, _ = rigid_body.rollout(Body(mass=2.0, friction=0.4), touching(), controls)
    assert float(light.object_pose[-1, 0] - touching().object_pose[0]) > 0.2


def test_momentum_is_kept_between_robot_and_object() -> None:
    body = Body(friction=0.0, damping=0.0)
    state = touching(0.02)._replace(robot_twist=np.array([0.3, 0.0, 0.0]))
    states, _ = rigid_body.rollout(body, state, jnp.zeros((10, 3)))
    total = body.robot_mass * states.robot_twist[:, 0] + body.mass * states.object_twist[:, 0]
    np.testing.assert_allclose(total, body.robot_mass * 0.3, rtol=1e-4)
    assert float(states.object_twist[-1, 0]) > 0.3


@pytest.mark.parametrize(("gamma", "sign"), [(0.3, -1.0), (-0.3, 1.0)])
def test_steering_turns_the_object(gamma: float, sign: float) -> None:
    controls = jnp.broadcast_to(jnp.array([0.06, 0.0, gamma]), (20, 3))
    states, _ = rigid_body.rollout(Body(), touching(), controls)
    assert sign * float(states.object_pose[-1, 2]) > 0.1


def test_step_batch_and_gradient_agree_with_the_rollout() -> None:
    controls = 0.1 * jax.random.normal(jax.random.key(0), (4, 6, 3))
    many, _ = jax.jit(lambda u: rigid_body.rollout(Body(), touching(), u))(controls)
    now = touching()
    for u in controls[1]:
        now, _ = rigid_body.step(Body(), now, u)
    np.testing.assert_allclose(many.object_pose[1, -1], now.object_pose, atol=1e-5)
    assert now.size.shape == () and now.object_pose.shape == (3,)

    def end(mass: jax.Array) -> jax.Array:
        return rigid_body.rollout(Body(mass=mass), touching(0.02), controls[1])[0].object_twist[0, 0]

    slope = float(jax.grad(end)(jnp.array(8.0)))
    assert slope == pytest.approx(float(end(jnp.array(8.05)) - end(jnp.array(7.95))) / 0.1, rel=0.05)
    assert slope < 0
