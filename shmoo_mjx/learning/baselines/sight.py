"""What a learned method sees of a row: the inputs and, if it is given one, what an identified body says of them.

With setting["body"] any method gets the inputs that psi has as shipped (`object_model.network_inputs`), from bodies
identified in the same way; so methods can be compared by what they learn, not by what they are told.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from shmoo_mjx.dynamics import object_model
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.learning import identification, training_bodies
from shmoo_mjx.learning.baselines.protocol import Context, Job, output_scale
from shmoo_mjx.learning.identification import IdentificationConfig
from shmoo_mjx.learning.training_bodies import Found
from shmoo_mjx.types import Array

__all__ = ["Sight", "sight"]

NARROWEST = 1e-3
"""Least standard deviation that an input is divided by."""


@dataclass(frozen=True, eq=False)
class Sight:
    """What a method sees of a row, normalised over the training rows."""

    config: ObjectConfig
    """Only ``body`` and ``last_wrench`` matter."""
    fit: IdentificationConfig
    found: Found
    """Bodies of the training and validation conditions; zeros if the method sees none."""
    label_scale: Array
    """``[m]``"""
    mean: Array
    """``[n]`` of what is seen."""
    spread: Array
    """``[n]``"""

    def body(self, context: Context) -> Array:
        """The body ``[p]`` that the condition looks like; zeros if the method sees none."""
        if context.body is not None:
            return context.body
        if not self.config.body:
            return jnp.zeros(self.found[1].shape[-1])
        prior = self.found[0]
        return identification.identify(
            self.fit, prior, self.label_scale, context.inputs, context.labels, context.weights
        )

    def __call__(self, inputs: Array, body: Array) -> Array:
        """``[..., n]`` of ``inputs [..., 13]``, for a body ``[p]``."""
        seen = object_model.network_inputs(self.label_scale, inputs, self.config, body)
        return (seen - self.mean) / self.spread


def sight(job: Job) -> Sight:
    """What a job's setting lets the method see; the bodies are kept beside the job's directory, for other methods."""
    config, fit = ObjectConfig(body=job.setting.get("body", False)), IdentificationConfig()
    find = training_bodies.identified if config.body else training_bodies.nothing
    train = job.train.rows
    found = find(fit, train, job.validation.rows, job.fit_rows, job.directory)
    scale = jnp.asarray(output_scale(train))
    see = jax.jit(jax.vmap(lambda x, body: object_model.network_inputs(scale, x, config, body)))
    seen = see(jnp.asarray(train.inputs), found[1][:, -1])[train.weights > 0]
    spread = jnp.maximum(jnp.std(seen, axis=0), NARROWEST)
    return Sight(config, fit, found, scale, jnp.mean(seen, axis=0), spread)
