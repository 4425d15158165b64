"""One push on one face as pure functions of one world, for vmap over many worlds (Sec. III-E).

The robot moves slowly forward until the hands touch the object, pushes with any control law, releases the object in
time to coast to its goal, and backs away. The push task does the same around the pushing controller.
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
"""Phases of a push. From DONE on nothing changes."""


class WorldGoal(NamedTuple):
    """Face to push, object size and goal of one world."""

    face: Array
    """``[4]`` the face to push on."""
    half_extents: Array
    """``[2]`` half extents [m]."""
    goal: Array
    """``[3]`` target pose in {W}."""


class PushPolicy(NamedTuple):
    """A pushing controller. Its state is any pytree."""

    init: Callable[[ObjectObservation, WorldGoal, Array], Any]
    """(observation, task, key) -> state"""
    step: Callable[[Any, ObjectObservation, Array, WorldGoal], tuple[Array, Any]]
    """(state, observation, command of the last sample, task) -> command ``[3]``, state"""
    coast: Callable[[Any, ObjectObservation], Array]
    """(state, observation) -> pose ``[3]`` at which the object comes to rest if it is released now"""


class PolicyState(NamedTuple):
    """State of one push."""

    policy: Any
    """State of the controller."""
    contact: contact.ContactState
    """State of making contact."""
    phase: Array
    """One of APPROACH to UNSTABLE."""
    last_u: Array
    """``[3]`` command of the last sample."""
    coasts: Array
    """``[5]`` predicted coasting distances in the last samples [m]."""


def quasi_static_policy(speed: SpeedProfile) -> PushPolicy:
    """The model-free pusher, with the speed limits ``speed``."""
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
    """The command for the next sample, and the next state.

    Every phase is computed and one is selected, which costs nothing extra under vmap. ``ready`` tells whether the arms
    are extended. ``key`` seeds the controller's random numbers.
    """
    waiting, pushing_now = state.phase == APPROACH, state.phase == PUSH
    # Contact detection starts when the arms are extended.
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
    # Until the push begins, the controller's state is reinitialised at every sample.
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
