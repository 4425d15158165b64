"""Inputs of a learned method: those of psi and, optionally, the predictions of an estimated contact model.

With the contact model, a method gets the inputs of the shipped psi (`object_model.network_inputs`), from contact
parameters that are estimated in the same way. Differences between methods then come from what they learn, not from
their inputs.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.dynamics import object_model
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.evaluation.baselines.protocol import Context, Job, output_scale
from shmoo_mjx.learning import estimate, training_contacts
from shmoo_mjx.learning.estimate import EstimateConfig
from shmoo_mjx.learning.training_contacts import Contacts

NARROWEST = 1e-3
"""Lower limit of the standard deviation by which an input is divided."""


@dataclass(frozen=True, eq=False)
class Sight:
    """Computes the inputs of a method from a sample, normalised over the training samples."""

    config: ObjectConfig
    """Config of the inputs. Only ``contact_model`` and ``last_wrench`` have an effect."""
    fit: EstimateConfig
    """Settings of the estimate of the contact parameters."""
    contacts: Contacts
    """Contact parameters of the training and validation conditions; zeros if the method sees none."""
    label_scale: Float[Array, "m"]
    mean: Float[Array, "n"]
    """Mean of each input over the training samples."""
    spread: Float[Array, "n"]
    """Standard deviation of each input over the training samples."""

    def contact(self, context: Context) -> Float[Array, "p"]:
        """The contact parameters of the condition; zeros if the method has no contact model."""
        if context.contact is not None:
            return context.contact
        if not self.config.contact_model:
            return jnp.zeros(self.contacts[1].shape[-1])
        rows = context.inputs, context.labels, context.weights
        return estimate.mean(estimate.after_rows(self.fit, self.contacts[0], self.label_scale, rows))

    def __call__(self, inputs: Float[Array, "*batch 13"], contact: Float[Array, "p"]) -> Float[Array, "*batch n"]:
        """Normalised inputs for samples of an object with these contact parameters."""
        values = object_model.network_inputs(self.label_scale, inputs, self.config, contact)
        return (values - self.mean) / self.spread


def sight(job: Job, contact_model: bool = True) -> Sight:
    """The inputs of a method for a job.

    Args:
        job: training and validation conditions. The estimated contact parameters are kept beside its directory, so that
            other methods can use them.
        contact_model: whether the inputs include the predictions of the contact model.
    """
    config, fit = ObjectConfig(contact_model=contact_model), EstimateConfig()
    train, held_out = job.train.samples, job.validation.samples
    if contact_model:
        contacts = training_contacts.estimated(fit, train, held_out, fit_samples=job.fit_samples, out_dir=job.directory)
    else:
        contacts = training_contacts.zeros(train, held_out)
    scale = jnp.asarray(output_scale(train))
    see = jax.jit(jax.vmap(lambda x, contact: object_model.network_inputs(scale, x, config, contact)))
    values = see(jnp.asarray(train.inputs), contacts[1][:, -1])[train.weights > 0]
    spread = jnp.maximum(jnp.std(values, axis=0), NARROWEST)
    return Sight(config, fit, contacts, scale, jnp.mean(values, axis=0), spread)
