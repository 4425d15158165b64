"""O = psi a: the shared basis psi and the object's own coefficients a (Eq. 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx.dynamics import features, mlp

__all__ = ["ObjectConfig", "ObjectParams", "basis", "design_matrix", "init", "predict"]

Array = Any


@dataclass(frozen=True)
class ObjectConfig:
    """Shape of psi."""

    hidden: tuple[int, ...] = (128, 128, 50)
    """Widths of the hidden layers, the paper's."""
    functions: int = 6
    """K, number of basis functions (and coefficients) per axis."""
    activation: str = "relu"
    """As good as tanh on held-out objects and about a third of its training time."""
    per_axis: bool = True
    """Each of x, y and yaw has K functions of its own; otherwise the three share them, as the paper's widths
    [10, 128, 128, 50, 6] say. Own functions leave less error on held-out objects."""
    linear_terms: bool = True
    """Add a learned linear map of the inputs to psi: rolling objects are close to linear in twist and wrench."""


class ObjectParams(NamedTuple):
    """Everything learned about objects in general."""

    net: mlp.MLP
    linear: Array
    """``[10, n]`` linear part of psi on normalised inputs; zero unless config.linear_terms."""
    label_scale: Array
    """``[3]`` unit in which psi a predicts each axis [m/s^2, m/s^2, rad/s^2]."""


def init(key: Array, config: ObjectConfig | None = None, n_in: int | None = None, n_axes: int = 3) -> ObjectParams:
    """Untrained parameters; ``n_in`` and ``n_axes`` differ from 10 and 3 only for other people's data."""
    config = config or ObjectConfig()
    n_in = features.width(features.OBJECT_INPUTS) if n_in is None else n_in
    n_out = config.functions * (n_axes if config.per_axis else 1)
    net_key, linear_key = jax.random.split(key)
    linear = jax.random.normal(linear_key, (n_in, n_out)) / jnp.sqrt(n_in) * float(config.linear_terms)
    return ObjectParams(mlp.init(net_key, (n_in, *config.hidden, n_out)), linear, jnp.ones(n_axes))


def basis(params: ObjectParams, inputs: Array, config: ObjectConfig) -> Array:
    """psi ``[..., 3, K]`` of Eq. 3 for ``inputs [..., 10]``; the three rows are equal unless config.per_axis."""
    out = mlp.apply(params.net, inputs, config.activation)
    if config.linear_terms:
        out = out + ((inputs - params.net.mean) / params.net.scale) @ params.linear
    n_axes = params.label_scale.shape[-1]
    if config.per_axis:
        return out.reshape(*out.shape[:-1], n_axes, config.functions)
    return jnp.broadcast_to(out[..., None, :], (*out.shape[:-1], n_axes, config.functions))


def predict(params: ObjectParams, coefficients: Array, inputs: Array, config: ObjectConfig) -> Array:
    """O of Eq. 3: acceleration ``[..., 3]`` in {O} for ``inputs [..., 10]`` and a ``[..., 3, K]``."""
    return jnp.sum(basis(params, inputs, config) * coefficients, axis=-1) * params.label_scale


def design_matrix(params: ObjectParams, inputs: Array, config: ObjectConfig) -> Array:
    """Phi ``[..., 3, 3 K]`` with acceleration = Phi a for a flattened ``[3 K]``: what Eq. 8 calls psi."""
    psi = basis(params, inputs, config) * params.label_scale[:, None]
    n_axes = params.label_scale.shape[-1]
    blocks = psi[..., :, None, :] * jnp.eye(n_axes)[:, :, None]
    return blocks.reshape(*psi.shape[:-1], n_axes * config.functions)
