"""Predictors without a network: the paper's functions of time, and constant velocity."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.dynamics import features
from shmoo_mjx.evaluation.baselines.protocol import Context, Job, Predictor, output_scale
from shmoo_mjx.geometry import se2
from shmoo_mjx.learning import least_squares
from shmoo_mjx.types import DT


def trigonometric(job: Job) -> Predictor:
    """psi(t) = [sin t, sin 2t, sin 3t, cos t, cos 2t, cos 3t] (Sec. V-B), fitted to each condition with a ridge."""
    scale = output_scale(job.train.samples)

    def basis(time: Float[Array, "*batch"]) -> Float[Array, "*batch 6"]:
        angles = jnp.asarray(time)[..., None] * jnp.arange(1.0, 4.0)
        return jnp.concatenate([jnp.sin(angles), jnp.cos(angles)], axis=-1)

    def adapt(context: Context) -> Float[Array, "m 6"]:
        f = basis(context.time)
        psi = jnp.broadcast_to(f[:, None, :], (f.shape[0], scale.shape[0], f.shape[-1]))
        start = jnp.zeros(psi.shape[1:])
        return least_squares.ridge(psi, context.labels / scale, start, job.setting["ridge"], weights=context.weights)

    return Predictor(jax.jit(adapt), lambda a, x, time: basis(time) @ a.T * scale)


def constant_velocity(job: Job) -> Predictor:
    """The twist in {O} stays constant, so a turning object moves on a circle."""
    where = features.slices(features.OBJECT_INPUTS)["object_twist"]

    def predict(state: Any, x: Float[Array, "*batch n"], time: Float[Array, "*batch"]) -> Float[Array, "*batch 3"]:
        twist = x[..., where]
        return (se2.rotate(twist, twist[..., 2] * DT) - twist) / DT

    return Predictor(lambda context: (), predict)
