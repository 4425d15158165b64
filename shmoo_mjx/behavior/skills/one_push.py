"""One push on one face as pure functions of one world, to be mapped over many (Sec. III-E).

Move slowly forward until the hands feel the object, push by any law, let go in time for the object to coast into its
goal, back away. It is what the pushing task does round the pushing controller.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx.arrays import Array
from shmoo_mjx.behavior.skills import contact, hold, retreat
from shmoo_mjx.behavior.skills.push import lets_go
from shmoo_mjx.control import quasi_static
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.control.speed import SpeedProfile
from shmoo_mjx.types import Command

APPROACH, PUSH, LET_GO, DONE, FELL, UNSTABLE = range(6)
"""Phases of a push; from DONE on nothing happens any more."""


class WorldGoal(NamedTuple):
    """Face to push, size and goal of the object of one world."""

    face: Array
    """``[4]``"""
    half_extents: Array
    """``[2]``"""
    goal: Array
    """``[3]`` in {W}"""


class PushPolicy(NamedTuple):
    """A pushing controller; its state is any pytree."""

    init: Callable[[ObjectObservation, WorldGoal, Array], Any]
    """(what is perceived, task, key) -> state"""
    step: Callable[[Any, ObjectObservation, Array, WorldGoal], tuple[Array, Any]]
    """(state, what is perceived, the command of the last sample, task) -> command ``[3]``, state"""
    coast: Callable[[Any, ObjectObservation], Array]
    """(state, what is perceived) -> where the object comes to rest if it is let go now ``[3]``"""


class PolicyState(NamedTuple):
    """State of one push."""

    policy: Any
    contact: contact.ContactState
    phase: Array
    last_u: Array
    """``[3]``"""
    coasts: Array
    """``[5]`` how far the object would have coasted on in the last samples [m]."""


def quasi_static_policy(speed: SpeedProfile) -> PushPolicy:
    """The pusher without a model, as fast as ``speed`` allows."""
    return PushPolicy(
        init=lambda obs, task, key: jnp.zeros(()),
        step=lambda integral, obs, last_u, task: quasi_static.control(
            speed, obs, integral, face=task.face, goal=task.goal
        ),
        coast=lambda state, obs: obs.object_pose,
    )


def init(policy: PushPolicy, obs: ObjectObservation, task: WorldGoal, key: Array) -> PolicyState:
    """State before the first sample."""
    return PolicyState(policy.init(obs, task, key), contact.init(obs), jnp.int32(APPROACH), jnp.zeros(3), jnp.zeros(5))


def step(
    policy: PushPolicy, state: PolicyState, obs: ObjectObservation, task: WorldGoal, *, key: Array, ready: Array
) -> tuple[Command, PolicyState]:
    """The command for the next sample. Every phase is computed and one is taken: so it is under vmap anyway.

    ``ready`` says that the arms are out; ``key`` is what the controller's random numbers start with.
    """
    waiting, pushing_now = state.phase == APPROACH, state.phase == PUSH
    # The hands feel for the object from when the arms are out.
    feeling = contact.ContactState(jnp.where(ready, state.contact.object_pose, obs.object_pose))
    feeling, touching = contact.step(feeling, obs, task.face)
    back = retreat.step(obs, task.face, folded=jnp.bool_(False))
    pushed, after = policy.step(state.policy, obs, state.last_u, task)
    coasts, _, let_go = lets_go(
        policy.coast(after, obs), state.coasts, object_pose=obs.object_pose, face=task.face, goal=task.goal
    )
    phase = jnp.where(waiting & ready & touching.over, PUSH, state.phase)
    phase = jnp.where(pushing_now & let_go, LET_GO, phase)
    goes_on = pushing_now & ~let_go
    # Until the first push the controller's memory is ever a fresh one.
    kept = _choose(waiting, policy.init(obs, task, key), _choose(pushing_now, after, state.policy))
    moved = jnp.where(waiting, jnp.where(ready, touching.command.u, hold(obs, True).u), back.command.u)
    u = jnp.where(goes_on, pushed, moved)
    ahead, away = touching.command, back.command
    command = Command(
        u,
        jnp.where(waiting | goes_on, ahead.yaw, away.yaw),
        jnp.where(waiting | goes_on, ahead.reach, away.reach),
        jnp.asarray(ahead.hand_height, dtype=jnp.float32),
    )
    return command, PolicyState(kept, feeling, phase, u, jnp.where(pushing_now, coasts, 0.0))


def _choose(which: Array, yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(which, a, b), yes, no)
