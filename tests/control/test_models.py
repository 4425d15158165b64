"""MPPI on the learned core, as anybody plans with it."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import numpy as np
import pytest

from shmoo_mjx.control import cost, models, mppi
from shmoo_mjx.dynamics import core
from shmoo_mjx.geometry.hands import HAND_RADIUS, REACH
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.types import SystemState

FACE = np.array([-0.3, 0.0, 0.0, 0.25], np.float32)
CFG = mppi.MppiConfig(
    num_rollouts=24, horizon=8, cost_scale=200.0, sigma=(0.05, 0.02, 0.1), low=(-0.15,) * 3, high=(0.15,) * 3
)
GOAL = np.array([1.2, 0.0, 0.0])
COST = cost.push_cost(cost.PushCost(yaw_weight=0.0, effort=0.001, change=0.001), GOAL)


def start() -> SystemState:
    z = np.zeros
    pose = np.array([REACH + HAND_RADIUS + 0.3, 0.0, 0.0])
    values = SystemState(z(3), z(3), z(2), z(2), pose, z(3), z(3), z(3), z(2), z(3), FACE, np.array(0.39))
    return SystemState(*(np.asarray(v, np.float32) for v in values))


def test_a_model_starts_from_a_state() -> None:
    model = models.learned(core.init(jax.random.key(0)))
    run = jax.jit(partial(mppi.plan, CFG, model, COST))
    u, _, plan = run(start(), state=mppi.init(CFG, jax.random.key(1)))
    assert bool(plan.ok) and np.isfinite(u).all()
    assert {k: v.shape[:2] for k, v in plan.trajectories._asdict().items()} == dict.fromkeys(
        SystemState._fields, (24, 8)
    )


@pytest.mark.slow
def test_mppi_pushes_the_object_forward() -> None:
    weights = load_weights()
    model = models.learned(weights.params, weights.config)

    def pushed(key: Any) -> Any:
        def sample(carry: Any, _: None) -> Any:
            now, state = carry
            u, state, _ = mppi.plan(CFG, model, COST, now, state=state)
            return (jax.tree.map(lambda x: x[0, 0], model(now, u[None, None])), state), None

        (now, _), _ = jax.lax.scan(sample, (start(), mppi.init(CFG, key)), length=20)
        return now.object_pose[0] - start().object_pose[0]

    # Few roll-outs make some plans poor.
    assert float(np.mean(jax.jit(jax.vmap(pushed))(jax.random.split(jax.random.key(2), 8)))) > 0.12
