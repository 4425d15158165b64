"""O = psi a: the shared basis psi and the coefficients a of one object (Eq. 3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import block_diag

from shmoo_mjx.arrays import Array, Float, Key
from shmoo_mjx.dynamics import contact_model, features, networks
from shmoo_mjx.dynamics import fused as fusing

PREDICTED_LIMIT = 20.0
"""Limit of the contact model's predictions as inputs of psi, in standard deviations of the labels."""
FRICTION_SHIFTS = (-0.2, 0.0, 0.2)
"""Shifts of the log friction at which the contact model is evaluated for the inputs of psi: about 20 % less, unchanged
and 20 % more. They show psi how close the object is to the stick-slip boundary."""


@dataclass(frozen=True)
class ObjectConfig:
    """Structure of psi."""

    hidden: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers. They are half of the paper's: pushes end equally close to their goals, and plans
    take less time."""
    functions: int = 12
    """K, the number of basis functions and coefficients per axis (6 in the paper). More functions let one psi serve
    objects that slide and objects that roll. The learned prior limits the number of samples that they need."""
    activation: str = "relu"
    """Name of the activation. relu is as accurate as tanh on held-out objects and trains in about a third of the
    time."""
    per_axis: bool = True
    """Give each of x, y and yaw its own K functions. If False, the axes share them, as the paper's widths
    [10, 128, 128, 50, 6] say. Separate functions have a smaller error on held-out objects."""
    linear_terms: bool = True
    """Add a learned linear map of the inputs to psi. Rolling objects are almost linear in twist and wrench."""
    last_wrench: bool = True
    """Include the last entry of OBJECT_INPUTS. If False, psi has the 10 inputs of the paper."""
    contact_model: bool = True
    """Include predictions of the four-point Coulomb contact model (`contact_model`), which is estimated online, in the
    inputs of psi. With ``last_wrench`` its error one sample ago is included too. Not in the paper."""
    residual: bool = True
    """If False, omit psi: the acceleration is the prediction of the contact model. For comparison."""
    equivariant: bool = True
    """Make psi reflection-equivariant (`networks.EquivariantMLP`), without left-right bias. Not in the paper."""

    @classmethod
    def paper(cls) -> ObjectConfig:
        """psi as the paper prints it: widths [10, 128, 128, 50, 6], the six functions shared by the axes."""
        return cls(
            hidden=(128, 128, 50), functions=6, activation="tanh", per_axis=False, linear_terms=False,
            last_wrench=False, contact_model=False, equivariant=False,
        )  # fmt: skip


class ObjectParams(NamedTuple):
    """Learned parameters of psi, shared by all objects."""

    net: networks.Network
    """Parameters of the network."""
    linear: Float[Array, "n_net n"]
    """Linear part of psi, a map of the normalised network inputs; zero unless config.linear_terms."""
    label_scale: Float[Array, "axes"]
    """Scale of each axis, by which psi a is multiplied to give the acceleration [m/s^2, m/s^2, rad/s^2]."""


class FusedObjectModel(NamedTuple):
    """O with the coefficients included, in the form for roll-outs."""

    layers: fusing.FusedMLP | fusing.FusedEquivariantMLP
    """The network of psi, with the coefficients in its last layer."""
    contact: Float[Array, "p"]
    """Parameters of the contact model; used if config.contact_model, or without config.residual."""
    label_scale: Float[Array, "axes"]
    """As in ObjectParams."""


def init(
    key: Key[Array, ""], config: ObjectConfig | None = None, n_in: int | None = None, n_axes: int = 3
) -> ObjectParams:
    """Untrained parameters.

    Args:
        key: random key.
        config: structure of psi.
        n_in: number of inputs; the default is the 13 of OBJECT_INPUTS. External data sets can have others.
        n_axes: number of predicted axes.
    """
    config = config or ObjectConfig()
    n_in = features.width(features.OBJECT_INPUTS) if n_in is None else n_in
    n_net = n_in - inputs_of(config, 0, n_axes)
    n_out = config.functions * (n_axes if config.per_axis else 1)
    net_key, linear_key = jax.random.split(key)
    linear = jax.random.normal(linear_key, (n_net, n_out)) / jnp.sqrt(n_net) * float(config.linear_terms)
    net = networks.init(_module(config, n_axes), net_key, n_net)
    return ObjectParams(net, linear, jnp.ones(n_axes))


def inputs_of(config: ObjectConfig, width: int, n_axes: int) -> int:
    """Number of inputs of psi for a network with ``width`` inputs.

    The predictions of the contact model are network inputs but not inputs of psi. Without config.last_wrench, the last
    wrench is an input of psi but not of the network.
    """
    answers = n_axes * (len(FRICTION_SHIFTS) + config.last_wrench) * config.contact_model
    return width + 3 * (not config.last_wrench) - answers


def network_inputs(
    label_scale: Float[Array, "axes"],
    inputs: Float[Array, "... n_in"],
    config: ObjectConfig,
    contact: Float[Array, "p"],
) -> Float[Array, "... n_net"]:
    """The 25 inputs of psi's network: the 13 ``inputs`` and the predictions of the contact model.

    Args:
        label_scale: as in ObjectParams.
        inputs: in the order of OBJECT_INPUTS.
        config: structure of psi.
        contact: parameters of the contact model, in the order of `contact_model.PARAMETERS`.
    """
    inputs = jnp.moveaxis(inputs, -1, 0)
    before = remembered(inputs, config, contact)
    return jnp.moveaxis(_net_inputs(label_scale, inputs, config, contact=contact, before=before)[0], 0, -1)


def remembered(
    inputs: Float[Array, "n_in ..."], config: ObjectConfig, contact: Float[Array, "p"]
) -> Float[Array, "3 ..."] | None:
    """The contact model's prediction for the sample before the one of ``inputs``, channels first.

    None if psi does not use it. Within a roll-out, `forward` returns it for the next sample.
    """
    if not (config.contact_model and config.last_wrench and config.residual):
        return None
    return contact_model.acceleration(contact, features.last_sample(inputs)[0])


def _net_inputs(
    label_scale: Array, inputs: Array, config: ObjectConfig, *, contact: Array, before: Array | None
) -> tuple[Array, Array | None]:
    """Inputs of psi's network, channels first, and the contact model's prediction for this sample."""
    visible = inputs if config.last_wrench else inputs[:-3]
    if not config.contact_model:
        return visible, None
    predicted = contact_model.acceleration(contact, inputs, FRICTION_SHIFTS)
    now = predicted[FRICTION_SHIFTS.index(0.0)]
    if before is not None:
        predicted = jnp.concatenate([(before - features.last_sample(inputs)[1])[None], predicted])
    # Clip, so that the network does not extrapolate far beyond its training data.
    predicted = jnp.clip(
        predicted / label_scale.reshape(-1, *(1,) * (inputs.ndim - 1)), -PREDICTED_LIMIT, PREDICTED_LIMIT
    )
    return jnp.concatenate([visible, predicted.reshape(-1, *inputs.shape[1:])]), now


def basis(
    params: ObjectParams, inputs: Float[Array, "... n_in"], config: ObjectConfig, contact: Float[Array, "p"]
) -> Float[Array, "... axes K"]:
    """psi of Eq. 3. The rows of the axes are equal unless config.per_axis.

    Args:
        params: parameters of psi.
        inputs: in the order of OBJECT_INPUTS.
        config: structure of psi.
        contact: parameters of the contact model, in the order of `contact_model.PARAMETERS`; ignored unless
            config.contact_model.
    """
    net_inputs = network_inputs(params.label_scale, inputs, config, contact)
    out = networks.apply(_module(config, params.label_scale.shape[-1]), params.net, net_inputs)
    if config.linear_terms:
        out = out + ((net_inputs - params.net.mean) / params.net.scale) @ _linear(params, config)
    return _by_axis(params, out, config)


def predict(
    params: ObjectParams,
    coefficients: Float[Array, "... axes K"],
    inputs: Float[Array, "... n_in"],
    config: ObjectConfig,
    *,
    contact: Float[Array, "p"],
) -> Float[Array, "... axes"]:
    """O of Eq. 3: acceleration in {O} [m/s^2, m/s^2, rad/s^2].

    Args:
        params: parameters of psi.
        coefficients: the coefficients a of the object.
        inputs: in the order of OBJECT_INPUTS.
        config: structure of psi.
        contact: parameters of the contact model.
    """
    if not config.residual:
        return jnp.moveaxis(contact_model.acceleration(contact, jnp.moveaxis(inputs, -1, 0)), 0, -1)
    return jnp.sum(basis(params, inputs, config, contact) * coefficients, axis=-1) * params.label_scale


def design_matrix(
    params: ObjectParams, inputs: Float[Array, "... n_in"], config: ObjectConfig, contact: Float[Array, "p"]
) -> Float[Array, "... axes m"]:
    """Phi with acceleration = Phi a, where one vector a holds the coefficients of all axes. Eq. 8 calls it psi.

    The arguments are those of `basis`.
    """
    psi = basis(params, inputs, config, contact) * params.label_scale[:, None]
    n_axes = params.label_scale.shape[-1]
    blocks = psi[..., :, None, :] * jnp.eye(n_axes)[:, :, None]
    return blocks.reshape(*psi.shape[:-1], n_axes * config.functions)


def fuse(
    params: ObjectParams, coefficients: Float[Array, "axes K"], config: ObjectConfig, contact: Float[Array, "p"]
) -> FusedObjectModel:
    """O with these coefficients in the form for roll-outs, to be evaluated with `forward`.

    psi a is linear in the output of the last layer. The weights of that layer therefore include a, and psi itself is
    never computed.
    """

    def weigh(rows: Array) -> Array:
        signs = _by_axis(params, rows.T, config) * coefficients
        return (jnp.sum(signs, axis=-1) * params.label_scale).T

    fused = fusing.fuse_equivariant(params.net, reflections(config)) if config.equivariant else fusing.fuse(params.net)
    layers = fused.followed_by(weigh)
    if config.linear_terms:
        skip = weigh(_linear(params, config).T) / params.net.scale
        layers = layers.with_affine(skip, -skip @ params.net.mean)
    return FusedObjectModel(layers, contact, params.label_scale)


def forward(
    fused: FusedObjectModel,
    inputs: Float[Array, "n_in ..."],
    config: ObjectConfig,
    before: Float[Array, "3 ..."] | None,
) -> tuple[Float[Array, "axes ..."], Float[Array, "3 ..."] | None]:
    """Acceleration in {O}: the same as `predict`, with channels first.

    Args:
        fused: the model.
        inputs: in the order of OBJECT_INPUTS.
        config: structure of psi.
        before: result of `remembered` for the inputs, or the second result of this function for the sample before.

    Returns:
        The acceleration, and ``before`` for the next sample.
    """
    if not config.residual:
        return contact_model.acceleration(fused.contact, inputs), None
    net_inputs, now = _net_inputs(fused.label_scale, inputs, config, contact=fused.contact, before=before)
    return fused.layers.forward(net_inputs, config.activation), None if before is None else now


def coefficient_signs(config: ObjectConfig) -> Float[np.ndarray, "3 K"]:
    """Signs that multiply the coefficients of an object when it is mirrored.

    Every third function describes a left-right asymmetry of the object, such as a load off the centre or one braked
    wheel. A symmetric object has zero coefficients wherever the sign is -1.
    """
    signs = np.where(np.arange(config.functions) % 3 == 2, -1.0, 1.0).astype(np.float32)
    axes = np.diag(features.reflection(features.OBJECT_OUTPUTS))
    return np.broadcast_to(signs, (3, config.functions)) if config.per_axis else axes[:, None] * signs


def reflections(config: ObjectConfig) -> tuple[Float[np.ndarray, "n_net n_net"], Float[np.ndarray, "n n"]]:
    """Reflection matrices of the inputs and of the outputs of psi's network."""
    inputs, axes = features.reflection(features.OBJECT_INPUTS), features.reflection(features.OBJECT_OUTPUTS)
    if not config.last_wrench:
        inputs = inputs[:-3, :-3]
    answers = (len(FRICTION_SHIFTS) + config.last_wrench) * config.contact_model
    signs = np.diag(axes)[:, None] * coefficient_signs(config)
    return block_diag(inputs, *[axes] * answers), np.diag(signs.reshape(-1) if config.per_axis else signs[0])


def _module(config: ObjectConfig, n_axes: int) -> networks.MLP | networks.EquivariantMLP:
    """psi's network."""
    widths = (*config.hidden, config.functions * (n_axes if config.per_axis else 1))
    if config.equivariant:
        return networks.EquivariantMLP(widths, reflections(config), config.activation)
    return networks.MLP(widths, config.activation)


def _linear(params: ObjectParams, config: ObjectConfig) -> Array:
    """The linear part ``[n_net, n]``, reduced to its equivariant component if config.equivariant."""
    if not config.equivariant:
        return params.linear
    inputs, outputs = reflections(config)
    return (params.linear + inputs @ params.linear @ outputs) / 2


def _by_axis(params: ObjectParams, out: Array, config: ObjectConfig) -> Array:
    """Reshape the outputs of the last layer ``[..., n_out]`` to psi ``[..., 3, K]``."""
    n_axes = params.label_scale.shape[-1]
    if config.per_axis:
        return out.reshape(*out.shape[:-1], n_axes, config.functions)
    return jnp.broadcast_to(out[..., None, :], (*out.shape[:-1], n_axes, config.functions))
