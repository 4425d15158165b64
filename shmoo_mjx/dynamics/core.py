"""F of Eq. 1: the state transition that training, MPPI and the object planner share.

Three readings go beyond the printed equations; each has a switch in CoreConfig:

* The acceleration is constant over the sample, so positions move by q' dt + q'' dt^2 / 2; ``euler`` gives the literal
  form.
* R predicts a planar force, psi takes a wrench: the force acts at the centre of pressure of the two hands, found from
  how far each would be pressed in. Hands that are well away from the face push nothing.
* At dt = 0.1 s the contact is stiff (the hands are springs, the object weighs little), so an explicit step would throw
  light objects off the hands. ``unilateral`` adds what a push can not do: make the face leave the hand faster than the
  compression can be released within the sample.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx import se2
from shmoo_mjx.dynamics import features, object_model, robot_model
from shmoo_mjx.dynamics.features import Contact
from shmoo_mjx.dynamics.object_model import ObjectConfig, ObjectParams
from shmoo_mjx.dynamics.robot_model import RobotConfig, RobotParams
from shmoo_mjx.hands import HAND_RADIUS, hand_targets
from shmoo_mjx.types import DT, SystemState

__all__ = ["CoreConfig", "Params", "contact_wrench", "init", "rollout", "step"]

Array = Any


@dataclass(frozen=True)
class CoreConfig:
    """Static choices of the transition; hashable, so it can be a static argument of jit."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    object: ObjectConfig = field(default_factory=ObjectConfig)
    euler: bool = False
    """Literal Eq. 1: positions move by q' dt only."""
    unilateral: bool = True
    """A pushed face can not leave the hand faster than the compression releases."""
    open_gap: float = 0.03
    """Hands farther than this from the face, now and at the sample's end, push nothing [m]."""
    pressure_lead: float = 0.5
    """The centre of pressure is taken at this fraction of the sample, by the gaps' present rates [1]."""


class Params(NamedTuple):
    """Everything the transition depends on."""

    robot: RobotParams
    object: ObjectParams
    coefficients: Array
    """``[..., 3, K]`` a of Eq. 3."""


def init(key: Array, config: CoreConfig | None = None) -> Params:
    """Untrained parameters, with zero coefficients (an object that keeps its twist)."""
    config = config or CoreConfig()
    robot_key, object_key = jax.random.split(key)
    return Params(
        robot=robot_model.init(robot_key, config.robot),
        object=object_model.init(object_key, config.object),
        coefficients=jnp.zeros((3, config.object.functions)),
    )


def contact_wrench(state: SystemState, force: Array, gamma: Array, config: CoreConfig | None = None) -> Array:
    """Gamma^o ``[..., 3]``: the force of the hands ``[..., 2]`` in {R} [N] as a wrench about its centre, in {O}.

    The force acts at the mean of the two contact points weighted by the compression of each hand; equal weights if
    neither is compressed; no wrench if both are out of reach.
    """
    config = config or CoreConfig()
    return _wrench(state, features.contact(state, gamma), force, config)


def step(params: Params, state: SystemState, u: Array, config: CoreConfig | None = None) -> tuple[SystemState, Array]:
    """One sample of DT by Eq. 1 to 3.

    Args:
        params: with coefficients ``[3, K]`` (or batched like ``state``).
        state: SystemState, any batch dimensions.
        u: ``[..., 3]`` command (phi_x, phi_y, gamma) [rad], held over the sample.
        config: static choices.

    Returns:
        The state one sample later and the wrench on the object ``[..., 3]`` in {O} at the start of the sample.
    """
    config = config or CoreConfig()
    heading, yaw = state.robot_pose[..., 2], state.object_pose[..., 2]
    inputs = features.robot_inputs(state, u)
    base, force = robot_model.predict(params.robot, inputs, config.robot)
    touch = features.contact(state, u[..., 2])
    force = jnp.where(_out_of_reach(state, touch, config)[..., None], 0.0, force)
    wrench = _wrench(state, touch, force, config)
    twist = se2.rotate(state.object_twist, -yaw)
    psi_inputs = features.object_inputs(twist, wrench, state.last_object_twist, state.size)
    push = object_model.predict(params.object, params.coefficients, psi_inputs, config.object)
    robot_acceleration = se2.rotate(base, heading)
    if config.unilateral:
        push = push + _unilateral(state, touch, twist, push, robot_acceleration, u[..., 2], force)
    object_acceleration = se2.rotate(push, yaw)
    lean, lean_rate = robot_model.lean_step(
        params.robot.lean, state.lean, state.lean_rate, u[..., :2], state.last_force
    )
    half = 0.0 if config.euler else 0.5 * DT**2
    new = state._replace(
        robot_pose=state.robot_pose + state.robot_twist * DT + half * robot_acceleration,
        robot_twist=state.robot_twist + robot_acceleration * DT,
        lean=lean,
        lean_rate=lean_rate,
        object_pose=state.object_pose + state.object_twist * DT + half * object_acceleration,
        object_twist=state.object_twist + object_acceleration * DT,
        last_object_twist=twist,
        last_force=force,
        last_u=jnp.broadcast_to(u, state.last_u.shape),
    )
    return new, wrench


def rollout(
    params: Params, state: SystemState, controls: Array, config: CoreConfig | None = None
) -> tuple[SystemState, Array]:
    """The states after each of the T commands ``controls [T, 3]`` and the wrenches on the way.

    Returns:
        SystemState stacked over a leading T, and wrenches ``[T, 3]`` in {O} at the start of each sample.
    """
    config = config or CoreConfig()
    state = jax.tree.map(jnp.asarray, state)

    def body(carry: SystemState, u: Array) -> tuple[SystemState, tuple[SystemState, Array]]:
        new, wrench = step(params, carry, u, config)
        return new, (new, wrench)

    return jax.lax.scan(body, state, controls)[1]


def _out_of_reach(state: SystemState, touch: Contact, config: CoreConfig) -> Array:
    """True where both hands are well off the face, ahead of it or beside it, throughout the sample."""
    nearest = jnp.minimum(touch.gap, touch.gap + DT * touch.rate)
    beside = jnp.abs(touch.lateral) > state.face[..., 3:] + HAND_RADIUS
    return jnp.all((nearest > config.open_gap) | beside, axis=-1)


def _wrench(state: SystemState, touch: Contact, force: Array, config: CoreConfig) -> Array:
    force = jnp.where(_out_of_reach(state, touch, config)[..., None], 0.0, force)
    in_object = se2.rotate(force, state.robot_pose[..., 2] - state.object_pose[..., 2])
    gap = touch.gap + config.pressure_lead * DT * touch.rate
    # The small constant gives equal weights where neither hand is pressed in, and a smooth change between the cases.
    weight = jnp.maximum(-gap, 0.0) + 1e-4
    lateral = jnp.clip(touch.lateral, -state.face[..., 3:], state.face[..., 3:])
    mean = jnp.sum(weight * lateral, axis=-1) / jnp.sum(weight, axis=-1)
    tangent = jnp.stack([-jnp.sin(state.face[..., 2]), jnp.cos(state.face[..., 2])], axis=-1)
    point = state.face[..., :2] + mean[..., None] * tangent
    return jnp.concatenate([in_object, se2.cross(point, in_object)[..., None]], axis=-1)


def _unilateral(
    state: SystemState, touch: Contact, twist: Array, push: Array, robot_acceleration: Array, gamma: Array, force: Array
) -> Array:
    """Correction ``[..., 3]`` of the object's acceleration in {O} so that no pushed point of the face outruns its hand.

    Along the inward normal n, at each hand's contact point: v_object(t+1) <= max(v_hand(t+1) + compression / DT,
    v_object(t)). The second entry leaves an object that already coasts away alone. The two excess speeds are taken off
    by the pair (speed along n, spin) that removes exactly those.
    """
    angle = state.face[..., 2]
    normal = jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)
    # Speed along n of the face's point at offset s is v.n + w (arm - s), with arm the moment of n about the centre.
    arm = se2.cross(state.face[..., :2], normal)[..., None] - touch.lateral
    before = jnp.sum(twist[..., :2] * normal, axis=-1, keepdims=True) + twist[..., 2:] * arm
    gain = (jnp.sum(push[..., :2] * normal, axis=-1, keepdims=True) + push[..., 2:] * arm) * DT
    release = _hand_speed(state, touch, robot_acceleration, gamma) + jnp.maximum(-touch.gap, 0.0) / DT
    pushed = jnp.sum(force * _direction(touch.face[..., 2]), axis=-1, keepdims=True) > 0.0
    nearest = jnp.minimum(touch.gap, touch.gap + DT * touch.rate)
    touching = nearest <= jnp.maximum(jnp.min(nearest, axis=-1, keepdims=True), 0.0)
    beside = jnp.abs(touch.lateral) > state.face[..., 3:] + HAND_RADIUS
    excess = jnp.where(pushed & touching & ~beside, jnp.maximum(before + gain - jnp.maximum(release, before), 0.0), 0.0)
    between = touch.lateral[..., 0] - touch.lateral[..., 1]
    spin = (excess[..., 0] - excess[..., 1]) / jnp.where(jnp.abs(between) < 0.1, 0.1, between)
    speed = -(excess[..., 0] + arm[..., 0] * spin)
    return jnp.concatenate([speed[..., None] * normal, spin[..., None]], axis=-1) / DT


def _hand_speed(state: SystemState, touch: Contact, robot_acceleration: Array, gamma: Array) -> Array:
    """Speed ``[..., 2]`` of the hands along the face's inward normal at the end of the sample [m/s]."""
    twist = se2.rotate(state.robot_twist + robot_acceleration * DT, -state.robot_pose[..., 2])
    hands = hand_targets(gamma)
    spin = twist[..., None, 2]
    velocity = jnp.stack([twist[..., None, 0] - spin * hands[..., 1], twist[..., None, 1] + spin * hands[..., 0]], -1)
    return jnp.sum(velocity * _direction(touch.face[..., 2])[..., None, :], axis=-1)


def _direction(angle: Array) -> Array:
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)
