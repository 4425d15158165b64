"""Online learning of the object at hand, in two ways behind one protocol.

`Posterior` learns the contact parameters of a psi with the contact model; its coefficients stay where training left
them. `Printed` learns the coefficients of the paper's psi by Eq. 8.
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
"""Size from which on a sample holds no measurement and teaches nothing [SI units]: no robot of this kind comes near."""
BAND = (0.1, 0.5, 0.9)
"""Quantiles that `summary` gives: the median and an 80 % band."""

NAMES = tuple(f"{name}{end}" for name in ("mass", "friction_x", "friction_y") for end in ("_low", "", "_high"))
"""What `summary` tells of a posterior."""

LearnerState = ObjectEstimate | AdaptState
"""Estimate of an object's dynamics; a pytree."""


class Transition(NamedTuple):
    """What is learned from: the sample that just ended."""

    inputs: Float[Array, "13"]
    """Inputs of psi at its start, measured wrench included."""
    label: Float[Array, "3"]
    """Measured acceleration in {O}."""
    valid: Scalar
    """False without contact, with stale or missing poses: inputs and label say nothing."""
    sighting: Sighting
    """What was perceived at its end."""


@runtime_checkable
class Learner(Protocol):
    """A way to learn an object online; hashable and without state of its own."""

    def adapt(self, state: Any, params: Params, sample: Transition) -> Any:
        """What is known after one more sample; one that is not finite changes nothing. Pure."""

    def params_for_rollout(self, state: Any, params: Params) -> Params:
        """The parameters of the dynamics core for this object."""


@dataclass(frozen=True)
class Posterior:
    """The contact parameters as a particle posterior (`estimate`); roll-outs take its mean."""

    config: EstimateConfig = EstimateConfig()

    def adapt(self, state: ObjectEstimate, params: Params, sample: Transition) -> ObjectEstimate:
        """See `Learner`."""
        return estimate.step(self.config, state, sample.sighting)

    def params_for_rollout(self, state: ObjectEstimate, params: Params) -> Params:
        """See `Learner`."""
        return params._replace(contact=estimate.mean(state))


@dataclass(frozen=True)
class Printed:
    """The coefficients a of psi, by Eq. 8."""

    shape: ObjectConfig
    config: AdaptConfig = AdaptConfig()

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
    """How an object is learned by a psi of this ``shape``; ``contact`` or ``adapt`` are the settings of that."""
    if shape.contact_model:
        return Posterior(contact or EstimateConfig())
    return Printed(shape, adapt or AdaptConfig())


def summary(state: LearnerState) -> dict[str, float]:
    """What is known, by name: mass [kg], friction along x and y of {O} [N], each the median with `_low` and `_high` of
    an 80 % band; or a1 ... an of a psi without contact model. Not for jit."""
    if isinstance(state, AdaptState):
        return {f"a{k + 1}": a for k, a in enumerate(np.asarray(state.mean).tolist())}
    # In NumPy: outside jit, JAX compiles every operation apart.
    on_host = state._replace(parameters=np.asarray(state.parameters), log_weight=np.asarray(state.log_weight))
    return dict(zip(NAMES, summary_values(on_host).tolist(), strict=True))


def summary_values(state: LearnerState) -> Float[Array, "n"]:
    """The numbers of `summary`, in order; for jit too."""
    if isinstance(state, AdaptState):
        return state.mean
    xp = se2.array_module(state.parameters)
    values = xp.concatenate([xp.exp(state.parameters[:, :1]), contact_model.resistance(state.parameters)], axis=-1)
    return estimate.quantiles(state, values, BAND).T.reshape(-1)


def relocated(state: LearnerState) -> LearnerState:
    """The same at the start of another push."""
    return state if isinstance(state, AdaptState) else estimate.relocated(state)


def unchanged(before: LearnerState, after: LearnerState) -> LearnerState:
    """What was known before a sample that says nothing of the object; the next one places a posterior's particles anew
    and makes draws of its own."""
    if isinstance(before, AdaptState) or isinstance(after, AdaptState):
        return before
    return estimate.relocated(before)._replace(key=after.key)


def restarts(state: LearnerState) -> int:
    """How many times a posterior had lost all weight and began anew from the prior. Not for jit."""
    return 0 if isinstance(state, AdaptState) else int(state.restarts)
