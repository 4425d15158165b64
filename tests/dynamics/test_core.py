"""The transition: integration, contact rules, batching, gradients."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from shmoo_mjx.dynamics import CoreConfig, ObjectConfig, Params, contact_wrench, core, features, robot_model
from shmoo_mjx.geometry.hands import HAND_RADIUS, REACH
from shmoo_mjx.types import DT, SystemState

CONFIG = CoreConfig(object=ObjectConfig(functions=6, per_axis=False, contact_model=False))
SHAPE = (3, ObjectConfig().functions)
"""Of the default coefficients."""


def touching(compression: float = 0.02, speed: float = 0.0) -> SystemState:
    z = jnp.zeros
    pose = jnp.array([REACH + HAND_RADIUS + 0.3 - compression, 0.0, 0.0])
    twist = jnp.array([speed, 0.0, 0.0])
    face = jnp.array([-0.3, 0.0, 0.0, 0.3])
    return SystemState(z(3), z(3), z(2), z(2), pose, twist, twist, z(3), z(2), z(3), face, jnp.array(0.42))


def hand_made(force: float, gain: float) -> Params:
    """R that always says ``force`` along x and a robot at rest; psi = wrench (scaled), so a is one over the inertia."""
    params = core.init(jax.random.key(0), CONFIG)
    robot_net = params.robot.net._replace(layers=jax.tree.map(jnp.zeros_like, params.robot.net.layers))
    robot = params.robot._replace(net=robot_net, output_mean=jnp.array([0.0, 0.0, 0.0, force, 0.0]))
    where = features.slices(features.OBJECT_INPUTS)["wrench"]
    linear = jnp.zeros((13, 6)).at[where, :3].set(jnp.eye(3))
    net = params.object.net._replace(layers=jax.tree.map(jnp.zeros_like, params.object.net.layers))
    a = jnp.zeros((3, 6)).at[:, :3].set(gain * jnp.eye(3))
    return Params(robot, params.object._replace(net=net, linear=linear), a, params.contact)


LINEAR = replace(CONFIG, object=replace(CONFIG.object, linear_terms=True))


def test_positions_integrate_the_acceleration() -> None:
    free = replace(LINEAR, unilateral=False)
    state, params = touching(), hand_made(force=10.0, gain=0.1)
    new, wrench = core.step(params, state, jnp.zeros(3), free)
    np.testing.assert_allclose(wrench, [10.0, 0.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(new.object_twist, [1.0 * DT, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(new.object_pose - state.object_pose, [0.5 * DT**2, 0.0, 0.0], atol=1e-6)
    literal, _ = core.step(params, state, jnp.zeros(3), replace(free, euler=True))
    np.testing.assert_allclose(literal.object_pose, state.object_pose)


def test_a_light_object_does_not_outrun_the_hand() -> None:
    state, params = touching(compression=0.01), hand_made(force=50.0, gain=0.5)
    flung, _ = core.step(params, state, jnp.zeros(3), replace(LINEAR, unilateral=False))
    held, _ = core.step(params, state, jnp.zeros(3), LINEAR)
    assert flung.object_twist[0] > 2.0
    np.testing.assert_allclose(held.object_twist[0], 0.01 / DT, atol=1e-5)
    np.testing.assert_allclose(held.object_twist[2], 0.0, atol=1e-5)


def test_a_heavy_or_a_coasting_object_is_left_alone() -> None:
    heavy = hand_made(force=50.0, gain=0.01)
    for state in (touching(0.02), touching(0.0, speed=0.5)):
        with_rule, _ = core.step(heavy, state, jnp.zeros(3), LINEAR)
        without, _ = core.step(heavy, state, jnp.zeros(3), replace(LINEAR, unilateral=False))
        if state.object_twist[0] == 0:
            np.testing.assert_allclose(with_rule.object_twist, without.object_twist, atol=1e-6)
        else:
            np.testing.assert_allclose(with_rule.object_twist[0], 0.5, atol=1e-5)


def test_hands_out_of_reach_push_nothing() -> None:
    params = hand_made(force=50.0, gain=0.1)
    new, wrench = core.step(params, touching(compression=-0.05), jnp.zeros(3), LINEAR)
    np.testing.assert_array_equal(wrench, 0.0)
    np.testing.assert_array_equal(new.object_twist, 0.0)
    aside = touching()._replace(object_pose=touching().object_pose.at[1].set(1.0))
    np.testing.assert_array_equal(core.step(params, aside, jnp.zeros(3), LINEAR)[1], 0.0)


@pytest.mark.parametrize(("gamma", "sign"), [(0.2, -1.0), (-0.2, 1.0), (0.0, 0.0)])
def test_steering_turns_the_object(gamma: float, sign: float) -> None:
    """Positive gamma presses the left hand, which turns the object to the right."""
    wrench = contact_wrench(touching(), jnp.array([10.0, 0.0]), jnp.asarray(gamma))
    assert np.sign(np.round(wrench[2], 4)) == sign
    assert abs(wrench[2]) <= 10.0 * 0.18 + 1e-3


def test_a_lag_is_exact_for_any_damping() -> None:
    for w, zeta in ((6.0, 0.3), (6.0, 1.0), (6.0, 3.0), (60.0, 0.7)):
        lean, rate, u = np.array([0.05, -0.1]), np.array([0.3, 0.2]), np.array([0.1, 0.0])
        new, new_rate = robot_model.lean_step(robot_model.lag(w, zeta), lean, rate, target=u, force=np.zeros(2))
        matrix = expm(np.array([[0, 1], [-(w**2), -2 * zeta * w]]) * DT)
        expected = matrix @ np.stack([lean - u, rate])
        np.testing.assert_allclose(new - u, expected[0], atol=1e-5)
        np.testing.assert_allclose(new_rate, expected[1], atol=1e-4)


@pytest.mark.slow
def test_rollout_is_step_repeated_and_batches() -> None:
    params = core.init(jax.random.key(0))._replace(coefficients=0.3 * jax.random.normal(jax.random.key(2), SHAPE))
    controls = 0.1 * jax.random.normal(jax.random.key(1), (4, 6, 3))
    state = touching()
    one, step = state, jax.jit(core.step)
    for u in controls[0]:
        one, _ = step(params, one, u)
    states, wrenches = jax.jit(jax.vmap(lambda c: core.rollout(params, state, c)))(controls)
    assert states.object_pose.shape == (4, 6, 3) and wrenches.shape == (4, 6, 3)
    np.testing.assert_allclose(states.object_pose[0, -1], one.object_pose, atol=1e-5)
    np.testing.assert_allclose(states.robot_twist[0, -1], one.robot_twist, atol=1e-5)
    over_coefficients = jax.jit(
        jax.vmap(lambda a: core.rollout(params._replace(coefficients=a), state, controls[0])[0])
    )
    batch = jnp.stack([params.coefficients, 0 * params.coefficients])
    np.testing.assert_allclose(over_coefficients(batch).object_pose[0, -1], one.object_pose, atol=1e-5)


@pytest.mark.slow
def test_rollout_is_differentiable() -> None:
    params = core.init(jax.random.key(0))._replace(coefficients=0.3 * jax.random.normal(jax.random.key(2), SHAPE))

    def end(a: jax.Array, controls: jax.Array) -> jax.Array:
        return core.rollout(params._replace(coefficients=a), touching(), controls)[0].object_pose[-1, 0]

    gradients = jax.jit(jax.grad(end, argnums=(0, 1)))(params.coefficients, jnp.full((5, 3), 0.05))
    assert all(bool(jnp.all(jnp.isfinite(g))) for g in gradients)
    assert float(jnp.max(jnp.abs(gradients[0]))) > 0


def test_compiles_once() -> None:
    params, traces = core.init(jax.random.key(0)), []

    @jax.jit
    def run(state: SystemState, controls: jax.Array) -> jax.Array:
        traces.append(1)
        return core.rollout(params, state, controls)[1]

    for compression in (0.0, 0.02):
        run(touching(compression), jnp.zeros((3, 3)))
    assert len(traces) == 1
