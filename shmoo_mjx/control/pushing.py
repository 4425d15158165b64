"""Adaptive pushing (Sec. III-E): MPPI on the learned core while the object's dynamics are learned.

``PushController`` compiles the two functions a push needs, once for every map and object: the 10 Hz step (adapt, plan,
command) and the planning stage's roll-outs, which the object planner judges. All memory is in ``ControllerState``.
``start``, ``step`` and ``coast`` are the same push as pure functions, for whoever maps it over many worlds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from shmoo_mjx.arrays import Array, Float, Key, Scalar, single_precision
from shmoo_mjx.base.verbosity import LOG
from shmoo_mjx.control import cost, models, mppi, sharding
from shmoo_mjx.control.governor import GovernorConfig, forward_lean, govern
from shmoo_mjx.control.observation import LocalDistanceField, ObjectObservation
from shmoo_mjx.dynamics import contact_model, core, features, object_model
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.geometry.hands import touches
from shmoo_mjx.learning import adaptation, online
from shmoo_mjx.learning.estimate import EstimateConfig, Sighting
from shmoo_mjx.learning.online import Known, Transition
from shmoo_mjx.learning.weights import Weights, prior_state
from shmoo_mjx.types import DT, SystemState

_PLANNING_HORIZON = 50
"""T of the planning stage, in samples (Sec. IV-B)."""
_LEANS = 0.10
"""Distance from a wall or another object at which the pushed one may lean on it [m]: the error of its pose, and how far
it goes until that is seen."""
_COAST_SAMPLES = 40
"""How far ahead `coast` looks, in samples: at the speed allowed near a goal the least drag stops anything sooner."""
_LEAST_DRAG = 0.08
"""Deceleration that any object has on any floor, whatever the model says [m/s^2]: a rolling resistance of 0.008."""


@dataclass(frozen=True)
class PushConfig:
    """Settings of the pushing controller; the paper's values where it gives them."""

    control: mppi.MppiConfig = mppi.MppiConfig(
        cost_scale=40.0,
        sigma=(0.04, 0.03, 0.20),
        low=(-0.15, -0.10, -0.45),
        high=(0.15, 0.10, 0.45),
        noise_correlation=0.9,
    )
    cost: cost.PushCost = cost.PushCost(
        yaw_weight=0.0,
        effort=0.002,
        change=0.01,
        running_weight=1.0,
        clearance_weight=15.0,
        object_margin=0.06,
        robot_margin=0.30,
        clearance_stride=3,
        lateral_weight=0.2,
        heading_weight=0.1,
        aim_weight=2.0,
        speed_weight=1.0,
        overspeed_weight=15.0,
        speed_limit=0.25,
    )
    estimate: EstimateConfig = EstimateConfig()
    """How contact parameters are learned (`online.Posterior`)."""
    adapt: adaptation.AdaptConfig = field(default_factory=adaptation.AdaptConfig)
    """How a psi without contact model learns (`online.Printed`)."""
    adapts: bool = True
    """False leaves what is known of the object as it is, for comparison."""
    governor: GovernorConfig = GovernorConfig()
    """Bounds on the forward lean."""
    governor_room: float = 1.0
    """Largest distance of the plan below the governor's lean [rad]; more leaves more to the plan, 1 is no bound."""
    foresees_governor: bool = False
    """Roll-outs lean within the governor's present bounds too. Otherwise they foresee firmer pushes than there will be,
    and believe that steering turns what hardly resists."""

    def light(self) -> PushConfig:
        """The preset for small computers: these settings with 128 roll-outs in place of 500. Of 24 pushes as many
        succeed, and end 1.5 cm farther off (``benchmarks/rollouts.py``)."""
        return replace(self, control=replace(self.control, num_rollouts=128))


_ZERO, _FLAT = np.zeros(3), np.zeros(2)
_STILL = ObjectObservation(_ZERO, _ZERO, _FLAT, _FLAT, np.array([0.9, 0.0, 0.0]), _ZERO, _ZERO, np.array(True))
"""Robot and object at rest; for compiling."""


class ControllerState(NamedTuple):
    """State of one push."""

    adapt: Known
    plan: mppi.MppiState
    before: SystemState
    """State one sample ago, with the memory it had then."""
    detected: Scalar
    """Whether the object was detected in that sample."""
    more: Scalar
    """Lean that the governor grants for lagging behind [rad]."""


class _Given(NamedTuple):
    """What a step is given of the world: some seventy numbers, which reach the compiled step as one array."""

    system: SystemState
    transition: Transition
    goal: Float[Array, "3"]
    half_extents: Float[Array, "2"]
    lean: Float[Array, "2"]
    """Bounds on the forward lean, from the governor."""


class PushController:
    """Compiled functions for one set of weights and one configuration; no state of its own."""

    @single_precision
    def __init__(self, weights: Weights, config: PushConfig | None = None) -> None:
        self.config = config or PushConfig()
        self.weights = weights
        self._mesh = sharding.rollout_mesh(self.config.control.num_rollouts)
        self._params = sharding.replicated(self._mesh, weights.params)
        _, restored = ravel_pytree(self._example())

        def adapt_and_plan(params: core.Params, adapt: Any, plan: mppi.MppiState, numbers: Array, around: Any) -> Any:
            given = restored(numbers)
            return _adapt_and_plan(self.config, weights.config, self._mesh, params, adapt, plan, given, around)

        self._compiled = sharding.compiled(adapt_and_plan, self._mesh)
        self._rollouts = sharding.compiled(
            partial(_planning_rollouts, self.config, weights.config, self._mesh), self._mesh
        )
        self._coast = jax.jit(partial(coast, self.config, weights.config))

    @single_precision
    def init(
        self,
        obs: ObjectObservation,
        face: Float[Array, "4"],
        half_extents: Float[Array, "2"],
        key: Key[Array, ""],
        adapt: Known | None = None,
        kind: str | None = None,
    ) -> ControllerState:
        """Start a push on ``face``; ``adapt`` carries over what was learned of this object before, ``kind`` says what
        it looks like (`contact_prior.of_kind`)."""
        # Not 0 to 2, which MPPI and the planning stage take of this key.
        adapt = adapt or prior_state(self.weights, self.config.estimate, jax.random.fold_in(key, 3), kind)
        state = start(self.config, adapt, obs, face, half_extents, key)
        # Placed as what `step` gives back is: it would else be compiled for either.
        adapt, plan = sharding.replicated(self._mesh, (state.adapt, state.plan))
        return state._replace(adapt=adapt, plan=plan)

    @single_precision
    def compile(self, around: LocalDistanceField) -> None:
        """Compile all that a push needs, for which the first contact waits otherwise; any ``around`` will do."""
        goal, half = np.array([1.9, 0.0, 0.0]), np.full(2, 0.3)
        _, key = jax.random.split(jax.random.key(0))
        state = self.init(_STILL, faces_of((0.3, 0.3))[0], half, key)
        _, state, _ = self.step(state, _STILL, np.zeros(3), goal, around, half)
        self.planning_rollouts(state, goal, around, half)
        self.coast(state)

    def _example(self) -> _Given:
        """What a step may be given; its shapes are those of all."""
        half = np.full(2, 0.3)
        state = self.init(_STILL, faces_of((0.3, 0.3))[0], half, jax.random.key(0))
        return _given(self.config, state, _STILL, np.zeros(3), np.zeros(3), half)[0]

    @single_precision
    def step(
        self,
        state: ControllerState,
        obs: ObjectObservation,
        last_u: Float[Array, "3"],
        goal: Float[Array, "3"],
        around: LocalDistanceField,
        half_extents: Float[Array, "2"],
        governor_room: float | None = None,
    ) -> tuple[Float[np.ndarray, "3"], ControllerState, mppi.Plan]:
        """`step`, compiled once: the command u to apply now, the next state, and the plan.

        Args:
            state: from ``init`` or the last step.
            obs: what is perceived now, with the wrench of the sample that ended.
            last_u: what was applied during that sample.
            goal: desired object pose in {W}.
            around: clearance round the object, the object itself left out.
            half_extents: of the object's footprint [m].
            governor_room: in place of the configuration's, for this step.
        """
        u, after, plan = step(
            self.config, self.weights.config, self._params, state, obs, np.asarray(goal, dtype=float), last_u,
            half_extents, around, governor_room, self._adapt_and_plan,
        )  # fmt: skip
        if online.restarts(after.adapt) > online.restarts(state.adapt):
            LOG.warning("the estimate of the pushed object had lost all weight and begins anew from the prior")
        return np.asarray(u), after, plan

    def _adapt_and_plan(
        self, params: core.Params, adapt: Any, plan: mppi.MppiState, given: _Given, around: LocalDistanceField | None
    ) -> Any:
        """The compiled part of a step; what it is given travels as one array."""
        numbers = np.concatenate([np.ravel(x) for x in jax.tree.leaves(given)], dtype=np.float32)
        u, *rest = self._compiled(params, adapt, plan, numbers, around)
        return np.asarray(u, dtype=float), *rest

    @single_precision
    def planning_rollouts(
        self,
        state: ControllerState,
        goal: Float[Array, "3"],
        around: LocalDistanceField,
        half_extents: Float[Array, "2"],
    ) -> tuple[Float[np.ndarray, "S T 3"], Float[np.ndarray, "S T 2"], Float[np.ndarray, "S"]]:
        """The planning stage's roll-outs (T = 50) from the state of the last step.

        Returns:
            Object poses, robot positions in {W} and costs.
        """
        poses, robots, costs = self._rollouts(
            self._params, state.adapt, state.plan, state.before, _f32(goal), around, _f32(half_extents)
        )
        return np.asarray(poses), np.asarray(robots), np.asarray(costs)

    @single_precision
    def coast(self, state: ControllerState) -> Float[np.ndarray, "3"]:
        """Where the object comes to rest in {W} if the hands let go of it now, as the adapted model has it."""
        return np.asarray(self._coast(self.weights.params, state.adapt, state.before), dtype=float)


@single_precision
def start(
    config: PushConfig,
    adapt: Known,
    obs: ObjectObservation,
    face: Float[Array, "4"],
    half_extents: Float[Array, "2"],
    key: Key[Array, ""],
) -> ControllerState:
    """The state with which a push on ``face`` begins; pure."""
    zero = np.zeros(3)
    felt = se2.rotate(obs.wrench, -obs.object_pose[2])  # while contact was made
    before = _system_state(obs, zero, felt, zero[:2], zero, face, half_extents)
    xp = se2.array_module(obs.wrench)
    return ControllerState(
        online.relocated(adapt), mppi.init(config.control, key), before, xp.asarray(obs.detected), xp.zeros(())
    )


@single_precision
def step(
    config: PushConfig,
    core_config: Any,
    params: core.Params,
    state: ControllerState,
    obs: ObjectObservation,
    goal: Float[Array, "3"],
    last_u: Float[Array, "3"],
    half_extents: Float[Array, "2"],
    around: LocalDistanceField | None = None,
    governor_room: float | None = None,
    adapt_and_plan: Callable[..., Any] | None = None,
) -> tuple[Float[Array, "3"], ControllerState, mppi.Plan]:
    """One 10 Hz control step, pure, for jit and vmap: adapt on the sample that ended, plan, and give the command.

    Args:
        config: static settings.
        core_config: shapes of the learned model; static.
        params: the learned model.
        state: from `start` or the last step.
        obs: what is perceived now, with the wrench of the sample that ended.
        goal: desired object pose in {W}.
        last_u: what was applied during that sample.
        half_extents: of the object's footprint [m].
        around: clearance round the object, the object itself left out; None on a floor without obstacles.
        governor_room: in place of the configuration's, for this step.
        adapt_and_plan: a compiled version of the online learning and MPPI in it; PushController's.

    Returns:
        The command u to apply now, the next state, and the plan: of its trajectories the object poses only.
    """
    run = adapt_and_plan or partial(_adapt_and_plan, config, core_config, None)
    given, more = _given(config, state, obs, last_u, goal, half_extents, governor_room)
    u, adapt, plan_state, plan = run(params, state.adapt, state.plan, given, around)
    detected = se2.array_module(u).asarray(obs.detected)
    return govern(u, *given.lean), ControllerState(adapt, plan_state, given.system, detected, more), plan


def _given(
    config: PushConfig,
    state: ControllerState,
    obs: ObjectObservation,
    last_u: Array,
    goal: Array,
    half_extents: Array,
    room: float | None = None,
) -> tuple[_Given, Scalar]:
    """What the step is given, and the lean that the governor grants next for lagging behind [rad]."""
    system, transition = _perceive(config, state, obs, last_u, half_extents)
    lean, more = _governor(config, obs, goal, state.more, room)
    return _Given(system, transition, _f32(goal), _f32(half_extents), lean), more


def _perceive(
    config: PushConfig, state: ControllerState, obs: ObjectObservation, last_u: Array, half_extents: Array
) -> tuple[SystemState, Transition]:
    before, xp = state.before, se2.array_module(obs.wrench)
    twist_before = se2.rotate(before.object_twist, -before.object_pose[2])
    wrench = se2.rotate(obs.wrench, -before.object_pose[2])
    force = se2.rotate(obs.wrench[:2], -before.robot_pose[2])
    # The camera's delay and the tracker's filter make what is seen late by some 0.1 s; what is felt is not.
    felt = xp.where(obs.age > 0, before.last_wrench, wrench)
    inputs = xp.concatenate([twist_before, felt, before.last_object_twist, before.size[None], before.last_wrench])
    label = se2.rotate((obs.object_twist - before.object_twist) / DT, -before.object_pose[2])
    # A pose that was carried on, now or a sample ago, says nothing about the object.
    measured = xp.asarray(obs.detected) & xp.asarray(state.detected)
    valid = xp.asarray(touches(obs.wrench) & measured)
    seen = Sighting(
        obs.object_pose, obs.object_twist, xp.asarray(obs.age), xp.asarray(obs.detected), obs.wrench, before.size
    )
    system = _system_state(obs, twist_before, wrench, force, last_u, before.face, half_extents)
    return system, Transition(_f32(inputs), _f32(label), valid, seen)


def _governor(
    config: PushConfig, obs: ObjectObservation, goal: Array, more: Scalar, room: float | None = None
) -> tuple[Array, Scalar]:
    """``[2]`` least and largest forward lean that may be commanded now, and what it grants for lagging behind [rad]."""
    low, high = config.control.low[0], config.control.high[0]
    offset = goal[:2] - obs.object_pose[:2]
    xp = se2.array_module(obs.wrench, offset)
    if not config.governor.gain:
        return xp.asarray([low, high]), more
    limit = cost.allowed_speed(config.cost, xp.hypot(offset[0], offset[1]))
    lean, more = forward_lean(config.governor, obs.robot_pose, obs.robot_twist, obs.lean_rate, obs.wrench, limit, more)
    lean, room = xp.clip(lean, low, high), config.governor_room if room is None else room
    if room < 1.0:
        # What sticks is leant into until it breaks away, whatever the model believes.
        room = room * xp.clip(xp.hypot(obs.robot_twist[0], obs.robot_twist[1]) / limit, 0.0, 1.0)
    return xp.stack([lean - room, lean]), more


def _f32(x: Scalar | Array) -> Array:
    return se2.array_module(x).asarray(x, dtype=np.float32)


def _system_state(
    obs: ObjectObservation,
    last_twist: Array,
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
        last_object_twist=last_twist,
        last_wrench=last_wrench,
        last_force=last_force,
        last_u=last_u,
        face=face,
        size=se2.array_module(half_extents).hypot(half_extents[0], half_extents[1]),
    )
    return SystemState(*(_f32(v) for v in values))


def _learner(config: PushConfig, core_config: Any) -> online.Learner:
    return online.learner(core_config.object, config.estimate, config.adapt)


def _functions(
    config: PushConfig,
    core_config: Any,
    params: core.Params,
    goal: Array,
    around: LocalDistanceField | None,
    half_extents: Array,
    lean: Array | None = None,
) -> Any:
    def cost_fn(trajectory: SystemState, controls: Array, last_u: Array) -> Array:
        return cost.push_cost(config.cost, goal, trajectory, controls, last_u, around, half_extents)

    model = models.learned(params, core_config)
    if lean is None or not config.foresees_governor:
        return model, cost_fn
    # Bound by govern as the command will be.
    return lambda state, controls: model(state, govern(controls, *lean)), cost_fn


def _adapt_and_plan(
    config: PushConfig,
    core_config: Any,
    mesh: Any,
    params: core.Params,
    adapt: Known,
    plan_state: mppi.MppiState,
    given: _Given,
    around: LocalDistanceField | None,
) -> tuple[Array, Known, mppi.MppiState, mppi.Plan]:
    learner = _learner(config, core_config)
    if config.adapts:
        adapted = learner.adapt(adapt, params, given.transition)
        if around is not None:
            # What a wall holds is not the object's friction.
            rim = cost.footprint_points(given.system.object_pose, given.half_extents)
            leans = jnp.min(cost.clearance_at(around, rim)) < _LEANS
            adapted = jax.tree.map(partial(jnp.where, leans), online.unchanged(adapt, adapted), adapted)
        adapt = adapted
    params = learner.params_for_rollout(adapt, params)
    rollout_fn, cost_fn = _functions(config, core_config, params, given.goal, around, given.half_extents, given.lean)
    plan_state = plan_state._replace(last_u=given.system.last_u)
    u, plan_state, plan = mppi.plan(config.control, rollout_fn, cost_fn, given.system, plan_state, mesh)
    # Of the roll-outs only these are drawn; the rest would be copied for nobody.
    drawn = SystemState(*(None,) * len(SystemState._fields))._replace(object_pose=plan.trajectories.object_pose)
    return u, adapt, plan_state, plan._replace(trajectories=drawn)


def _planning_rollouts(
    config: PushConfig,
    core_config: Any,
    mesh: Any,
    params: core.Params,
    adapt: Known,
    plan_state: mppi.MppiState,
    system: SystemState,
    goal: Array,
    around: LocalDistanceField,
    half_extents: Array,
) -> tuple[Array, Array, Array]:
    longer = replace(config.control, horizon=_PLANNING_HORIZON)
    extra = _PLANNING_HORIZON - config.control.horizon
    nominal = jnp.concatenate([plan_state.nominal, jnp.repeat(plan_state.nominal[-1:], extra, axis=0)])
    params = _learner(config, core_config).params_for_rollout(adapt, params)
    rollout_fn, cost_fn = _functions(config, core_config, params, goal, around, half_extents)
    # Not 0 or 1: those are the keys that the next plan splits this one into.
    key = jax.random.fold_in(plan_state.key, 2)
    plan = mppi.update(longer, rollout_fn, cost_fn, system, nominal, plan_state.last_u, key, mesh)
    return plan.trajectories.object_pose, plan.trajectories.robot_pose[..., :2], plan.costs


@single_precision
def coast(
    config: PushConfig, core_config: Any, params: core.Params, adapt: Known, state: SystemState
) -> Float[Array, "3"]:
    """Pose in {W} at which the object comes to rest without a force; it slows down, and never turns back."""
    params = _learner(config, core_config).params_for_rollout(adapt, params)

    def free(inputs: Array) -> Array:
        # Where it comes to rest is for dry friction to say: the contact model has it, and psi a comes close to it only.
        if core_config.object.contact_model:
            return contact_model.acceleration(params.contact, inputs)
        return object_model.predict(params.object, params.coefficients, inputs, core_config.object, params.contact)

    def one_sample(carry: tuple[Array, ...], _: None) -> tuple[tuple[Array, ...], None]:
        pose, twist, last, last_wrench = carry
        inside, none = se2.rotate(twist, -pose[2]), jnp.zeros(3)
        inputs = features.object_inputs(inside, none, last, state.size, last_wrench)
        push = free(inputs)
        new = twist + se2.rotate(push, pose[2]) * DT
        speed = jnp.linalg.norm(twist[:2]) + 1e-6
        kept = jnp.minimum(jnp.sum(new[:2] * twist[:2]) / speed**2, 1.0 - _LEAST_DRAG * DT / speed)
        new = jnp.maximum(kept, 0.0) * twist
        return (pose + 0.5 * (twist + new) * DT, new, inside, none), None

    start = (state.object_pose, state.object_twist, state.last_object_twist, state.last_wrench)
    return jax.lax.scan(one_sample, start, None, length=_COAST_SAMPLES)[0][0]
