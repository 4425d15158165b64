"""A hand-written transition: a rigid body with Coulomb friction, pushed by two springs. Nothing in it is learned.

It has the signature of `core.step` and `core.rollout`, so MPPI and the object planner take either. It knows what the
learned model has to find out, the object's mass and friction, and it knows nothing of casters.

* The object: m v' = sum of hand forces - mu m g v / s, and the same about the yaw, with the friction shared between
  force and torque as on an elliptic limit surface: s^2 = |v|^2 + (r w)^2, r the radius at which the weight rests.
* The hands: springs with dampers along the face's normal that never pull.
* The robot: its lean follows the command as a second-order lag, and drives it: M x'' = M g k lean - hand forces.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx.dynamics import features, robot_model
from shmoo_mjx.dynamics.layout import channels_last, inward, outward
from shmoo_mjx.hands import HAND_RADIUS
from shmoo_mjx.types import DT, SystemState

__all__ = ["Body", "rollout", "step"]

Array = Any

GRAVITY = 9.81
SUBSTEPS = 20


class Body(NamedTuple):
    """Properties of object and robot; every field may be a traced array ``[]``."""

    mass: Array = 8.0
    """Of the object [kg]."""
    inertia: Array = 0.6
    """Of the object about its vertical axis [kg m^2]."""
    friction: Array = 0.3
    """Coulomb coefficient between object and floor; the rolling resistance of what rolls [1]."""
    radius: Array = 0.2
    """Mean distance of the object's feet from its centre [m]."""
    robot_mass: Array = 40.0
    """[kg]"""
    lean_gain: Array = 1.0
    """Acceleration of the robot per lean, in units of g [1/rad]."""
    lean_frequency: float = 8.0
    """Natural frequency of the lean's response [rad/s]."""
    stiffness: Array = 600.0
    """Of each hand [N/m]."""
    damping: Array = 40.0
    """Of each hand [N s/m]."""


def step(body: Body, state: SystemState, u: Array) -> tuple[SystemState, Array]:
    """One sample of DT; arguments and answer as in `core.step`, with the mean wrench over the sample."""
    states, wrenches = rollout(body, state, jnp.asarray(u)[..., None, :])
    time = jnp.ndim(u) - 1
    return jax.tree.map(lambda x: jnp.take(x, 0, axis=time), states), wrenches[..., 0, :]


def rollout(body: Body, state: SystemState, controls: Array) -> tuple[SystemState, Array]:
    """The states after each command of ``controls [..., T, 3]``, and the mean wrenches ``[..., T, 3]`` in {O}."""
    controls = jnp.asarray(controls)
    start = jax.tree.map(lambda x: x.astype(jnp.float32), inward(state, controls.shape[:-2]))
    lag = robot_model.lag(body.lean_frequency, 0.9)

    def sample(carry: SystemState, u: Array) -> tuple[SystemState, tuple[SystemState, Array]]:
        new, wrench = _advance(body, lag, carry, u)
        return new, (new._replace(face=None, size=None), wrench)

    commands = jnp.moveaxis(controls, (-2, -1), (0, 1))
    states, wrenches = jax.lax.scan(sample, start, commands)[1]
    states, wrenches = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), (states, wrenches))
    return outward(states._replace(face=start.face[..., None], size=start.size[..., None])), channels_last(wrenches)


def _advance(body: Body, lag: robot_model.LeanResponse, state: SystemState, u: Array) -> tuple[SystemState, Array]:
    """One sample with channels first."""
    twist_before = features.facing(state).yaw.back(state.object_twist)
    lean, lean_rate = robot_model.lean_step(lag, state.lean, state.lean_rate, u[:2], jnp.zeros_like(u[:2]))
    mean_lean = 0.5 * (state.lean + lean)
    dt = DT / SUBSTEPS

    def substep(_: int, carry: tuple[SystemState, Array, Array]) -> tuple[SystemState, Array, Array]:
        now, force_sum, wrench_sum = carry
        face = features.facing(now)
        force, wrench = _hands(body, now, features.contact(face, u[2]), face)
        drive = body.lean_gain * GRAVITY * mean_lean - force / body.robot_mass
        robot_twist = now.robot_twist + dt * jnp.stack([*face.heading(drive), jnp.zeros_like(lean[0])])
        pushed = face.yaw(jnp.stack([*(wrench[:2] / body.mass), wrench[2] / body.inertia]))
        twist = _slide(body, now.object_twist + dt * pushed, dt)
        now = now._replace(
            robot_twist=robot_twist,
            robot_pose=now.robot_pose + dt * robot_twist,
            object_twist=twist,
            object_pose=now.object_pose + dt * twist,
        )
        return now, force_sum + force, wrench_sum + wrench

    none = (jnp.zeros_like(state.last_force), jnp.zeros_like(state.object_twist))
    new, force, wrench = jax.lax.fori_loop(0, SUBSTEPS, substep, (state, *none))
    force, wrench = force / SUBSTEPS, wrench / SUBSTEPS
    memory = {"last_object_twist": twist_before, "last_wrench": wrench, "last_force": force, "last_u": u}
    return new._replace(lean=lean, lean_rate=lean_rate, **memory), wrench


def _hands(body: Body, state: SystemState, touch: features.Contact, face: features.Facing) -> tuple[Array, Array]:
    """Force of both hands ``[2, ...]`` in {R} [N] and their wrench on the object ``[3, ...]`` in {O}."""
    on_face = (touch.gap < 0.0) & (jnp.abs(touch.lateral) < state.face[3] + HAND_RADIUS)
    normal = jnp.where(on_face, jnp.maximum(-body.stiffness * touch.gap - body.damping * touch.rate, 0.0), 0.0)
    total = jnp.sum(normal, axis=0)
    c, s = jnp.cos(state.face[2]), jnp.sin(state.face[2])
    # A force along the normal at the contact point has the moment of the face's centre less its offset from there.
    moment = jnp.sum(normal * (state.face[0] * s - state.face[1] * c - touch.lateral), axis=0)
    return total * jnp.stack([face.normal.c, face.normal.s]), jnp.stack([total * c, total * s, moment])


def _slide(body: Body, twist: Array, dt: float) -> Array:
    """The object's twist ``[3, ...]`` after friction has acted for ``dt``; it never turns a motion round."""
    # The small constant keeps the gradient finite where nothing moves.
    slip = jnp.sqrt(twist[0] ** 2 + twist[1] ** 2 + (body.radius * twist[2]) ** 2 + 1e-12)
    limit = body.friction * GRAVITY * dt / slip
    spin_limit = limit * body.mass * body.radius**2 / body.inertia
    return twist * jnp.stack([*[jnp.maximum(1.0 - limit, 0.0)] * 2, jnp.maximum(1.0 - spin_limit, 0.0)])
