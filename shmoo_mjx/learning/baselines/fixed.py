"""Predictors that learn nothing and adapt to nothing."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from shmoo_mjx import se2
from shmoo_mjx.dynamics import features
from shmoo_mjx.learning.baselines.protocol import Job, Predictor
from shmoo_mjx.types import DT, Array

__all__ = ["constant_velocity", "zero"]


def zero(job: Job) -> Predictor:
    """No acceleration in {W}: what psi a predicts for a = 0."""
    axes = job.train.samples.labels.shape[-1]
    return Predictor(lambda context: (), lambda state, x, time: jnp.zeros((*x.shape[:-1], axes)))


def constant_velocity(job: Job) -> Predictor:
    """The twist in {O} stays as it is, so that a turning object goes round in a circle."""
    where = features.slices(features.OBJECT_INPUTS)["object_twist"]

    def predict(state: Any, x: Array, time: Array) -> Array:
        twist = x[..., where]
        return (se2.rotate(twist, twist[..., 2] * DT) - twist) / DT

    return Predictor(lambda context: (), predict)
