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

from shmoo_mjx.arrays import Array, Float, Key, Scalar, single_precision
from shmoo_mjx.dynamics import contact_model, features, object_model, robot_model
from shmoo_mjx.dynamics.features import Contact, Facing
from shmoo_mjx.dynamics.fused import FusedEquivariantMLP
from shmoo_mjx.dynamics.layout import MOVING, channels_first, channels_last, to_channels_first, to_channels_last
from shmoo_mjx.dynamics.object_model import ObjectConfig, ObjectParams
from shmoo_mjx.dynamics.robot_model import LeanResponse, RobotConfig, RobotParams
from shmoo_mjx.geometry.hands import HAND_RADIUS
from shmoo_mjx.types import DT, SystemState


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
    """Parameters of the transition."""

    robot: RobotParams
    object: ObjectParams
    coefficients: Float[Array, "... 3 K"]
    """a of Eq. 3."""
    contact: Float[Array, "... 12"]
    """Of the four-point contact model that is among the inputs of psi, as `contact_model.PARAMETERS` lists them."""


class _Models(NamedTuple):
    """Params made ready for `_advance`, once per roll-out."""

    robot: FusedEquivariantMLP
    object: object_model.FusedObjectModel
    """With the coefficients in it: O of Eq. 3, not psi."""
    lean: LeanResponse


@single_precision
def init(key: Key[Array, ""], config: CoreConfig | None = None) -> Params:
    """Untrained parameters, with zero coefficients (an object that keeps its twist)."""
    config = config or CoreConfig()
    robot_key, object_key = jax.random.split(key)
    return Params(
        robot=robot_model.init(robot_key, config.robot),
        object=object_model.init(object_key, config.object),
        coefficients=jnp.zeros((3, config.object.functions)),
        contact=contact_model.guess(),
    )


@single_precision
def contact_wrench(
    state: SystemState,
    force: Float[Array, "... 2"],
    gamma: Scalar | Float[Array, "..."],
    config: CoreConfig | None = None,
) -> Float[Array, "... 3"]:
    """Gamma^o: the force of the hands in {R} [N] as a wrench about the object's centre, in {O}.

    The force acts at the mean of the two contact points weighted by the compression of each hand; equal weights if
    neither is compressed; no wrench if both are out of reach.
    """
    config = config or CoreConfig()
    inside = to_channels_first(state, jnp.broadcast_shapes(jnp.shape(state.robot_pose)[:-1], jnp.shape(gamma)))
    face = features.facing(inside)
    touch = features.contact(face, gamma)
    force = jnp.where(_out_of_reach(inside, touch, config), 0.0, channels_first(force))
    return channels_last(_wrench(inside, face, touch, force, config=config))


@single_precision
def step(
    params: Params, state: SystemState, u: Float[Array, "... 3"], config: CoreConfig | None = None
) -> tuple[SystemState, Float[Array, "... 3"]]:
    """One sample of DT by Eq. 1 to 3.

    Args:
        params: with coefficients ``[3, K]``; vmap for more than one object.
        state: SystemState, any batch dimensions.
        u: command (phi_x, phi_y, gamma) [rad], held over the sample.
        config: static choices.

    Returns:
        The state one sample later and the wrench on the object in {O} at the start of the sample.
    """
    config = config or CoreConfig()
    batch = jnp.broadcast_shapes(jnp.shape(state.robot_pose)[:-1], jnp.shape(u)[:-1])
    u = channels_first(jnp.broadcast_to(u, (*batch, 3)))
    models, inside = _fuse(params, config), to_channels_first(state, batch)
    new, _, wrench = _advance(models, inside, _remembered(models, inside, config), u, config=config)
    return to_channels_last(new), channels_last(wrench)


@single_precision
def rollout(
    params: Params, state: SystemState, controls: Float[Array, "... T 3"], config: CoreConfig | None = None
) -> tuple[SystemState, Float[Array, "... T 3"]]:
    """The states after each of the T commands and the wrenches on the way.

    A whole batch of roll-outs in one call is much faster than a vmap of single ones, and gives the same.

    Returns:
        SystemState ``[..., T, n]``, and wrenches in {O} at the start of each sample.
    """
    config = config or CoreConfig()
    controls = jnp.asarray(controls)
    models = _fuse(params, config)
    start = to_channels_first(state, controls.shape[:-2])

    def one_sample(carry: tuple[SystemState, Array | None], u: Array) -> tuple[Any, tuple[dict[str, Array], Array]]:
        new, now, wrench = _advance(models, *carry, u, config=config)
        return (new, now), ({name: getattr(new, name) for name in MOVING}, wrench)

    commands = jnp.moveaxis(controls, (-2, -1), (0, 1))
    begin = start, _remembered(models, start, config)
    states, wrenches = jax.lax.scan(one_sample, begin, commands)[1]
    # [T, n, ...] as [n, ..., T]: time becomes the last batch dimension.
    states, wrenches = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), (states, wrenches))
    constant = {"face": start.face[..., None], "size": jnp.asarray(start.size)[..., None]}
    return to_channels_last(SystemState(**states, **constant)), channels_last(wrenches)


def _fuse(params: Params, config: CoreConfig) -> _Models:
    robot = robot_model.fuse(params.robot)
    return _Models(
        robot, object_model.fuse(params.object, params.coefficients, config.object, params.contact), params.robot.lean
    )


def _remembered(models: _Models, state: SystemState, config: CoreConfig) -> Array | None:
    """What the contact model predicted for the sample before ``state`` (`object_model.remembered`)."""
    last, wrench = state.last_object_twist, state.last_wrench
    inputs = features.object_inputs(
        jnp.zeros_like(last), jnp.zeros_like(last), last_twist=last, size=state.size, last_wrench=wrench, axis=0
    )
    return object_model.remembered(inputs, config.object, models.object.contact)


def _advance(
    models: _Models, state: SystemState, before: Array | None, u: Array, *, config: CoreConfig
) -> tuple[SystemState, Array | None, Array]:
    """`step` with channels first, stage by stage: features, R, contact, O, integration. ``before`` is `_remembered`,
    and returned for the next sample."""
    face = features.facing(state)
    touch = features.contact(face, u[2])
    base, force = _robot_stage(models, state, face=face, touch=touch, u=u, config=config)
    wrench = _wrench(state, face, touch, force, config=config)
    twist = face.yaw.inverse_apply(state.object_twist)
    inputs = features.object_inputs(
        twist, wrench, last_twist=state.last_object_twist, size=state.size, last_wrench=state.last_wrench, axis=0
    )
    acceleration, now = object_model.forward(models.object, inputs, config.object, before)
    if config.unilateral:
        acceleration = acceleration + _unilateral(
            state, face, touch, twist=twist, acceleration=acceleration, base=base, force=force
        )
    new = _integrate(
        models, state, u, robot=face.heading.apply(base), thing=face.yaw.apply(acceleration), config=config
    )
    return new._replace(last_object_twist=twist, last_wrench=wrench, last_force=force, last_u=u), now, wrench


def _robot_stage(
    models: _Models, state: SystemState, *, face: Facing, touch: Contact, u: Array, config: CoreConfig
) -> tuple[Array, Array]:
    """R of Eq. 2: acceleration of the base ``[3, ...]`` and force of the hands ``[2, ...]``, both in {R}."""
    inputs = features.stacked_robot_inputs(state, face, features.contact(face, state.last_u[2]), u)
    outputs = models.robot.forward(inputs, config.robot.activation)
    return outputs[:3], jnp.where(_out_of_reach(state, touch, config), 0.0, outputs[3:])


def _integrate(
    models: _Models, state: SystemState, u: Array, *, robot: Array, thing: Array, config: CoreConfig
) -> SystemState:
    """Eq. 1: poses, twists and lean one sample later under the accelerations ``robot`` and ``thing`` in {W}."""
    lean, lean_rate = robot_model.lean_step(
        models.lean, state.lean, state.lean_rate, target=u[:2], force=state.last_force
    )
    half = 0.0 if config.euler else 0.5 * DT**2
    return state._replace(
        robot_pose=state.robot_pose + state.robot_twist * DT + half * robot,
        robot_twist=state.robot_twist + robot * DT,
        lean=lean,
        lean_rate=lean_rate,
        object_pose=state.object_pose + state.object_twist * DT + half * thing,
        object_twist=state.object_twist + thing * DT,
    )


def _out_of_reach(state: SystemState, touch: Contact, config: CoreConfig) -> Array:
    """True where both hands are well off the face, ahead of it or beside it, throughout the sample."""
    nearest = jnp.minimum(touch.gap, touch.gap + DT * touch.rate)
    beside = jnp.abs(touch.lateral) > state.face[3] + HAND_RADIUS
    return jnp.all((nearest > config.open_gap) | beside, axis=0)


def _wrench(state: SystemState, face: Facing, touch: Contact, force: Array, *, config: CoreConfig) -> Array:
    """Gamma^o ``[3, ...]`` of a hand force ``[2, ...]`` that is zero out of reach."""
    in_object = face.relative.inverse_apply(force)
    gap = touch.gap + config.pressure_lead * DT * touch.rate
    # The small constant gives equal weights where neither hand is pressed in, and a smooth change between the cases.
    weight = jnp.maximum(-gap, 0.0) + 1e-4
    lateral = jnp.clip(touch.lateral, -state.face[3], state.face[3])
    mean = jnp.sum(weight * lateral, axis=0) / jnp.sum(weight, axis=0)
    x = state.face[0] - mean * jnp.sin(state.face[2])
    y = state.face[1] + mean * jnp.cos(state.face[2])
    return jnp.stack([*in_object, x * in_object[1] - y * in_object[0]])


def _unilateral(
    state: SystemState, face: Facing, touch: Contact, *, twist: Array, acceleration: Array, base: Array, force: Array
) -> Array:
    """Correction ``[3, ...]`` of the object's acceleration in {O} so that no pushed point of the face outruns its hand.

    Along the inward normal n, at each hand's contact point: v_object(t+1) <= max(v_hand(t+1) + compression / DT,
    v_object(t)). The second entry leaves an object that already coasts away alone. The two excess speeds are taken off
    by the pair (speed along n, spin) that removes exactly those. ``base`` is the robot's acceleration in {R}.
    """
    nx, ny = jnp.cos(state.face[2]), jnp.sin(state.face[2])
    # Speed along n of the face's point at offset s is v.n + w (arm - s), with arm the moment of n about the centre.
    arm = state.face[0] * ny - state.face[1] * nx - touch.lateral
    before = twist[0] * nx + twist[1] * ny + twist[2] * arm
    gain = (acceleration[0] * nx + acceleration[1] * ny + acceleration[2] * arm) * DT
    release = _hand_speed(state, face, touch, base) + jnp.maximum(-touch.gap, 0.0) / DT
    pushed = force[0] * face.normal.c + force[1] * face.normal.s > 0.0
    nearest = jnp.minimum(touch.gap, touch.gap + DT * touch.rate)
    touching = nearest <= jnp.maximum(nearest[::-1], 0.0)  # pressed in, or the nearer hand of the two
    beside = jnp.abs(touch.lateral) > state.face[3] + HAND_RADIUS
    excess = jnp.where(pushed & touching & ~beside, jnp.maximum(before + gain - jnp.maximum(release, before), 0.0), 0.0)
    between = touch.lateral[0] - touch.lateral[1]
    spin = (excess[0] - excess[1]) / jnp.where(jnp.abs(between) < 0.1, 0.1, between)
    speed = -(excess[0] + arm[0] * spin)
    return jnp.stack([speed * nx, speed * ny, spin]) / DT


def _hand_speed(state: SystemState, face: Facing, touch: Contact, base: Array) -> Array:
    """Speed ``[2, ...]`` of the hands along the face's inward normal at the end of the sample [m/s]."""
    vx, vy, spin = face.heading.inverse_apply(state.robot_twist) + base * DT
    x, y = touch.hands
    return (vx - spin * y) * face.normal.c + (vy + spin * x) * face.normal.s
