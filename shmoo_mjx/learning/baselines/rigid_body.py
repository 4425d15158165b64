"""A body on four feet, identified from what was felt of the object, alone: what psi sees, without psi."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.dynamics import feet
from shmoo_mjx.fingerprints import fingerprint
from shmoo_mjx.learning import identification, serialisation
from shmoo_mjx.learning.baselines.protocol import Context, Job, Predictor, output_scale
from shmoo_mjx.learning.identification import BodyPrior, IdentificationConfig

__all__ = ["rigid_body"]

Array = Any


def rigid_body(job: Job) -> Predictor:
    """The identified body alone; the setting's entries are those of IdentificationConfig."""
    known = {f.name for f in fields(IdentificationConfig)}
    return _body(job, IdentificationConfig(**{k: v for k, v in job.setting.items() if k in known}))[0]


def _body(job: Job, config: IdentificationConfig) -> tuple[Predictor, Array]:
    """The body as a method, and the training conditions' own parameters ``[C, p]``."""
    scale = jnp.asarray(output_scale(job.train.rows))
    prior, of_training = jax.tree.map(jnp.asarray, _learned(job, config, np.asarray(scale)))

    @jax.jit
    def adapt(context: Context) -> Array:
        return identification.identify(config, prior, scale, context.inputs, context.labels, context.weights)

    def predict(parameters: Array, x: Array, time: Array) -> Array:
        return jnp.moveaxis(feet.acceleration(parameters, jnp.moveaxis(x, -1, 0)), 0, -1)

    return Predictor(adapt, predict), of_training


def _learned(job: Job, config: IdentificationConfig, scale: np.ndarray) -> tuple[BodyPrior, np.ndarray]:
    """`identification.learn_prior`, kept beside the fits' directories: those that differ in other settings share it."""
    rows = job.train.rows
    if job.directory is None:
        return identification.learn_prior(config, scale, rows.inputs, rows.labels, rows.weights)
    identity = fingerprint(__name__, config, rows.inputs, rows.labels)
    path = job.directory.parent / f"bodies-{identity[:10]}.safetensors"
    groups, p, count = config.groups, len(feet.PARAMETERS), len(rows.inputs)
    shapes = BodyPrior(np.zeros((groups, p)), np.zeros((groups, p, p)), np.zeros(groups)), np.zeros((count, p))
    kept = serialisation.load_checkpoint(path, shapes, identity)
    if kept is not None:
        return kept[0]
    found = identification.learn_prior(config, scale, rows.inputs, rows.labels, rows.weights)
    serialisation.save_checkpoint(path, found, {"identity": identity})
    return found
