"""The pushing controllers as pure functions of one world, to be mapped over many (Sec. III-E).

The paper's controller is the one that runs everywhere else (control/pushing.py): MPPI on the learned core, Eq. 8 and
the governor. What the pushing task does round it is here as well, for one push on one face: creep forward until the
hands feel the object, push, let go in time for the object to coast into its goal, back away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx import se2
from shmoo_mjx.control import pushing, quasi_static
from shmoo_mjx.control.pushing import PushConfig, Sighting
from shmoo_mjx.faces import heading
from shmoo_mjx.hands import HAND_HEIGHT, HAND_RADIUS, REACH
from shmoo_mjx.learning.weights import Weights, untouched
from shmoo_mjx.navigation.push_task import PushTaskConfig, pose_push_config
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean
from shmoo_mjx.sweep.config import Controller
from shmoo_mjx.types import Command

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
    "hands_to_face",
    "law_of",
    "push_config",
    "remember",
]

Array = Any

APPROACH, PUSH, LET_GO, DONE, FELL, UNSTABLE = range(6)
"""Phases of a push; from DONE on nothing happens any more."""
_TASK = PushTaskConfig()
_MOVES = _TASK.moves


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
    phase: Array
    last_u: Array
    """``[3]``"""
    coasts: Array
    """``[5]`` how far the object would have coasted on in the last samples [m]."""


def law_of(controller: Controller, weights: Weights) -> Law:
    """The controller that a sweep file asks for."""
    config = push_config(controller)
    if controller.kind == "quasi_static":
        settings = quasi_static.QuasiStaticConfig()
        return Law(
            init=lambda now, task, key: (),
            step=lambda state, now, last_u, task: (
                quasi_static.law(settings, config.cost, task.face, now, task.goal),
                state,
            ),
            coast=lambda state, now: now.object_pose,
        )
    core, params = weights.config, weights.params

    def init(now: Sighting, task: Task, key: Array) -> Any:
        adapt = untouched(weights, config.adapt.body)
        return pushing.start(config, adapt, now, task.face, task.half_extents, key)

    def step(state: Any, now: Sighting, last_u: Array, task: Task) -> tuple[Array, Any]:
        return pushing.control_step(config, core, params, state, now, last_u, task.goal, task.half_extents)

    return Law(init, step, lambda state, now: pushing.coast(config, core, params, state.adapt, state.before))


def push_config(c: Controller) -> PushConfig:
    """The settings of the pushing controller that a sweep file asks for."""
    base = pose_push_config()
    control = replace(base.control, samples=c.samples, horizon=c.horizon, temperature=c.temperature)
    cost = replace(base.cost, speed_limit=c.speed_limit)
    return replace(base, control=control, cost=cost, adapts=c.adapts, governor=c.governor)


def remember(law: Law, now: Sighting, task: Task, key: Array) -> Memory:
    """Before the first sample."""
    return Memory(law.init(now, task, key), jnp.int32(APPROACH), jnp.zeros(3), jnp.zeros(5))


def decide(law: Law, memory: Memory, now: Sighting, task: Task, key: Array, ready: Array) -> tuple[Command, Memory]:
    """The command for the next sample. Every phase is computed and one is taken: so it is under vmap anyway.

    Args:
        law: the controller.
        memory: from :func:`remember` or the last call.
        now: what is perceived.
        task: of this world.
        key: with which the controller's random numbers start.
        ready: the arms are out.
    """
    felt = jnp.hypot(now.wrench[0], now.wrench[1])
    touched = (memory.phase == APPROACH) & ready & (felt > _MOVES.contact_force)
    phase = jnp.where(touched, PUSH, memory.phase)
    # Until there is contact the controller's memory is ever a fresh one.
    before = _choose(memory.phase == APPROACH, law.init(now, task, key), memory.law)
    pushed, after = law.step(before, now, memory.last_u, task)
    in_face = se2.relative(se2.compose(now.object_pose, task.face[:3]), now.robot_pose)
    coasts, let_go = _lets_go(law.coast(after, now), memory.coasts, now, task)
    phase = jnp.where((phase == PUSH) & let_go, LET_GO, phase)
    near = hands_to_face(now.object_pose, now.robot_pose, task.face) < _MOVES.retreat
    back = jnp.where(near, -0.2, 0.0) * jnp.array([1.0, 0.0])
    creep = jnp.where(ready, _MOVES.contact_speed, 0.0)
    ahead = se2.rotate(jnp.stack([creep, jnp.clip(-0.8 * in_face[1], -0.1, 0.1)]), -in_face[2])
    moved = _lean(now, jnp.where(phase == APPROACH, ahead, back))
    u = jnp.where(phase == PUSH, pushed, jnp.concatenate([moved, jnp.zeros(1)]))
    yaw = jnp.where(phase >= LET_GO, now.robot_pose[2], heading(now.object_pose, task.face))
    reach = jnp.where(phase >= LET_GO, REACH - _MOVES.withdraw, REACH)
    command = Command(u, yaw, reach, jnp.float32(HAND_HEIGHT))
    return command, Memory(_choose(phase == PUSH, after, before), phase, u, jnp.where(phase == PUSH, coasts, 0.0))


def hands_to_face(object_pose: Array, robot_pose: Array, face: Array) -> Array:
    """How far the place of the extended hands is off the face [m]."""
    return -se2.relative(se2.compose(object_pose, face[:3]), robot_pose)[0] - REACH - HAND_RADIUS


def _lets_go(rest: Array, coasts: Array, now: Sighting, task: Task) -> tuple[Array, Array]:
    """The last coasting distances ``[5]`` with this one, and whether it is time to let go (as in the pushing task)."""
    ahead = heading(now.object_pose, task.face)
    normal = jnp.stack([jnp.cos(ahead), jnp.sin(ahead)])
    left = (task.goal[:2] - now.object_pose[:2]) @ normal
    coasts = jnp.concatenate([coasts[1:], ((rest[:2] - now.object_pose[:2]) @ normal)[None]])
    return coasts, (left - jnp.median(coasts) < _TASK.lead) & (left < _TASK.within)


def _lean(now: Sighting, wish: Array) -> Array:
    """Lean ``[2]`` [rad] of the velocity loop for a wish ``[2]`` in {R} [m/s]."""
    velocity = se2.rotate(now.robot_twist[:2], -now.robot_pose[2])
    return velocity_to_lean(Gains(), velocity, now.lean_rate, wish)


def _choose(which: Array, yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(which, a, b), yes, no)
