"""Online learning of the pushed object: two learners with one protocol.

`Posterior` estimates the contact parameters, for a psi with the contact model. The coefficients keep their values from
training. `Printed` estimates the coefficients of the paper's psi by Eq. 8.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.dynamics import contact_model, object_model
from shmoo_mjx.dynamics.core import Params
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.geometry import se2
from shmoo_mjx.learning import adaptation, estimate
from shmoo_mjx.learning.adaptation import AdaptConfig, AdaptState
from shmoo_mjx.learning.estimate import EstimateConfig, ObjectEstimate, Sighting

_BELIEVABLE = 1e4
"""Magnitude from which on a sample is treated as invalid [SI units]. It is far above any value of this robot."""
BAND = (0.1, 0.5, 0.9)
"""Quantiles in `summary`: the median and an 80 % interval."""

NAMES = tuple(f"{name}{end}" for name in ("mass", "friction_x", "friction_y") for end in ("_low", "", "_high"))
"""Keys of `summary` for a posterior over contact parameters."""

LearnerState = ObjectEstimate | AdaptState
"""Estimate of an object's dynamics, a pytree."""


class Transition(NamedTuple):
    """The sample that has just ended, input of a learner."""

    inputs: Float[Array, "13"]
    """Inputs of psi at the start of the sample, with the measured wrench."""
    label: Float[Array, "3"]
    """Measured acceleration in {O} [m/s^2, m/s^2, rad/s^2]."""
    valid: Scalar
    """False without contact, or with stale or missing poses. Inputs and label are then not used."""
    sighting: Sighting
    """Measurements of the object at the end of the sample."""


@runtime_checkable
class Learner(Protocol):
    """An online learner of an object. It is hashable and has no state."""

    def adapt(self, state: Any, params: Params, sample: Transition) -> Any:
        """The estimate after one more sample. A non-finite sample changes no estimate. A pure function."""

    def params_for_rollout(self, state: Any, params: Params) -> Params:
        """The parameters of the dynamics model for the estimated object."""


@dataclass(frozen=True)
class Posterior:
    """Particle posterior over the contact parameters (`estimate`). Roll-outs use its mean."""

    config: EstimateConfig = EstimateConfig()
    """Settings of the particle filter."""

    def adapt(self, state: ObjectEstimate, params: Params, sample: Transition) -> ObjectEstimate:
        """See `Learner`."""
        return estimate.step(self.config, state, sample.sighting)

    def params_for_rollout(self, state: ObjectEstimate, params: Params) -> Params:
        """See `Learner`."""
        return params._replace(contact=estimate.mean(state))


@dataclass(frozen=True)
class Printed:
    """Estimate of the coefficients a of psi by Eq. 8."""

    shape: ObjectConfig
    """Structure of psi."""
    config: AdaptConfig = AdaptConfig()
    """Gains of Eq. 8."""

    def adapt(self, state: AdaptState, params: Params, sample: Transition) -> AdaptState:
        """See `Learner`."""
        inputs, label = sample.inputs, sample.label
        believable = jnp.all(jnp.abs(inputs) < _BELIEVABLE) & jnp.all(jnp.abs(label) < _BELIEVABLE)
        phi = object_model.design_matrix(params.object, inputs, self.shape, params.contact)
        return adaptation.step(self.config, state, phi, label, valid=jnp.asarray(sample.valid) & believable)

    def params_for_rollout(self, state: AdaptState, params: Params) -> Params:
        """See `Learner`."""
        return params._replace(coefficients=state.mean.reshape(params.coefficients.shape))


def learner(shape: ObjectConfig, contact: EstimateConfig | None = None, adapt: AdaptConfig | None = None) -> Learner:
    """The learner for a psi of this ``shape``.

    Args:
        shape: structure of psi. With the contact model the learner is `Posterior`, without it `Printed`.
        contact: settings of `Posterior`.
        adapt: settings of `Printed`.
    """
    if shape.contact_model:
        return Posterior(contact or EstimateConfig())
    return Printed(shape, adapt or AdaptConfig())


def summary(state: LearnerState) -> dict[str, float]:
    """Estimated quantities by name.

    For a posterior over contact parameters: mass [kg] and friction along x and y of {O} [N], each with its median and
    the limits `_low` and `_high` of an 80 % interval. Without the contact model: the coefficients a1 ... an. Not for
    use under jit.
    """
    if isinstance(state, AdaptState):
        return {f"a{k + 1}": a for k, a in enumerate(np.asarray(state.mean).tolist())}
    # Use NumPy because outside jit JAX compiles every operation separately.
    on_host = state._replace(parameters=np.asarray(state.parameters), log_weight=np.asarray(state.log_weight))
    return dict(zip(NAMES, summary_values(on_host).tolist(), strict=True))


def summary_values(state: LearnerState) -> Float[Array, "n"]:
    """The values of `summary` in the same order. Works under jit."""
    if isinstance(state, AdaptState):
        return state.mean
    xp = se2.array_module(state.parameters)
    values = xp.concatenate([xp.exp(state.parameters[:, :1]), contact_model.resistance(state.parameters)], axis=-1)
    return estimate.quantiles(state, values, BAND).T.reshape(-1)


def relocated(state: LearnerState) -> LearnerState:
    """The same estimate at the start of another push."""
    return state if isinstance(state, AdaptState) else estimate.relocated(state)


def unchanged(before: LearnerState, after: LearnerState) -> LearnerState:
    """The estimate without the update of an uninformative sample.

    The next sample sets pose and twist of the particles again, and uses new random draws.

    Args:
        before: estimate before the sample.
        after: estimate after the sample.
    """
    if isinstance(before, AdaptState) or isinstance(after, AdaptState):
        return before
    return estimate.relocated(before)._replace(key=after.key)


def restarts(state: LearnerState) -> int:
    """Number of restarts of a posterior from the prior (`estimate.ObjectEstimate`). Not for use under jit."""
    return 0 if isinstance(state, AdaptState) else int(state.restarts)
