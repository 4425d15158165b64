"""A push mapped over worlds is the push of the controller that drives one robot."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.control import push_step
from shmoo_mjx.control.observation import LocalDistanceField, ObjectObservation
from shmoo_mjx.control.presets import pose_push_config
from shmoo_mjx.control.push_step import PushModel
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.dynamics import contact_model
from shmoo_mjx.geometry.faces import faces_of, stand_off
from shmoo_mjx.learning import adaptation
from shmoo_mjx.learning.estimate import ObjectEstimate
from shmoo_mjx.learning.weights import load_weights, prior_state, untrained
from shmoo_mjx.types import DT

ROOT = Path(__file__).resolve().parents[2]
FACE, HALF = faces_of((0.3, 0.25))[0], np.array([0.3, 0.25])
GOALS = np.array([[1.0, 0.0, 0.0], [0.9, 0.3, 0.6]])


def object_obs(world: int, sample: int) -> ObjectObservation:
    rng = np.random.default_rng([world, sample])
    pose = np.array([0.02 * sample, 0.0, 0.01 * sample])
    noise = 0.01 * rng.normal(size=(5, 3))
    return ObjectObservation(
        robot_pose=stand_off(pose, FACE, 0.0) + noise[0],
        robot_twist=np.array([0.15, 0.0, 0.0]) + noise[1],
        lean=noise[2, :2],
        lean_rate=noise[2, :2],
        object_pose=pose + noise[3],
        object_twist=np.array([0.2, 0.0, 0.1]) + noise[4],
        wrench=np.array([20.0 + world, 1.0, 0.5]),
    )


@pytest.mark.slow
def test_two_mapped_pushes_are_the_two_controllers() -> None:
    weights = load_weights(ROOT / "experiments/weights/demo.safetensors")
    base = pose_push_config()
    config = replace(base, control=replace(base.control, num_rollouts=40, horizon=6))
    controller = PushController(weights, config)
    open_floor = LocalDistanceField(
        np.full((4, 4), 9.0, np.float32), np.array([-20, -20, 0], np.float32), np.float32(10.0)
    )
    keys = jax.random.split(jax.random.key(3), 2)
    prior = prior_state(weights, config.estimate, jax.random.key(5))
    alone = [controller.init(object_obs(w, 0), FACE, HALF, keys[w], adapt=prior) for w in range(2)]
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *(object_obs(w, 0) for w in range(2)))
    model = PushModel(config, weights.config, weights.params)
    together = jax.vmap(lambda now, key: push_step.start(config, prior, now, key, face=FACE, half_extents=HALF))(
        stacked, keys
    )

    def one(state: Any, now: Any, goal: Any, last_u: Any) -> Any:
        return push_step.step(model, state, now, goal=goal, last_u=last_u, half_extents=HALF)

    step, coast = jax.jit(jax.vmap(one)), jax.vmap(partial(push_step.coast, model))
    last = np.zeros((2, 3))
    for sample in range(1, 4):
        seen = [object_obs(w, sample) for w in range(2)]
        stacked = jax.tree.map(lambda *x: jnp.stack(x), *seen)
        u, together, _ = step(together, stacked, jnp.asarray(GOALS), jnp.asarray(last))
        for w in range(2):
            expected, alone[w], _ = controller.step(
                alone[w], seen[w], goal=GOALS[w], last_u=last[w], half_extents=HALF, clearance=open_floor
            )
            np.testing.assert_allclose(u[w], expected, atol=2e-5)
            np.testing.assert_allclose(
                together.adapt.parameters[w].mean(0), alone[w].adapt.parameters.mean(0), atol=1e-3, rtol=1e-3
            )
        last = np.asarray(u, dtype=float)
    assert np.abs(u[0] - u[1]).max() > 1e-3
    rest = coast(together.adapt, together.before)
    for w in range(2):
        np.testing.assert_allclose(rest[w], controller.coast(alone[w]), atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("horizon", [4, 9])
def test_a_push_is_resumed_by_a_controller_with_other_settings_of_mppi(horizon: int) -> None:
    weights, base = load_weights(ROOT / "experiments/weights/demo.safetensors"), pose_push_config()
    open_floor = LocalDistanceField(
        np.full((4, 4), 9.0, np.float32), np.array([-20, -20, 0], np.float32), np.float32(10.0)
    )
    first, second = (
        PushController(weights, replace(base, control=replace(base.control, num_rollouts=count, horizon=steps)))
        for count, steps in ((40, 6), (25, horizon))
    )

    def step(controller: PushController, state: Any, sample: int) -> Any:
        return controller.step(
            state, object_obs(0, sample), goal=GOALS[0], last_u=np.zeros(3), half_extents=HALF, clearance=open_floor
        )

    _, state, _ = step(first, first.init(object_obs(0, 0), FACE, HALF, jax.random.key(0)), 1)
    resumed = second.resumed(state)
    np.testing.assert_array_equal(resumed.plan.nominal[:4], state.plan.nominal[:4])
    np.testing.assert_array_equal(resumed.plan.nominal[-1], state.plan.nominal[min(horizon, 6) - 1])
    np.testing.assert_array_equal(resumed.adapt.parameters, state.adapt.parameters)
    u, _, plan = step(second, resumed, 2)
    assert plan.controls.shape == (25, horizon, 3) and np.isfinite(u).all()


@pytest.mark.parametrize("age", [0.0, 0.05])
def test_what_is_seen_late_answers_to_what_was_felt_a_sample_before(age: float) -> None:
    config, yaw = pose_push_config(), 0.4
    forces = [np.array([f, 0.0, 0.0]) for f in (9.0, 17.0, 25.0)]
    pose = np.array([0.0, 0.0, yaw])
    seen = [object_obs(0, 0)._replace(age=age, wrench=f, object_pose=pose) for f in forces]
    nothing = adaptation.init(np.zeros(3), np.eye(3), np.eye(3))
    state = push_step.start(config, nothing, seen[0], jax.random.key(0), face=FACE, half_extents=HALF)
    for obs, earlier in zip(seen[1:], forces, strict=False):
        inputs = push_step.step_inputs(config, state, obs, goal=GOALS[0], last_u=np.zeros(3), half_extents=HALF)
        system, learned = inputs.system, inputs.transition
        answered = earlier if age else obs.wrench
        np.testing.assert_allclose(learned.inputs[3:5], answered[0] * np.array([np.cos(yaw), -np.sin(yaw)]), rtol=1e-5)
        state = state._replace(before=system)


@pytest.mark.parametrize(("force", "detected", "counts"), [(9.0, True, True), (0.0, True, False), (9.0, False, False)])
def test_only_what_is_felt_and_seen_is_learned_from(force: float, detected: bool, counts: bool) -> None:
    rolling = object_obs(0, 0)._replace(object_twist=np.array([0.3, 0.0, 0.0]), wrench=np.array([force, 0.0, 0.0]))
    nothing = adaptation.init(np.zeros(3), np.eye(3), np.eye(3))
    config = pose_push_config()
    state = push_step.start(config, nothing, rolling, jax.random.key(0), face=FACE, half_extents=HALF)
    obs = rolling._replace(detected=np.array(detected))
    inputs = push_step.step_inputs(config, state, obs, goal=GOALS[0], last_u=np.zeros(3), half_extents=HALF)
    assert bool(inputs.transition.valid) == counts


@pytest.mark.parametrize("friction", [0.02, 0.05])
@pytest.mark.parametrize("speed", [0.1, 0.2])
def test_what_is_let_go_coasts_as_far_as_the_friction_of_its_contacts_lets_it(friction: float, speed: float) -> None:
    weights, config, heading = untrained(), pose_push_config(), 0.7
    shift = float(np.log(friction) - contact_model.GUESS["log_friction_x_front_left"])
    adapt = prior_state(weights)
    assert isinstance(adapt, ObjectEstimate)
    adapt = adapt._replace(parameters=contact_model.with_friction(adapt.parameters, shift))
    along = np.array([np.cos(heading), np.sin(heading), 0.0])
    now = object_obs(0, 0)._replace(object_pose=np.array([1.0, 2.0, heading]), object_twist=speed * along)
    state = push_step.start(config, adapt, now, jax.random.key(0), face=FACE, half_extents=HALF)
    rest = push_step.coast(PushModel(config, weights.config, weights.params), adapt, state.before)
    way = speed**2 / (2 * friction * 9.81)
    # It stops within a sample, which the trapezoidal rule does not see.
    np.testing.assert_allclose(rest - now.object_pose, way * along, atol=0.6 * friction * 9.81 * DT**2)


@pytest.mark.slow
def test_what_a_wall_holds_is_not_learned_as_friction() -> None:
    weights = load_weights(ROOT / "experiments/weights/demo.safetensors")
    base = pose_push_config()
    config = replace(base, control=replace(base.control, num_rollouts=8, horizon=3))
    prior = prior_state(weights, config.estimate, jax.random.key(5))
    step = jax.jit(partial(push_step.step, PushModel(config, weights.config, weights.params)))

    def known(clearance: float) -> ObjectEstimate:
        field = LocalDistanceField(
            jnp.full((4, 4), clearance, jnp.float32), jnp.array([-20, -20, 0], jnp.float32), jnp.float32(10.0)
        )
        state = push_step.start(config, prior, object_obs(0, 0), jax.random.key(3), face=FACE, half_extents=HALF)
        for sample in range(1, 6):
            now = object_obs(0, sample)
            _, state, _ = step(state, now, goal=GOALS[0], last_u=np.zeros(3), half_extents=HALF, clearance=field)
        return state.adapt

    np.testing.assert_array_equal(known(0.02).parameters, prior.parameters)
    assert np.abs(known(0.5).parameters - prior.parameters).max() > 0.1
