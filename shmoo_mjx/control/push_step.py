"""One step of adaptive pushing (Sec. III-E) as pure functions, for jit and vmap: MPPI on the learned core while the
object's dynamics are learned.

`start` begins a push, `step` is its 10 Hz control step, `coast` says where the object comes to rest if it is let go.
:class:`~shmoo_mjx.control.pushing.PushController` compiles them for one world.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

from shmoo_mjx.arrays import Array, Float, Key, Scalar, single_precision
from shmoo_mjx.control import models, mppi, sharding
from shmoo_mjx.control.cost import push_cost
from shmoo_mjx.control.governor import forward_lean, govern
from shmoo_mjx.control.observation import LocalDistanceField, ObjectObservation
from shmoo_mjx.control.obstacles import clearance_at, footprint_points
from shmoo_mjx.control.presets import PushConfig
from shmoo_mjx.dynamics import contact_model, features, object_model
from shmoo_mjx.dynamics.core import CoreConfig, Params
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import touches
from shmoo_mjx.learning import online
from shmoo_mjx.learning.estimate import Sighting
from shmoo_mjx.learning.online import LearnerState, Transition
from shmoo_mjx.types import DT, SystemState

_PLANNING_HORIZON = 50
"""T of the planning stage, in samples (Sec. IV-B)."""
_LEANING_CLEARANCE = 0.10
"""Distance from a wall or another object at which the pushed one may lean on it [m]: the error of its pose, and how far
it goes until that is seen."""
_COAST_SAMPLES = 40
"""How far ahead `coast` looks, in samples: at the speed allowed near a goal the least drag stops anything sooner."""
_LEAST_DRAG = 0.08
"""Deceleration that any object has on any floor, whatever the model says [m/s^2]: a rolling resistance of 0.008."""


@partial(jax.tree_util.register_dataclass, data_fields=["params"], meta_fields=["config", "core", "mesh"])
@dataclass(frozen=True)
class PushModel:
    """What a push is computed with; a pytree of the learned parameters, all else is static."""

    config: PushConfig
    core: CoreConfig
    """Shapes of the learned model."""
    params: Params
    """The learned model."""
    mesh: Mesh | None = None
    """CPU devices that share the roll-outs (`sharding.rollout_mesh`)."""

    @property
    def learner(self) -> online.Learner:
        """How the object is learned."""
        return online.learner(self.core.object, self.config.estimate, self.config.adapt)

    def adapted(self, adapt: LearnerState) -> Params:
        """The parameters for roll-outs with the object of this estimate."""
        return self.learner.params_for_rollout(adapt, self.params)


class ControllerState(NamedTuple):
    """State of one push."""

    adapt: LearnerState
    """Estimate of the object's dynamics."""
    plan: mppi.MppiState
    before: SystemState
    """State one sample ago, with the memory it had then."""
    detected: Scalar
    """Whether the object was detected in that sample."""
    governor_integral: Scalar
    """Integral state of the governor's velocity loop [rad]."""


class Memory(NamedTuple):
    """The part of a push's state that `learn_and_plan` carries on."""

    adapt: LearnerState
    """Estimate of the object's dynamics."""
    plan: mppi.MppiState


class StepInputs(NamedTuple):
    """Inputs of `learn_and_plan`."""

    system: SystemState
    """The present state."""
    transition: Transition
    """The sample that just ended."""
    goal: Float[Array, "3"]
    """Desired object pose in {W}."""
    half_extents: Float[Array, "2"]
    """Of the object's footprint [m]."""
    lean: Float[Array, "2"]
    """The governor's bounds on the forward lean [rad]."""
    governor_integral: Scalar
    """The governor's integral after this sample [rad]."""


@single_precision
def start(
    config: PushConfig,
    adapt: LearnerState,
    obs: ObjectObservation,
    key: Key[Array, ""],
    *,
    face: Float[Array, "4"],
    half_extents: Float[Array, "2"],
) -> ControllerState:
    """The state with which a push on ``face`` begins; pure."""
    zero = np.zeros(3)
    before = _system_state(
        obs,
        last_object_twist=zero,
        last_wrench=se2.rotate(obs.wrench, -obs.object_pose[2]),  # while contact was made
        last_force=zero[:2],
        last_u=zero,
        face=face,
        half_extents=half_extents,
    )
    xp = se2.array_module(obs.wrench)
    plan = mppi.init(config.control, key)
    return ControllerState(online.relocated(adapt), plan, before, xp.asarray(obs.detected), xp.zeros(()))


@single_precision
def step(
    model: PushModel,
    state: ControllerState,
    obs: ObjectObservation,
    *,
    goal: Float[Array, "3"],
    last_u: Float[Array, "3"],
    half_extents: Float[Array, "2"],
    clearance: LocalDistanceField | None = None,
) -> tuple[Float[Array, "3"], ControllerState, mppi.Plan]:
    """One 10 Hz control step: adapt on the sample that ended, plan, and give the command.

    Args:
        model: settings and learned model.
        state: from `start` or the last step.
        obs: what is perceived now, with the wrench of the sample that ended.
        goal: desired object pose in {W}.
        last_u: what was applied during that sample.
        half_extents: of the object's footprint [m].
        clearance: distance to obstacles round the object, itself left out; None on a floor without any.

    Returns:
        The command u to apply now, the next state, and the plan: of its trajectories the object poses only.
    """
    inputs = step_inputs(model.config, state, obs, goal=goal, last_u=last_u, half_extents=half_extents)
    u, memory, plan = learn_and_plan(model, Memory(state.adapt, state.plan), inputs, clearance)
    return *bounded(u, inputs, memory), plan


def step_inputs(
    config: PushConfig,
    state: ControllerState,
    obs: ObjectObservation,
    *,
    goal: Float[Array, "3"],
    last_u: Float[Array, "3"],
    half_extents: Float[Array, "2"],
    governor_room: float | None = None,
) -> StepInputs:
    """What `learn_and_plan` needs of the world, in NumPy or JAX as it is given; arguments as for `step`.

    ``governor_room`` takes the place of the configuration's.
    """
    system, transition = _perceive(state, obs, last_u, half_extents)
    lean, integral = _governor_bounds(config, state, obs, goal, room=governor_room)
    return StepInputs(system, transition, _f32(goal), _f32(half_extents), lean, integral)


def learn_and_plan(
    model: PushModel, memory: Memory, inputs: StepInputs, clearance: LocalDistanceField | None
) -> tuple[Float[Array, "3"], Memory, mppi.Plan]:
    """Online learning (Eq. 8, or the posterior) and MPPI: u before the governor, the next memory, and the plan, whose
    trajectories are the object poses alone."""
    config, adapt = model.config, memory.adapt
    if config.adapts:
        adapt = model.learner.adapt(adapt, model.params, inputs.transition)
        if clearance is not None:
            # What a wall holds is not the object's friction.
            rim = footprint_points(inputs.system.object_pose, inputs.half_extents)
            leans = jnp.min(clearance_at(clearance, rim)) < _LEANING_CLEARANCE
            adapt = jax.tree.map(partial(jnp.where, leans), online.unchanged(memory.adapt, adapt), adapt)
    plan_state = memory.plan._replace(last_u=inputs.system.last_u)
    u, plan_state, plan = mppi.plan(
        config.control,
        _rollout_fn(model, adapt, inputs.lean if config.foresees_governor else None),
        _cost_fn(config, inputs.goal, clearance, inputs.half_extents),
        inputs.system,
        state=plan_state,
        share=model.mesh and partial(sharding.shared, model.mesh),
    )
    u, plan_state = sharding.on_all(model.mesh, (u, plan_state))
    # Of the roll-outs only the object poses are drawn; the rest would be copied for nobody.
    return u, Memory(adapt, plan_state), plan._replace(trajectories=plan.trajectories.object_pose)


def bounded(u: Float[Array, "3"], inputs: StepInputs, memory: Memory) -> tuple[Float[Array, "3"], ControllerState]:
    """The command within the governor's bounds, and the next state."""
    detected = inputs.transition.sighting.detected
    return govern(u, *inputs.lean), ControllerState(*memory, inputs.system, detected, inputs.governor_integral)


def planning_rollouts(
    model: PushModel,
    state: ControllerState,
    target: tuple[Float[Array, "3"], Float[Array, "2"]],
    clearance: LocalDistanceField | None,
) -> tuple[Float[Array, "S T 3"], Float[Array, "S T 2"], Float[Array, "S"]]:
    """The planning stage's roll-outs (T = 50) from the state of the last step: object poses and robot positions in {W},
    and costs. ``target`` is the goal, and the half extents of the object."""
    config, plan, (goal, half_extents) = model.config, state.plan, target
    extra = _PLANNING_HORIZON - config.control.horizon
    updated = mppi.update(
        replace(config.control, horizon=_PLANNING_HORIZON),
        _rollout_fn(model, state.adapt),
        _cost_fn(config, goal, clearance, half_extents),
        state.before,
        nominal=jnp.concatenate([plan.nominal, jnp.repeat(plan.nominal[-1:], extra, axis=0)]),
        last_u=plan.last_u,
        # Not 0 or 1: those are the keys that the next plan splits this one into.
        key=jax.random.fold_in(plan.key, 2),
        share=model.mesh and partial(sharding.shared, model.mesh),
    )
    return updated.trajectories.object_pose, updated.trajectories.robot_pose[..., :2], updated.costs


@single_precision
def coast(model: PushModel, adapt: LearnerState, state: SystemState) -> Float[Array, "3"]:
    """Pose in {W} at which the object comes to rest without a force; it slows down, and never turns back."""
    params, shape = model.adapted(adapt), model.core.object

    def free(inputs: Array) -> Array:
        # Where it comes to rest is for dry friction to say: the contact model has it, and psi a comes close to it only.
        if shape.contact_model:
            return contact_model.acceleration(params.contact, inputs)
        return object_model.predict(params.object, params.coefficients, inputs, shape, contact=params.contact)

    def one_sample(carry: Any, _: None) -> tuple[Any, None]:
        pose, twist, last, last_wrench = carry
        inside, none = se2.rotate(twist, -pose[2]), jnp.zeros(3)
        inputs = features.object_inputs(inside, none, last_twist=last, size=state.size, last_wrench=last_wrench)
        new = twist + se2.rotate(free(inputs), pose[2]) * DT
        speed = jnp.linalg.norm(twist[:2]) + 1e-6
        share = jnp.minimum(jnp.sum(new[:2] * twist[:2]) / speed**2, 1.0 - _LEAST_DRAG * DT / speed)
        new = jnp.maximum(share, 0.0) * twist
        return (pose + 0.5 * (twist + new) * DT, new, inside, none), None

    start = (state.object_pose, state.object_twist, state.last_object_twist, state.last_wrench)
    return jax.lax.scan(one_sample, start, None, length=_COAST_SAMPLES)[0][0]


def _perceive(
    state: ControllerState, obs: ObjectObservation, last_u: Array, half_extents: Array
) -> tuple[SystemState, Transition]:
    """The present state, and the sample that just ended."""
    before, xp = state.before, se2.array_module(obs.wrench)
    twist_before = se2.rotate(before.object_twist, -before.object_pose[2])
    wrench = se2.rotate(obs.wrench, -before.object_pose[2])
    force = se2.rotate(obs.wrench[:2], -before.robot_pose[2])
    # The camera's delay and the tracker's filter make what is seen late by some 0.1 s; what is felt is not.
    felt = xp.where(obs.age > 0, before.last_wrench, wrench)
    inputs = xp.concatenate(
        [twist_before, felt, before.last_object_twist, xp.asarray(before.size)[None], before.last_wrench]
    )
    label = se2.rotate((obs.object_twist - before.object_twist) / DT, -before.object_pose[2])
    # A pose that was carried on, now or a sample ago, says nothing about the object.
    measured = xp.asarray(obs.detected) & xp.asarray(state.detected)
    valid = xp.asarray(touches(obs.wrench) & measured)
    sighting = Sighting(
        obs.object_pose, obs.object_twist, xp.asarray(obs.age), xp.asarray(obs.detected), obs.wrench, before.size
    )
    system = _system_state(
        obs,
        last_object_twist=twist_before,
        last_wrench=wrench,
        last_force=force,
        last_u=last_u,
        face=before.face,
        half_extents=half_extents,
    )
    return system, Transition(_f32(inputs), _f32(label), valid, sighting)


def _governor_bounds(
    config: PushConfig, state: ControllerState, obs: ObjectObservation, goal: Array, *, room: float | None
) -> tuple[Array, Scalar]:
    """``[2]`` least and largest forward lean that may be commanded now [rad], and the governor's next integral."""
    low, high = config.control.low[0], config.control.high[0]
    offset = goal[:2] - obs.object_pose[:2]
    xp = se2.array_module(obs.wrench, offset)
    if not config.governor.gain:
        return xp.asarray([low, high]), state.governor_integral
    limit = config.speed.allowed(xp.hypot(offset[0], offset[1]))
    lean, integral = forward_lean(config.governor, obs, limit, state.governor_integral)
    lean, room = xp.clip(lean, low, high), config.governor_room if room is None else room
    if room < 1.0:
        # What sticks is leant into until it breaks away, whatever the model believes.
        room = room * xp.clip(xp.hypot(obs.robot_twist[0], obs.robot_twist[1]) / limit, 0.0, 1.0)
    return xp.stack([lean - room, lean]), integral


def _f32(x: Scalar | Array) -> Array:
    return se2.array_module(x).asarray(x, dtype=np.float32)


def _system_state(
    obs: ObjectObservation,
    *,
    last_object_twist: Array,
    last_wrench: Array,
    last_force: Array,
    last_u: Array,
    face: Array,
    half_extents: Array,
) -> SystemState:
    values = SystemState(
        robot_pose=obs.robot_pose,
        robot_twist=obs.robot_twist,
        lean=obs.lean,
        lean_rate=obs.lean_rate,
        object_pose=obs.object_pose,
        object_twist=obs.object_twist,
        last_object_twist=last_object_twist,
        last_wrench=last_wrench,
        last_force=last_force,
        last_u=last_u,
        face=face,
        size=se2.array_module(half_extents).hypot(half_extents[0], half_extents[1]),
    )
    return SystemState(*(_f32(v) for v in values))


def _rollout_fn(model: PushModel, adapt: LearnerState, lean: Array | None = None) -> mppi.RolloutFn:
    """The learned core for the object at hand; with the governor's bounds ``lean``, commands are bound as `bounded`
    binds them."""
    rollout_fn = models.learned(model.adapted(adapt), model.core)
    if lean is None:
        return rollout_fn
    return lambda state, controls: rollout_fn(state, govern(controls, *lean))


def _cost_fn(config: PushConfig, goal: Array, clearance: LocalDistanceField | None, half_extents: Array) -> mppi.CostFn:
    return push_cost(
        config.cost,
        goal,
        speed=config.speed,
        margins=config.margins,
        clearance=clearance,
        half_extents=half_extents,
    )
