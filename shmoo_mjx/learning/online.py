"""Online learning of the object at hand: its contact parameters, its coefficients by Eq. 8, or both.

A psi with the contact model learns by identifying it, and its coefficients stay where training left them: with real
senses Eq. 8 on top of that made pushes end turned by some degrees more, for accelerations are differences of noisy
twists. A psi without it, the paper's, learns by Eq. 8.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float, Scalar, single_precision
from shmoo_mjx.dynamics import contact_model, object_model
from shmoo_mjx.dynamics.object_model import ObjectConfig, ObjectParams
from shmoo_mjx.learning import adaptation, identification
from shmoo_mjx.learning.adaptation import AdaptConfig, AdaptState

_BELIEVABLE = 1e4
"""Size from which on a sample holds no measurement and teaches nothing [SI units]: no robot of this kind comes near."""


@single_precision
def observe(
    config: AdaptConfig,
    state: AdaptState,
    params: ObjectParams,
    shape: ObjectConfig,
    inputs: Float[Array, "13"],
    label: Float[Array, "3"],
    valid: Scalar = True,
) -> AdaptState:
    """One sample of the object: contact parameters are identified anew, or Eq. 8, or one after the other.

    Args:
        config: gains; static.
        state: unbatched; vmap for more.
        params: psi.
        shape: of psi; static.
        inputs: as OBJECT_INPUTS lists them.
        label: measured acceleration of the object in {O}.
        valid: False without contact, with stale or missing poses.
    """
    believable = jnp.all(jnp.abs(inputs) < _BELIEVABLE) & jnp.all(jnp.abs(label) < _BELIEVABLE)
    valid = jnp.asarray(valid) & believable
    if state.contact is not None:
        contact = identification.observe(config.contact, state.contact, inputs, label, valid)
        if not config.coefficients:
            return state._replace(contact=contact)
        state = state._replace(contact=contact)
    phi = object_model.design_matrix(params, inputs, shape, contact_of(state))
    return adaptation.step(config, state, phi, label, valid)


@single_precision
def contact_of(state: AdaptState) -> Float[Array, "p"]:
    """Contact parameters of the object; the first guess if psi has no contact model."""
    return contact_model.guess() if state.contact is None else identification.best(state.contact)


def learned(state: AdaptState) -> dict[str, float]:
    """What adapts, by name: the contact parameters, or a1 ... an of a psi without contact model. Not for jit."""
    if state.contact is not None:
        best = identification.best(jax.tree.map(np.asarray, state.contact))
        return dict(zip(contact_model.PARAMETERS, best.tolist(), strict=True))
    return {f"a{k + 1}": a for k, a in enumerate(np.asarray(state.mean).tolist())}
