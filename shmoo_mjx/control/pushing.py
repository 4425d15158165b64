"""The pushing controller: the pure functions of `push_step`, compiled once for all maps and objects.

All memory is in ``ControllerState``.
"""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from jax.flatten_util import ravel_pytree

from shmoo_mjx.arrays import Array, Float, Key, single_precision
from shmoo_mjx.base.verbosity import LOG
from shmoo_mjx.control import mppi, push_step, sharding
from shmoo_mjx.control.observation import LocalDistanceField, ObjectObservation
from shmoo_mjx.control.presets import PushConfig
from shmoo_mjx.control.push_step import ControllerState, Memory, PushModel, StepInputs
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.learning import online
from shmoo_mjx.learning.online import LearnerState
from shmoo_mjx.learning.weights import Weights, prior_state

_ZERO, _FLAT = np.zeros(3), np.zeros(2)
_HALF, _FACE = np.full(2, 0.3), faces_of((0.3, 0.3))[0]
_STILL = ObjectObservation(_ZERO, _ZERO, _FLAT, _FLAT, np.array([0.9, 0.0, 0.0]), _ZERO, _ZERO, np.array(True))
"""Example observation for compilation: robot and object at rest."""


class PushController:
    """Compiled functions of the pushing controller for one set of weights and one configuration. It has no state.

    Args:
        weights: trained weights.
        config: settings; by default those for pushing an object aside.

    Raises:
        ShmooError: ``weights`` is something else, such as the path of a file.
    """

    @single_precision
    def __init__(self, weights: Weights, config: PushConfig | None = None) -> None:
        if not isinstance(weights, Weights):
            kind = type(weights).__name__
            raise ShmooError(f"PushController: 'weights' is of type {kind}; give the result of load_weights(FILE).")
        self.config = config or PushConfig()
        self.weights = weights
        mesh = sharding.rollout_mesh(self.config.control.num_rollouts)
        self._model = PushModel(self.config, weights.config, sharding.replicated(mesh, weights.params), mesh)
        _, unpack = ravel_pytree(self._example_inputs())

        def learn_and_plan(model: PushModel, memory: Memory, numbers: jax.Array, clearance: Any) -> Any:
            return push_step.learn_and_plan(model, memory, unpack(numbers), clearance)

        self._learn_and_plan = sharding.compiled(learn_and_plan, mesh)
        self._rollouts = sharding.compiled(push_step.planning_rollouts, mesh)
        self._coast = jax.jit(push_step.coast)

    @single_precision
    def init(
        self,
        obs: ObjectObservation,
        face: Float[Array, "4"],
        half_extents: Float[Array, "2"],
        key: Key[Array, ""],
        *,
        adapt: LearnerState | None = None,
        kind: str | None = None,
    ) -> ControllerState:
        """The initial state of a push on ``face``.

        Args:
            obs: current observation.
            face: the pushed face in {O}: centre x, y [m], direction of the inward normal [rad], half width [m].
            half_extents: half length and half width of the object's footprint [m].
            key: random key of the push.
            adapt: estimate of this object from earlier pushes; the prior if None.
            kind: kind of the object by its appearance, for the prior (`contact_prior.of_kind`).
        """
        # Use 3, because MPPI and the planning stage use the streams 0 to 2 of this key.
        adapt = adapt or prior_state(self.weights, self.config.estimate, jax.random.fold_in(key, 3), kind)
        state = push_step.start(self.config, adapt, obs, key, face=face, half_extents=half_extents)
        # Use the same device placement as the results of `step`, to avoid a second compilation.
        adapt, plan = sharding.replicated(self._model.mesh, (state.adapt, state.plan))
        return state._replace(adapt=adapt, plan=plan)

    @single_precision
    def resumed(self, state: ControllerState) -> ControllerState:
        """The ``state`` of a push by another controller, for this one.

        The controllers may differ in the settings of MPPI only. The warm start is cut to this horizon, or its last
        control is repeated.
        """
        extra, nominal = self.config.control.horizon - len(state.plan.nominal), np.asarray(state.plan.nominal)
        nominal = np.concatenate([nominal, np.repeat(nominal[-1:], max(extra, 0), axis=0)])[
            : self.config.control.horizon
        ]
        memory = state.adapt, state.plan._replace(nominal=nominal)
        adapt, plan = sharding.replicated(self._model.mesh, jax.device_put(memory, jax.devices()[0]))
        return state._replace(adapt=adapt, plan=plan)

    @single_precision
    def compile(self, clearance: LocalDistanceField) -> None:
        """Compile all functions of a push in advance, to avoid a delay at the first contact.

        ``clearance`` can be any field, because all fields have the same shape.
        """
        goal = np.array([1.9, 0.0, 0.0])
        _, key = jax.random.split(jax.random.key(0))
        state = self.init(_STILL, _FACE, _HALF, key)
        _, state, _ = self.step(state, _STILL, goal=goal, last_u=_ZERO, half_extents=_HALF, clearance=clearance)
        self.planning_rollouts(state, goal, clearance, _HALF)
        self.coast(state)

    def _example_inputs(self) -> StepInputs:
        """Example inputs of a step, with the shapes that all steps have."""
        state = push_step.start(
            self.config,
            prior_state(self.weights, self.config.estimate),
            _STILL,
            jax.random.key(0),
            face=_FACE,
            half_extents=_HALF,
        )
        return push_step.step_inputs(self.config, state, _STILL, goal=_ZERO, last_u=_ZERO, half_extents=_HALF)

    @single_precision
    def step(
        self,
        state: ControllerState,
        obs: ObjectObservation,
        *,
        goal: Float[Array, "3"],
        last_u: Float[Array, "3"],
        half_extents: Float[Array, "2"],
        clearance: LocalDistanceField | None,
        governor_room: float | None = None,
    ) -> tuple[Float[np.ndarray, "3"], ControllerState, mppi.Plan]:
        """One 10 Hz control step: `push_step.step`, compiled.

        Args:
            state: result of ``init`` or of the last step.
            obs: current observation, with the wrench of the last sample.
            goal: desired object pose in {W}.
            last_u: command applied during the last sample [rad].
            half_extents: half length and half width of the object's footprint [m].
            clearance: distance to obstacles around the object, without the object itself.
            governor_room: replaces the value in the configuration for this step.

        Returns:
            The command u to apply now [rad], the next state, and the plan.
        """
        inputs = push_step.step_inputs(
            self.config,
            state,
            obs,
            goal=np.asarray(goal, dtype=float),
            last_u=last_u,
            half_extents=half_extents,
            governor_room=governor_room,
        )
        # Pass all inputs as one array, because each transfer to the device takes time.
        numbers = np.concatenate([np.ravel(x) for x in jax.tree.leaves(inputs)], dtype=np.float32)
        u, memory, plan = self._learn_and_plan(self._model, Memory(state.adapt, state.plan), numbers, clearance)
        if online.restarts(memory.adapt) > online.restarts(state.adapt):
            LOG.warning("the estimate of the pushed object had lost all weight and begins anew from the prior")
        command, after = push_step.bounded(np.asarray(u, dtype=float), inputs, memory)
        return np.asarray(command), after, plan

    @single_precision
    def planning_rollouts(
        self,
        state: ControllerState,
        goal: Float[Array, "3"],
        clearance: LocalDistanceField,
        half_extents: Float[Array, "2"],
    ) -> tuple[Float[np.ndarray, "S T 3"], Float[np.ndarray, "S T 2"], Float[np.ndarray, "S"]]:
        """Roll-outs of the planning stage (T = 50) from the state of the last step.

        Returns:
            Object poses and robot positions in {W}, and costs.
        """
        target = np.asarray(goal, np.float32), np.asarray(half_extents, np.float32)
        poses, robots, costs = self._rollouts(self._model, state, target, clearance)
        return np.asarray(poses), np.asarray(robots), np.asarray(costs)

    @single_precision
    def coast(self, state: ControllerState) -> Float[np.ndarray, "3"]:
        """Pose in {W} at which the object comes to rest if it is released now, predicted by the adapted model."""
        return np.asarray(self._coast(self._model, state.adapt, state.before), dtype=float)
