"""Adaptive pushing (Sec. III-E) as pure functions: MPPI on the learned model with online learning of the object.

`start` begins a push, `step` is its 10 Hz control step, and `coast` predicts where a released object comes to rest. The
functions work under jit and vmap. :class:`~shmoo_mjx.control.pushing.PushController` compiles them for one world.
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
"""T of the planning stage (Sec. IV-B) [samples]."""
_LEANING_CLEARANCE = 0.10
"""Clearance below which the pushed object may touch a wall or another object [m]. It covers the error of the pose and
the motion until the next measurement."""
_COAST_SAMPLES = 40
"""Horizon of `coast` [samples]. At the allowed speed near a goal, the minimum drag stops every object sooner."""
_LEAST_DRAG = 0.08
"""Minimum deceleration of a coasting object [m/s^2], a rolling resistance of 0.008. Larger predicts less coasting."""


@partial(jax.tree_util.register_dataclass, data_fields=["params"], meta_fields=["config", "core", "mesh"])
@dataclass(frozen=True)
class PushModel:
    """Settings and learned model of a push. As a pytree it holds the learned parameters; all else is static."""

    config: PushConfig
    """Settings of the controller."""
    core: CoreConfig
    """Static options of the learned model."""
    params: Params
    """Parameters of the learned model."""
    mesh: Mesh | None = None
    """CPU devices that share the roll-outs (`sharding.rollout_mesh`)."""

    @property
    def learner(self) -> online.Learner:
        """The online learner of the object."""
        return online.learner(self.core.object, self.config.estimate, self.config.adapt)

    def adapted(self, adapt: LearnerState) -> Params:
        """The parameters for roll-outs with the estimate ``adapt`` of the object."""
        return self.learner.params_for_rollout(adapt, self.params)


class ControllerState(NamedTuple):
    """State of one push."""

    adapt: LearnerState
    """Estimate of the object's dynamics."""
    plan: mppi.MppiState
    """State of MPPI."""
    before: SystemState
    """System state one sample ago, including its memory at that time."""
    detected: Scalar
    """True if the object was detected in that sample."""
    governor_integral: Scalar
    """Integral state of the governor's velocity loop [rad]."""


class Memory(NamedTuple):
    """The part of a push's state that `learn_and_plan` updates."""

    adapt: LearnerState
    """Estimate of the object's dynamics."""
    plan: mppi.MppiState
    """State of MPPI."""


class StepInputs(NamedTuple):
    """Inputs of `learn_and_plan`."""

    system: SystemState
    """Current system state."""
    transition: Transition
    """The sample that has just ended."""
    goal: Float[Array, "3"]
    """Desired object pose in {W}."""
    half_extents: Float[Array, "2"]
    """Half length and half width of the object's footprint [m]."""
    lean: Float[Array, "2"]
    """Lower and upper bound of the forward lean from the governor [rad]."""
    governor_integral: Scalar
    """Integral state of the governor after this sample [rad]."""


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
    """The initial state of a push on ``face``. A pure function.

    Args:
        config: settings.
        adapt: estimate of the object's dynamics.
        obs: current observation.
        key: random key of all plans of the push.
        face: the pushed face in {O}: centre x, y [m], direction of the inward normal [rad], half width [m].
        half_extents: half length and half width of the object's footprint [m].
    """
    zero = np.zeros(3)
    before = _system_state(
        obs,
        last_object_twist=zero,
        last_wrench=se2.rotate(obs.wrench, -obs.object_pose[2]),  # measured while contact was established
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
    """One 10 Hz control step: adapt on the last sample, plan, and compute the command.

    Args:
        model: settings and learned model.
        state: result of `start` or of the last step.
        obs: current observation, with the wrench of the last sample.
        goal: desired object pose in {W}.
        last_u: command applied during the last sample [rad].
        half_extents: half length and half width of the object's footprint [m].
        clearance: distance to obstacles around the object, without the object itself; None for a floor without
            obstacles.

    Returns:
        The command u to apply now, the next state, and the plan. The trajectories of the plan hold only object poses.
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
    """The inputs of `learn_and_plan`, as NumPy or JAX arrays like the arguments.

    The arguments are those of `step`. ``governor_room`` replaces the value in the configuration.
    """
    system, transition = _perceive(state, obs, last_u, half_extents)
    lean, integral = _governor_bounds(config, state, obs, goal, room=governor_room)
    return StepInputs(system, transition, _f32(goal), _f32(half_extents), lean, integral)


def learn_and_plan(
    model: PushModel, memory: Memory, inputs: StepInputs, clearance: LocalDistanceField | None
) -> tuple[Float[Array, "3"], Memory, mppi.Plan]:
    """One step of online learning (Eq. 8, or the posterior) and of MPPI.

    Args:
        model: settings and learned model.
        memory: memory after the last step.
        inputs: result of `step_inputs`.
        clearance: distance to obstacles around the object; None for a floor without obstacles.

    Returns:
        The command u before the governor, the next memory, and the plan. The trajectories of the plan hold only object
        poses.
    """
    config, adapt = model.config, memory.adapt
    if config.adapts:
        adapt = model.learner.adapt(adapt, model.params, inputs.transition)
        if clearance is not None:
            # Do not learn while the object may touch a wall: the wall's reaction is not friction of the object.
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
    # Return only the object poses of the roll-outs. Nothing uses the rest, and copying it takes time.
    return u, Memory(adapt, plan_state), plan._replace(trajectories=plan.trajectories.object_pose)


def bounded(u: Float[Array, "3"], inputs: StepInputs, memory: Memory) -> tuple[Float[Array, "3"], ControllerState]:
    """The command clipped to the governor's bounds, and the next state."""
    detected = inputs.transition.sighting.detected
    return govern(u, *inputs.lean), ControllerState(*memory, inputs.system, detected, inputs.governor_integral)


def planning_rollouts(
    model: PushModel,
    state: ControllerState,
    target: tuple[Float[Array, "3"], Float[Array, "2"]],
    clearance: LocalDistanceField | None,
) -> tuple[Float[Array, "S T 3"], Float[Array, "S T 2"], Float[Array, "S"]]:
    """Roll-outs of the planning stage (T = 50) from the state of the last step.

    Args:
        model: settings and learned model.
        state: state after the last step.
        target: goal pose in {W}, and half extents of the object [m].
        clearance: distance to obstacles around the object; None for a floor without obstacles.

    Returns:
        Object poses and robot positions in {W}, and costs.
    """
    config, plan, (goal, half_extents) = model.config, state.plan, target
    extra = _PLANNING_HORIZON - config.control.horizon
    updated = mppi.update(
        replace(config.control, horizon=_PLANNING_HORIZON),
        _rollout_fn(model, state.adapt),
        _cost_fn(config, goal, clearance, half_extents),
        state.before,
        nominal=jnp.concatenate([plan.nominal, jnp.repeat(plan.nominal[-1:], extra, axis=0)]),
        last_u=plan.last_u,
        # Use 2, because the next plan splits this key into the streams 0 and 1.
        key=jax.random.fold_in(plan.key, 2),
        share=model.mesh and partial(sharding.shared, model.mesh),
    )
    return updated.trajectories.object_pose, updated.trajectories.robot_pose[..., :2], updated.costs


@single_precision
def coast(model: PushModel, adapt: LearnerState, state: SystemState) -> Float[Array, "3"]:
    """Pose in {W} at which the coasting object comes to rest. Its speed decreases and never changes sign."""
    params, shape = model.adapted(adapt), model.core.object

    def free(inputs: Array) -> Array:
        # Dry friction determines where the object stops. The contact model has it; psi a only approximates it.
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
    """The current system state and the sample that has just ended."""
    before, xp = state.before, se2.array_module(obs.wrench)
    twist_before = se2.rotate(before.object_twist, -before.object_pose[2])
    wrench = se2.rotate(obs.wrench, -before.object_pose[2])
    force = se2.rotate(obs.wrench[:2], -before.robot_pose[2])
    # Visual measurements are about 0.1 s late because of the camera's delay and the tracker's filter. The sensed wrench
    # is not, so it is taken from one sample earlier.
    felt = xp.where(obs.age > 0, before.last_wrench, wrench)
    inputs = xp.concatenate(
        [twist_before, felt, before.last_object_twist, xp.asarray(before.size)[None], before.last_wrench]
    )
    label = se2.rotate((obs.object_twist - before.object_twist) / DT, -before.object_pose[2])
    # An extrapolated pose, now or one sample ago, carries no information about the object.
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
    """Lower and upper bound ``[2]`` of the commanded forward lean [rad], and the governor's next integral state."""
    low, high = config.control.low[0], config.control.high[0]
    offset = goal[:2] - obs.object_pose[:2]
    xp = se2.array_module(obs.wrench, offset)
    if not config.governor.gain:
        return xp.asarray([low, high]), state.governor_integral
    limit = config.speed.allowed(xp.hypot(offset[0], offset[1]))
    lean, integral = forward_lean(config.governor, obs, limit, state.governor_integral)
    lean, room = xp.clip(lean, low, high), config.governor_room if room is None else room
    if room < 1.0:
        # At rest the plan must follow the governor's lean, so that a stuck object breaks away even if the model is
        # wrong.
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
    """Roll-out function with the estimate ``adapt`` of the object.

    With the governor's bounds ``lean``, commands are clipped as in `bounded`.
    """
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
