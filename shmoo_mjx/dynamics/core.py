"""F of Eq. 1: the state transition used by training, MPPI and the object planner.

Three details go beyond the printed equations. CoreConfig has the options for each:

* The acceleration is constant over the sample, so positions change by q' dt + q'' dt^2 / 2. ``euler`` selects the
  literal form.
* R predicts a planar force, but psi takes a wrench. The force acts at the centre of pressure of the two hands, which
  follows from the compression of each hand. Hands farther than ``open_gap`` from the face exert no force.
* At dt = 0.1 s the contact is stiff (the hands are springs and the object is light), so an explicit step would throw
  light objects off the hands. ``unilateral`` limits the speed of the face: it can not leave the hand faster than the
  compression is released within the sample.
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
    """Static options of the transition. It is hashable, so it can be a static argument of jit."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    """Structure of R."""
    object: ObjectConfig = field(default_factory=ObjectConfig)
    """Structure of psi."""
    euler: bool = False
    """Use Eq. 1 literally: positions change by q' dt only."""
    unilateral: bool = True
    """Limit the speed at which a pushed face leaves the hand to the speed at which the compression is released."""
    open_gap: float = 0.03
    """Largest gap between hand and face at which a hand exerts force [m], at the start or at the end of the sample.
    Larger counts more distant hands as touching."""
    pressure_lead: float = 0.5
    """Fraction of the sample at which the centre of pressure is evaluated [1]. The gaps are extrapolated with their
    current rates; larger looks further ahead."""


class Params(NamedTuple):
    """Parameters of the transition."""

    robot: RobotParams
    """Parameters of R and of the lean response."""
    object: ObjectParams
    """Parameters of psi."""
    coefficients: Float[Array, "... 3 K"]
    """The coefficients a of Eq. 3, per axis."""
    contact: Float[Array, "... p"]
    """Parameters of the four-point contact model, in the order of `contact_model.PARAMETERS`. The predictions of this
    model are inputs of psi."""


class _Models(NamedTuple):
    """Params in the form that `_advance` uses, prepared once per roll-out."""

    robot: FusedEquivariantMLP
    object: object_model.FusedObjectModel
    """O of Eq. 3, with the coefficients included."""
    lean: LeanResponse


@single_precision
def init(key: Key[Array, ""], config: CoreConfig | None = None) -> Params:
    """Untrained parameters with zero coefficients, which predict a constant object twist."""
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
    """Gamma^o: the wrench of the hands about the object's centre, in {O}.

    The force acts at the mean of the two contact points, weighted by the compression of each hand. The weights are
    equal if neither hand is compressed. The wrench is zero if both hands are out of reach.

    Args:
        state: SystemState, any batch dimensions.
        force: planar force of the hands on the object in {R} [N].
        gamma: steering angle of the arms [rad].
        config: static options.

    Returns:
        Wrench [N, N, N m] in {O}.
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
    """Advance the state by one sample DT (Eq. 1 to 3).

    Args:
        params: with coefficients ``[3, K]``; vmap for more than one object.
        state: SystemState, any batch dimensions.
        u: command (phi_x, phi_y, gamma) [rad], constant over the sample.
        config: static options.

    Returns:
        The state one sample later, and the wrench on the object in {O} at the start of the sample.
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
    """Simulate T commands: the state after each command and the wrench during it.

    One call with a batch of roll-outs is much faster than a vmap over single roll-outs. The results are the same.

    Args:
        params: with coefficients ``[3, K]``; vmap for more than one object.
        state: initial SystemState, with the batch dimensions of ``controls``.
        controls: commands (phi_x, phi_y, gamma) [rad].
        config: static options.

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
    # From [T, n, ...] to [n, ..., T]: time becomes the last batch dimension.
    states, wrenches = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), (states, wrenches))
    constant = {"face": start.face[..., None], "size": jnp.asarray(start.size)[..., None]}
    return to_channels_last(SystemState(**states, **constant)), channels_last(wrenches)


def _fuse(params: Params, config: CoreConfig) -> _Models:
    robot = robot_model.fuse(params.robot)
    return _Models(
        robot, object_model.fuse(params.object, params.coefficients, config.object, params.contact), params.robot.lean
    )


def _remembered(models: _Models, state: SystemState, config: CoreConfig) -> Array | None:
    """The contact model's prediction for the sample before ``state`` (`object_model.remembered`)."""
    last, wrench = state.last_object_twist, state.last_wrench
    inputs = features.object_inputs(
        jnp.zeros_like(last), jnp.zeros_like(last), last_twist=last, size=state.size, last_wrench=wrench, axis=0
    )
    return object_model.remembered(inputs, config.object, models.object.contact)


def _advance(
    models: _Models, state: SystemState, before: Array | None, u: Array, *, config: CoreConfig
) -> tuple[SystemState, Array | None, Array]:
    """`step` with channels first: features, R, contact, O, integration.

    ``before`` is the result of `_remembered`. The second return value is ``before`` for the next sample.
    """
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
    """R of Eq. 2: base acceleration ``[3, ...]`` and hand force ``[2, ...]``, both in {R}."""
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
    """True where both hands are away from the face during the whole sample, either in front of it or beside it."""
    nearest = jnp.minimum(touch.gap, touch.gap + DT * touch.rate)
    beside = jnp.abs(touch.lateral) > state.face[3] + HAND_RADIUS
    return jnp.all((nearest > config.open_gap) | beside, axis=0)


def _wrench(state: SystemState, face: Facing, touch: Contact, force: Array, *, config: CoreConfig) -> Array:
    """Gamma^o ``[3, ...]`` of a hand force ``[2, ...]``, which must be zero where the hands are out of reach."""
    in_object = face.relative.inverse_apply(force)
    gap = touch.gap + config.pressure_lead * DT * touch.rate
    # The small constant gives equal weights if neither hand is compressed, and a smooth transition otherwise.
    weight = jnp.maximum(-gap, 0.0) + 1e-4
    lateral = jnp.clip(touch.lateral, -state.face[3], state.face[3])
    mean = jnp.sum(weight * lateral, axis=0) / jnp.sum(weight, axis=0)
    x = state.face[0] - mean * jnp.sin(state.face[2])
    y = state.face[1] + mean * jnp.cos(state.face[2])
    return jnp.stack([*in_object, x * in_object[1] - y * in_object[0]])


def _unilateral(
    state: SystemState, face: Facing, touch: Contact, *, twist: Array, acceleration: Array, base: Array, force: Array
) -> Array:
    """Correction ``[3, ...]`` of the object's acceleration in {O}: no pushed point of the face may outrun its hand.

    The constraint at the contact point of each hand, along the inward normal n, is
    v_object(t+1) <= max(v_hand(t+1) + compression / DT, v_object(t)).
    The term v_object(t) leaves an object unchanged that is already coasting away. The correction is the pair (speed
    along n, spin) that removes exactly the two excess speeds. ``base`` is the robot's acceleration in {R}.
    """
    nx, ny = jnp.cos(state.face[2]), jnp.sin(state.face[2])
    # The point of the face at offset s moves along n with v.n + w (m - s), where m is the moment of n about the
    # object's centre. ``arm`` is m - s for each hand.
    arm = state.face[0] * ny - state.face[1] * nx - touch.lateral
    before = twist[0] * nx + twist[1] * ny + twist[2] * arm
    gain = (acceleration[0] * nx + acceleration[1] * ny + acceleration[2] * arm) * DT
    release = _hand_speed(state, face, touch, base) + jnp.maximum(-touch.gap, 0.0) / DT
    pushed = force[0] * face.normal.c + force[1] * face.normal.s > 0.0
    nearest = jnp.minimum(touch.gap, touch.gap + DT * touch.rate)
    touching = nearest <= jnp.maximum(nearest[::-1], 0.0)  # compressed, or the nearer of the two
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
