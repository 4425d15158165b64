"""The pushing controller: the pure functions of `push_step`, compiled once for every map and object.

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
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.learning import online
from shmoo_mjx.learning.online import LearnerState
from shmoo_mjx.learning.weights import Weights, prior_state

_ZERO, _FLAT = np.zeros(3), np.zeros(2)
_HALF, _FACE = np.full(2, 0.3), faces_of((0.3, 0.3))[0]
_STILL = ObjectObservation(_ZERO, _ZERO, _FLAT, _FLAT, np.array([0.9, 0.0, 0.0]), _ZERO, _ZERO, np.array(True))
"""Robot and object at rest; for compiling."""


class PushController:
    """Compiled functions for one set of weights and one configuration; no state of its own."""

    @single_precision
    def __init__(self, weights: Weights, config: PushConfig | None = None) -> None:
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
        """Start a push on ``face``; ``adapt`` carries over what was learned of this object before, ``kind`` says what
        it looks like (`contact_prior.of_kind`)."""
        # Not 0 to 2, which MPPI and the planning stage take of this key.
        adapt = adapt or prior_state(self.weights, self.config.estimate, jax.random.fold_in(key, 3), kind)
        state = push_step.start(self.config, adapt, obs, key, face=face, half_extents=half_extents)
        # Placed as what `step` gives back is: it would else be compiled for either.
        adapt, plan = sharding.replicated(self._model.mesh, (state.adapt, state.plan))
        return state._replace(adapt=adapt, plan=plan)

    @single_precision
    def compile(self, clearance: LocalDistanceField) -> None:
        """Compile all that a push needs, for which the first contact waits otherwise; any ``clearance`` will do."""
        goal = np.array([1.9, 0.0, 0.0])
        _, key = jax.random.split(jax.random.key(0))
        state = self.init(_STILL, _FACE, _HALF, key)
        _, state, _ = self.step(state, _STILL, goal=goal, last_u=_ZERO, half_extents=_HALF, clearance=clearance)
        self.planning_rollouts(state, goal, clearance, _HALF)
        self.coast(state)

    def _example_inputs(self) -> StepInputs:
        """Inputs of a step; all have these shapes."""
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
        """`push_step.step`, compiled once: the command u to apply now, the next state, and the plan.

        Args:
            state: from ``init`` or the last step.
            obs: what is perceived now, with the wrench of the sample that ended.
            goal: desired object pose in {W}.
            last_u: what was applied during that sample.
            half_extents: of the object's footprint [m].
            clearance: distance to obstacles round the object, itself left out.
            governor_room: in place of the configuration's, for this step.
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
        # As one array: each costs time on its way to the device.
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
        """The planning stage's roll-outs (T = 50) from the state of the last step.

        Returns:
            Object poses, robot positions in {W} and costs.
        """
        target = np.asarray(goal, np.float32), np.asarray(half_extents, np.float32)
        poses, robots, costs = self._rollouts(self._model, state, target, clearance)
        return np.asarray(poses), np.asarray(robots), np.asarray(costs)

    @single_precision
    def coast(self, state: ControllerState) -> Float[np.ndarray, "3"]:
        """Where the object comes to rest in {W} if the hands let go of it now, as the adapted model has it."""
        return np.asarray(self._coast(self._model, state.adapt, state.before), dtype=float)
