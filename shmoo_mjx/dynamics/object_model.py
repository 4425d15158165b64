"""O = psi a: the shared basis psi and the object's own coefficients a (Eq. 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx.dynamics import bodies, features, mlp
from shmoo_mjx.dynamics.bodies import Bodies

__all__ = [
    "Folded",
    "ObjectConfig",
    "ObjectParams",
    "basis",
    "design_matrix",
    "fold",
    "forward",
    "init",
    "network_inputs",
    "predict",
]

Array = Any


@dataclass(frozen=True)
class ObjectConfig:
    """Shape of psi."""

    hidden: tuple[int, ...] = (128, 128, 50)
    """Widths of the hidden layers, the paper's."""
    functions: int = 12
    """K, number of basis functions (and coefficients) per axis; 6 in the paper. One psi serves objects that slide and
    objects that roll, and the learned prior keeps many coefficients from needing many samples."""
    activation: str = "relu"
    """As good as tanh on held-out objects and about a third of its training time."""
    per_axis: bool = True
    """Each of x, y and yaw has K functions of its own; otherwise the three share them, as the paper's widths
    [10, 128, 128, 50, 6] say. Own functions leave less error on held-out objects."""
    linear_terms: bool = True
    """Add a learned linear map of the inputs to psi: rolling objects are close to linear in twist and wrench."""
    trial_bodies: int = 16
    """J, number of trial bodies with dry friction whose answers psi's network also sees; 0 as in the paper."""

    @classmethod
    def paper(cls) -> ObjectConfig:
        """psi as the paper prints it: widths [10, 128, 128, 50, 6], the six functions shared by the axes."""
        return cls(functions=6, activation="tanh", per_axis=False, linear_terms=False, trial_bodies=0)


class ObjectParams(NamedTuple):
    """Everything learned about objects in general."""

    net: mlp.MLP
    linear: Array
    """``[10 + 3 J, n]`` linear part of psi on normalised inputs; zero unless config.linear_terms."""
    bodies: Bodies
    """The J trial bodies."""
    label_scale: Array
    """``[3]`` unit in which psi a predicts each axis [m/s^2, m/s^2, rad/s^2]."""


class Folded(NamedTuple):
    """O with its coefficients, made ready for roll-outs."""

    layers: mlp.Layers
    bodies: Bodies


def init(key: Array, config: ObjectConfig | None = None, n_in: int | None = None, n_axes: int = 3) -> ObjectParams:
    """Untrained parameters; ``n_in`` and ``n_axes`` differ from 10 and 3 only for other people's data."""
    config = config or ObjectConfig()
    n_in = features.width(features.OBJECT_INPUTS) if n_in is None else n_in
    n_seen = n_in + 3 * config.trial_bodies
    n_out = config.functions * (n_axes if config.per_axis else 1)
    net_key, linear_key, body_key = jax.random.split(key, 3)
    linear = jax.random.normal(linear_key, (n_seen, n_out)) / jnp.sqrt(n_seen) * float(config.linear_terms)
    net = mlp.init(net_key, (n_seen, *config.hidden, n_out))
    return ObjectParams(net, linear, bodies.init(body_key, config.trial_bodies), jnp.ones(n_axes))


def network_inputs(params: ObjectParams, inputs: Array) -> Array:
    """What psi's network sees ``[..., 10 + 3 J]``: ``inputs [..., 10]`` and the answers of the trial bodies."""
    return jnp.moveaxis(_seen(params.bodies, jnp.moveaxis(inputs, -1, 0)), 0, -1)


def _seen(trial: Bodies, inputs: Array) -> Array:
    return jnp.concatenate([inputs, bodies.answers(trial, inputs)]) if trial.log_friction.shape[0] else inputs


def basis(params: ObjectParams, inputs: Array, config: ObjectConfig) -> Array:
    """psi ``[..., 3, K]`` of Eq. 3 for ``inputs [..., 10]``; the three rows are equal unless config.per_axis."""
    seen = network_inputs(params, inputs)
    out = mlp.apply(params.net, seen, config.activation)
    if config.linear_terms:
        out = out + ((seen - params.net.mean) / params.net.scale) @ params.linear
    return _by_axis(params, out, config)


def predict(params: ObjectParams, coefficients: Array, inputs: Array, config: ObjectConfig) -> Array:
    """O of Eq. 3: acceleration ``[..., 3]`` in {O} for ``inputs [..., 10]`` and a ``[..., 3, K]``."""
    return jnp.sum(basis(params, inputs, config) * coefficients, axis=-1) * params.label_scale


def design_matrix(params: ObjectParams, inputs: Array, config: ObjectConfig) -> Array:
    """Phi ``[..., 3, 3 K]`` with acceleration = Phi a for a flattened ``[3 K]``: what Eq. 8 calls psi."""
    psi = basis(params, inputs, config) * params.label_scale[:, None]
    n_axes = params.label_scale.shape[-1]
    blocks = psi[..., :, None, :] * jnp.eye(n_axes)[:, :, None]
    return blocks.reshape(*psi.shape[:-1], n_axes * config.functions)


def fold(params: ObjectParams, coefficients: Array, config: ObjectConfig) -> Folded:
    """O made ready for roll-outs with the coefficients ``[3, K]``: `forward` of it gives ``[3, ...]`` in {O}.

    psi a is linear in the last layer's output, so a goes into that layer's weights, and psi itself is never formed.
    """

    def weigh(columns: Array) -> Array:
        return jnp.sum(_by_axis(params, columns, config) * coefficients, axis=-1) * params.label_scale

    net = mlp.fold(params.net)
    last, bias = weigh(params.net.weights[-1]).T, weigh(params.net.biases[-1])
    skip = None
    if config.linear_terms:
        skip = weigh(params.linear).T / params.net.scale
        bias = bias - skip @ params.net.mean
    return Folded(mlp.Layers((*net.weights[:-1], last), (*net.biases[:-1], bias), skip), params.bodies)


def forward(folded: Folded, inputs: Array, config: ObjectConfig) -> Array:
    """What `predict` gives, with channels first: ``[3, ...]`` for ``inputs [10, ...]``."""
    return mlp.forward(folded.layers, _seen(folded.bodies, inputs), config.activation)


def _by_axis(params: ObjectParams, out: Array, config: ObjectConfig) -> Array:
    """The last layer's outputs ``[..., n_out]`` as psi ``[..., 3, K]``."""
    n_axes = params.label_scale.shape[-1]
    if config.per_axis:
        return out.reshape(*out.shape[:-1], n_axes, config.functions)
    return jnp.broadcast_to(out[..., None, :], (*out.shape[:-1], n_axes, config.functions))
