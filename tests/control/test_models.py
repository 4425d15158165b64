"""One MPPI, three models: the learned core, the rigid body and the simulator stand in the same place."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from shmoo_mjx.control import cost, models, mppi
from shmoo_mjx.dynamics import core
from shmoo_mjx.dynamics.rigid_body import Body
from shmoo_mjx.hands import HAND_HEIGHT, HAND_RADIUS, REACH
from shmoo_mjx.plant.engine_mujoco import MujocoEngine
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.scene import build_scene
from shmoo_mjx.types import Command, SystemState

FACE = np.array([-0.3, 0.0, 0.0, 0.25], np.float32)
CFG = mppi.MppiConfig(
    samples=24, horizon=8, cost_scale=200.0, sigma=(0.05, 0.02, 0.1), low=(-0.15,) * 3, high=(0.15,) * 3
)
GOAL = np.array([1.2, 0.0, 0.0])
COST = partial(cost.push_cost, cost.PushCost(yaw_weight=0.0, effort=0.001, change=0.001), GOAL)


def start() -> SystemState:
    z = np.zeros
    pose = np.array([REACH + HAND_RADIUS + 0.3, 0.0, 0.0])
    values = SystemState(z(3), z(3), z(2), z(2), pose, z(3), z(3), z(3), z(2), z(3), FACE, np.array(0.39))
    return SystemState(*(np.asarray(v, np.float32) for v in values))


MODELS = {"learned": models.learned(core.init(jax.random.key(0))), "rigid": models.rigid(Body())}


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_models_that_start_from_a_state(model: Any) -> None:
    run = jax.jit(partial(mppi.plan, CFG, model, COST))
    u, _, plan = run(start(), mppi.init(CFG, jax.random.key(1)))
    assert bool(plan.ok) and np.isfinite(u).all()
    assert {k: v.shape[:2] for k, v in plan.trajectories._asdict().items()} == dict.fromkeys(
        SystemState._fields, (24, 8)
    )


def test_mppi_pushes_the_rigid_body_forward() -> None:
    def pushed(key: Any) -> Any:
        def sample(carry: Any, _: None) -> Any:
            now, state = carry
            u, state, _ = mppi.plan(CFG, MODELS["rigid"], COST, now, state)
            return (jax.tree.map(lambda x: x[0, 0], MODELS["rigid"](now, u[None, None])), state), None

        (now, _), _ = jax.lax.scan(sample, (start(), mppi.init(CFG, key)), length=8)
        return now.object_pose[0] - start().object_pose[0]

    # Few roll-outs make some plans poor.
    assert float(np.mean(jax.jit(jax.vmap(pushed))(jax.random.split(jax.random.key(2), 8)))) > 0.06


def test_the_simulator_is_a_model_too() -> None:
    condition = draw_condition("box", 3)
    pose = (REACH + HAND_RADIUS + condition.half_extents[0] + 0.01, 0.0, 0.0)
    scene = build_scene([(condition, pose)])
    engine = MujocoEngine([scene])
    held = (np.zeros(1), np.full(1, REACH), np.full(1, HAND_HEIGHT))
    world, seen = engine.init(), None
    for _ in range(10):
        world, seen = engine.step(world, Command(np.zeros((1, 3)), *held))
    face = np.array([-condition.half_extents[0], 0.0, 0.0, condition.half_extents[1]])
    model = models.simulator(scene, face)
    controls = np.zeros((3, 6, 3))
    controls[1, :, 0], controls[2, :, 0] = 0.1, -0.1
    states = model(world, controls)
    # A roll-out is what the engine does with the same commands.
    for t in range(6):
        world, seen = engine.step(world, Command(controls[1, t][None], *held))
        np.testing.assert_allclose(states.object_pose[1, t], seen.object_pose[0, 0], atol=1e-6)
        np.testing.assert_allclose(states.robot_twist[1, t], seen.robot_twist[0], atol=1e-6)
    engine.close()
    assert states.robot_pose[1, -1, 0] > states.robot_pose[0, -1, 0] > states.robot_pose[2, -1, 0]
    cfg = mppi.MppiConfig(samples=6, horizon=4, cost_scale=200.0)
    _, _, plan = mppi.plan(cfg, model, COST, world, mppi.init(cfg, jax.random.key(3)))
    assert bool(plan.ok) and plan.trajectories.object_pose.shape == (6, 4, 3)
    assert float(jnp.ptp(plan.costs)) > 0
