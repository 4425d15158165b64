"""The fast layout of the transition against the same transition written plainly, one number at a time."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.dynamics import CoreConfig, ObjectConfig, Params, RobotConfig, core, features, object_model, robot_model
from shmoo_mjx.dynamics.networks import Network, parts
from shmoo_mjx.geometry.hands import HAND_RADIUS, hand_targets
from shmoo_mjx.types import DT, SystemState


def random_params(config: CoreConfig) -> Params:
    """Untrained networks with a normaliser, biases and scales that are not trivial."""
    params, keys = core.init(jax.random.key(0), config), iter(jax.random.split(jax.random.key(1), 20))

    def dress(net: Network, kept: np.ndarray) -> Network:
        layers = {
            name: layer | {"bias": 0.1 * jax.random.normal(next(keys), layer["bias"].shape)}
            for name, layer in net.layers.items()
        }
        mean = kept @ (0.1 * jax.random.normal(next(keys), net.mean.shape))
        scale = np.abs(kept) @ (1.0 + 0.5 * jax.random.uniform(next(keys), net.scale.shape))
        return net._replace(layers=layers, mean=mean, scale=jnp.where(scale > 0, scale, 1.0))

    scale = jnp.array([1.0, 1.0, 0.5, 20.0, 10.0])
    robot_net = dress(params.robot.net, parts(robot_model.REFLECTIONS[0])[0])
    robot = params.robot._replace(net=robot_net, output_scale=scale, output_mean=0.1 * scale)
    seen = len(params.object.net.mean)
    kept = parts(object_model.reflections(config.object)[0])[0] if config.object.equivariant else np.eye(seen)
    contact = params.object._replace(net=dress(params.object.net, kept), label_scale=jnp.array([1.0, 0.7, 2.0]))
    return Params(robot, contact, 0.2 * jax.random.normal(next(keys), params.coefficients.shape), params.contact)


def random_state(rng: np.random.Generator) -> SystemState:
    def some(n: int, size: float) -> np.ndarray:
        return size * rng.standard_normal(n)

    pose = some(3, 0.3)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    ahead = np.array([0.74 + some(1, 0.03)[0], some(1, 0.05)[0]])
    object_pose = np.array(
        [pose[0] + c * ahead[0] - s * ahead[1], pose[1] + s * ahead[0] + c * ahead[1], pose[2] + 0.1]
    )
    values = SystemState(
        pose, some(3, 0.2), some(2, 0.05), some(2, 0.1), object_pose, some(3, 0.2), some(3, 0.2), some(3, 5.0),
        some(2, 5.0), some(3, 0.1), np.array([-0.3, 0.03, 0.1, 0.25]), np.array(0.39),
    )  # fmt: skip
    return SystemState(*(np.asarray(v, np.float32) for v in values))


def plain_step(params: Params, state: SystemState, u: np.ndarray, config: CoreConfig) -> tuple[dict, np.ndarray]:
    """The transition of `core.step` for one state, in float64, by matrices and loops over the hands."""
    s = {k: np.asarray(v, float) for k, v in state._asdict().items()}
    rot = lambda a: np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])  # noqa: E731
    into = lambda a, v: np.array([*(rot(a) @ v[:2]), *v[2:]])  # noqa: E731
    heading, yaw, face = s["robot_pose"][2], s["object_pose"][2], s["face"]
    inputs = np.asarray(features.robot_inputs(state, u.astype(np.float32)), float)
    out = np.asarray(NORMALISED(params.robot.net, inputs.astype(np.float32), config.robot), float)
    out = out * np.asarray(params.robot.output_scale) + np.asarray(params.robot.output_mean)
    base, force = out[:3], out[3:]

    lever = rot(yaw) @ face[:2]
    to_face = s["object_pose"][:2] + lever - s["robot_pose"][:2]
    centre, angle = rot(-heading) @ to_face, yaw + face[2] - heading
    cross = lambda w, v: w * np.array([-v[1], v[0]])  # noqa: E731
    moving = s["object_twist"][:2] + cross(s["object_twist"][2], lever)
    moving = rot(-heading) @ (moving - s["robot_twist"][:2] - cross(s["robot_twist"][2], to_face))
    spin = s["object_twist"][2] - s["robot_twist"][2]
    normal, tangent = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    hands = np.asarray(hand_targets(u[2]))
    gap = np.array([(centre - h) @ normal - HAND_RADIUS for h in hands])
    along = np.array([(centre - h) @ tangent for h in hands])
    rate, lateral = moving @ normal + spin * along, -along
    nearest, beside = np.minimum(gap, gap + DT * rate), np.abs(lateral) > face[3] + HAND_RADIUS
    if np.all((nearest > config.open_gap) | beside):
        force = np.zeros(2)
    weight = np.maximum(-(gap + config.pressure_lead * DT * rate), 0) + 1e-4
    at = np.sum(weight * np.clip(lateral, -face[3], face[3])) / weight.sum()
    point = face[:2] + at * np.array([-math.sin(face[2]), math.cos(face[2])])
    f = rot(heading - yaw) @ force
    wrench = np.array([*f, point[0] * f[1] - point[1] * f[0]])

    twist = into(-yaw, s["object_twist"])
    psi_inputs = np.asarray(
        features.object_inputs(
            twist, wrench, last_twist=s["last_object_twist"], size=s["size"], last_wrench=s["last_wrench"]
        ),
        np.float32,
    )
    push = np.asarray(
        PREDICTED(params.object, params.coefficients, psi_inputs, config.object, contact=params.contact), float
    )
    if config.unilateral:
        n = np.array([math.cos(face[2]), math.sin(face[2])])
        arm = face[0] * n[1] - face[1] * n[0] - lateral
        after = into(-heading, s["robot_twist"]) + base * DT
        excess = np.zeros(2)
        for i in range(2):
            hand = after[:2] + cross(after[2], hands[i])
            before = twist[:2] @ n + twist[2] * arm[i]
            gain = (push[:2] @ n + push[2] * arm[i]) * DT
            release = hand @ normal + max(-gap[i], 0) / DT
            if force @ normal > 0 and nearest[i] <= max(nearest.min(), 0) and not beside[i]:
                excess[i] = max(before + gain - max(release, before), 0)
        between = lateral[0] - lateral[1]
        turn = (excess[0] - excess[1]) / (between if abs(between) >= 0.1 else 0.1)
        push = push + np.array([*(-(excess[0] + arm[0] * turn) * n), turn]) / DT

    robot_acceleration, object_acceleration = into(heading, base), into(yaw, push)
    columns = np.stack([s["lean"], s["lean_rate"], u[:2], s["last_force"], np.ones(2)])
    lean = np.einsum("ark,ka->ra", np.asarray(params.robot.lean.matrix, float), columns)
    half = 0 if config.euler else 0.5 * DT**2
    return {
        "robot_pose": s["robot_pose"] + s["robot_twist"] * DT + half * robot_acceleration,
        "robot_twist": s["robot_twist"] + robot_acceleration * DT,
        "lean": lean[0],
        "lean_rate": lean[1],
        "object_pose": s["object_pose"] + s["object_twist"] * DT + half * object_acceleration,
        "object_twist": s["object_twist"] + object_acceleration * DT,
        "last_object_twist": twist,
        "last_wrench": wrench,
        "last_force": force,
        "last_u": u,
    }, wrench


# Not jitted, each call would compile the contact model's loop anew.
NORMALISED = jax.jit(robot_model.normalised, static_argnums=2)
PREDICTED = jax.jit(object_model.predict, static_argnums=3)
ROLLED_OUT = jax.jit(core.rollout, static_argnums=3)

CONFIGS = [
    CoreConfig(),
    CoreConfig(unilateral=False, euler=True, object=ObjectConfig.paper()),
    CoreConfig(robot=RobotConfig(activation="tanh"), object=ObjectConfig(activation="silu", hidden=(16,), functions=3)),
]
EACH = [
    pytest.param(CONFIGS[0], id="shipped"),
    pytest.param(CONFIGS[1], id="paper", marks=pytest.mark.slow),
    pytest.param(CONFIGS[2], id="other", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("config", EACH)
def test_step_agrees_with_the_plain_transition(config: CoreConfig) -> None:
    params, rng = random_params(config), np.random.default_rng(2)
    states = [random_state(rng) for _ in range(25)]
    commands = 0.15 * rng.standard_normal((25, 3)).astype(np.float32)
    batch = jax.tree.map(lambda *x: np.stack(x), *states)
    new, wrenches = jax.jit(lambda s, u: core.step(params, s, u, config))(batch, commands)
    pushing = 0
    for i, (state, u) in enumerate(zip(states, commands, strict=True)):
        expected, wrench = plain_step(params, state, u, config)
        scale = max(1.0, np.abs(wrench).max())
        np.testing.assert_allclose(wrenches[i], wrench, atol=1e-5 * scale)
        for name, value in expected.items():
            np.testing.assert_allclose(getattr(new, name)[i], value, atol=1e-5 * scale, err_msg=name)
        pushing += bool(np.any(wrench))
    assert pushing > 8


@pytest.mark.slow
def test_rollouts_in_one_call_are_steps_one_by_one() -> None:
    config, rng = CoreConfig(), np.random.default_rng(3)
    params, state = random_params(config), random_state(rng)
    controls = 0.1 * rng.standard_normal((5, 4, 8, 3)).astype(np.float32)
    together = jax.jit(lambda u: core.rollout(params, state, u, config))(controls)
    single = jax.jit(jax.vmap(jax.vmap(lambda u: core.rollout(params, state, u, config))))(controls)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=2e-4), together, single)
    step = jax.jit(lambda s, u: core.step(params, s, u, config))
    now = state
    for t in range(8):
        now, wrench = step(now, controls[2, 3, t])
        for name in SystemState._fields:
            seen = getattr(together[0], name)[2, 3, t]
            np.testing.assert_allclose(seen, getattr(now, name), atol=2e-4, err_msg=name)
        np.testing.assert_allclose(together[1][2, 3, t], wrench, atol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("config", CONFIGS, ids=["shipped", "paper", "other"])
def test_folding_changes_no_prediction(config: CoreConfig) -> None:
    params = random_params(config)
    x = np.random.default_rng(4).standard_normal((7, 13)).astype(np.float32)
    x[:, 9] = 0.4
    expected = PREDICTED(params.object, params.coefficients, x, config.object, contact=params.contact)
    fused = object_model.fuse(params.object, params.coefficients, config.object, contact=params.contact)
    before = object_model.remembered(x.T, config.object, contact=params.contact)
    said = object_model.forward(fused, x.T, config.object, before)[0]
    np.testing.assert_allclose(said.T, expected, atol=1e-5)
    assert fused.layers.biases[-1].shape == (3,)


@pytest.mark.slow
def test_the_state_s_own_batch_and_the_controls_combine() -> None:
    """A batch of states with faces of their own, each with its own controls."""
    config, rng = CoreConfig(), np.random.default_rng(5)
    params = random_params(config)
    states = [random_state(rng)._replace(face=np.array([-0.3, 0.0, 0.0, 0.2 + 0.02 * i], np.float32)) for i in range(3)]
    controls = 0.1 * rng.standard_normal((3, 5, 3)).astype(np.float32)
    batch = jax.tree.map(lambda *x: np.stack(x), *states)
    together, _ = ROLLED_OUT(params, batch, controls, config)
    for i in range(3):
        alone, _ = ROLLED_OUT(params, states[i], controls[i], config)
        np.testing.assert_allclose(together.object_pose[i], alone.object_pose, atol=2e-4)
        np.testing.assert_array_equal(together.face[i], alone.face)
