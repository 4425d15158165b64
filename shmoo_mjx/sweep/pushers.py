"""The pushing controllers as pure functions of one world, to be mapped over many (Sec. III-E).

The paper's controller is the one that runs everywhere else (control/pushing.py): MPPI on the learned core, adaptation
and the governor. What the pushing task does round it is here as well, for one push on one face: creep forward until the
hands feel the object, push, let go in time for the object to coast into its goal, back away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx.control import pushing, quasi_static
from shmoo_mjx.control.pushing import PushConfig, Sighting
from shmoo_mjx.learning.weights import Weights, prior_state
from shmoo_mjx.navigation.push_task import pose_push_config
from shmoo_mjx.skills import contact, hold, retreat
from shmoo_mjx.skills.push import lets_go
from shmoo_mjx.sweep.config import Controller
from shmoo_mjx.types import Array, Command

__all__ = [
    "APPROACH",
    "DONE",
    "FELL",
    "LET_GO",
    "PUSH",
    "UNSTABLE",
    "Law",
    "Memory",
    "Task",
    "decide",
    "law_of",
    "push_config",
    "remember",
]

APPROACH, PUSH, LET_GO, DONE, FELL, UNSTABLE = range(6)
"""Phases of a push; from DONE on nothing happens any more."""


class Task(NamedTuple):
    """What is asked of a world's robot."""

    face: Array
    """``[4]``"""
    half_extents: Array
    """``[2]``"""
    goal: Array
    """``[3]`` in {W}"""


class Law(NamedTuple):
    """A pushing controller; its state is any pytree."""

    init: Callable[[Sighting, Task, Array], Any]
    """(what is perceived, task, key) -> state"""
    step: Callable[[Any, Sighting, Array, Task], tuple[Array, Any]]
    """(state, what is perceived, the command of the last sample, task) -> command ``[3]``, state"""
    coast: Callable[[Any, Sighting], Array]
    """(state, what is perceived) -> where the object comes to rest if it is let go now ``[3]``"""


class Memory(NamedTuple):
    """Memory of one push."""

    law: Any
    contact: contact.ContactState
    phase: Array
    last_u: Array
    """``[3]``"""
    coasts: Array
    """``[5]`` how far the object would have coasted on in the last samples [m]."""


def law_of(controller: Controller, weights: Weights) -> Law:
    """The controller that a sweep file asks for."""
    config = push_config(controller)
    if controller.kind == "quasi_static":
        return Law(
            init=lambda now, task, key: jnp.zeros(()),
            step=lambda more, now, last_u, task: quasi_static.law(config.cost, task.face, now, task.goal, more),
            coast=lambda state, now: now.object_pose,
        )
    core, params = weights.config, weights.params

    def init(now: Sighting, task: Task, key: Array) -> Any:
        adapt = prior_state(weights, config.adapt.contact)
        return pushing.start(config, adapt, now, task.face, task.half_extents, key)

    def step(state: Any, now: Sighting, last_u: Array, task: Task) -> tuple[Array, Any]:
        return pushing.control_step(config, core, params, state, now, last_u, task.goal, task.half_extents)

    return Law(init, step, lambda state, now: pushing.coast(config, core, params, state.adapt, state.before))


def push_config(c: Controller) -> PushConfig:
    """The settings of the pushing controller that a sweep file asks for."""
    base = pose_push_config()
    control = replace(base.control, num_rollouts=c.samples, horizon=c.horizon, temperature=c.temperature)
    cost = replace(base.cost, speed_limit=c.speed_limit)
    return replace(base, control=control, cost=cost, adapts=c.adapts, governor=replace(base.governor, gain=c.governor))


def remember(law: Law, now: Sighting, task: Task, key: Array) -> Memory:
    """Before the first sample."""
    return Memory(law.init(now, task, key), contact.init(now), jnp.int32(APPROACH), jnp.zeros(3), jnp.zeros(5))


def decide(law: Law, memory: Memory, now: Sighting, task: Task, key: Array, ready: Array) -> tuple[Command, Memory]:
    """The command for the next sample. Every phase is computed and one is taken: so it is under vmap anyway.

    ``ready`` says that the arms are out; ``key`` is what the controller's random numbers start with.
    """
    waiting, pushing_now = memory.phase == APPROACH, memory.phase == PUSH
    # The hands feel for the object from when the arms are out.
    feeling = contact.ContactState(jnp.where(ready, memory.contact.object_pose, now.object_pose))
    feeling, creep = contact.step(feeling, now, task.face)
    back = retreat.step(now, task.face, folded=jnp.bool_(False))
    pushed, after = law.step(memory.law, now, memory.last_u, task)
    coasts, _, let_go = lets_go(law.coast(after, now), memory.coasts, now.object_pose, task.face, task.goal)
    phase = jnp.where(waiting & ready & creep.over, PUSH, memory.phase)
    phase = jnp.where(pushing_now & let_go, LET_GO, phase)
    goes_on = pushing_now & ~let_go
    # Until the first push the controller's memory is ever a fresh one.
    kept = _choose(waiting, law.init(now, task, key), _choose(pushing_now, after, memory.law))
    moved = jnp.where(waiting, jnp.where(ready, creep.command.u, hold(now, True).u), back.command.u)
    u = jnp.where(goes_on, pushed, moved)
    ahead, away = creep.command, back.command
    command = Command(
        u,
        jnp.where(waiting | goes_on, ahead.yaw, away.yaw),
        jnp.where(waiting | goes_on, ahead.reach, away.reach),
        jnp.asarray(ahead.hand_height, dtype=jnp.float32),
    )
    return command, Memory(kept, feeling, phase, u, jnp.where(pushing_now, coasts, 0.0))


def _choose(which: Array, yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(which, a, b), yes, no)
