"""The pushing controllers that sweeps compare, as policies of `one_push` (Sec. III-E).

The MPPI controller is the one that all other code uses (control/pushing.py), with MPPI on the learned core, adaptation
and the governor.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from shmoo_mjx.arrays import Array
from shmoo_mjx.behavior.skills import one_push
from shmoo_mjx.control import push_step
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.control.presets import PushConfig, pose_push_config
from shmoo_mjx.learning.weights import Weights, prior_state
from shmoo_mjx.sweep.config import Controller


def policy_of(controller: Controller, weights: Weights, kind: str | None = None) -> one_push.PushPolicy:
    """Pushing policy of a controller in a sweep file.

    Args:
        controller: controller settings of the sweep file.
        weights: weights of the learned model.
        kind: kind of object, which selects the prior (`contact_prior.of_kind`).
    """
    config = push_config(controller)
    if controller.kind == "quasi_static":
        return one_push.quasi_static_policy(config.speed)
    model = push_step.PushModel(config, weights.config, weights.params)

    def begin(obs: ObjectObservation, task: one_push.WorldGoal, key: Array) -> Any:
        adapt = prior_state(weights, config.estimate, kind=kind)
        return push_step.start(config, adapt, obs, key, face=task.face, half_extents=task.half_extents)

    def advance(state: Any, obs: ObjectObservation, last_u: Array, task: one_push.WorldGoal) -> tuple[Array, Any]:
        return push_step.step(model, state, obs, goal=task.goal, last_u=last_u, half_extents=task.half_extents)[:2]

    return one_push.PushPolicy(begin, advance, lambda state, obs: push_step.coast(model, state.adapt, state.before))


def push_config(c: Controller) -> PushConfig:
    """Settings of the pushing controller for a controller in a sweep file."""
    base = pose_push_config()
    control = replace(base.control, num_rollouts=c.samples, horizon=c.horizon, temperature=c.temperature)
    return replace(
        base,
        control=control,
        speed=replace(base.speed, limit=c.speed_limit),
        adapts=c.adapts,
        governor=replace(base.governor, gain=c.governor),
    )
