"""Multi-layer perceptrons as flax modules, plain and without a preferred side, and the norm of their layers.

Robot and floor are alike on both sides, so a network that prefers one has mistaken chance for a law, and whoever plans
with it steers against an imagined turn. With `EquivariantMLP` no weights can: the answer to a mirrored input is the
mirrored answer. Hidden units come in pairs that see an input and its mirror image with the same weights. What a pair's
sum and difference are multiplied with is kept apart, so a layer of n units costs half the products of a plain one
(group convolution over the group of two elements, Cohen and Welling 2016).

A reflection is a symmetric matrix R with R R = 1: signs, and channels that change places.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn

from shmoo_mjx.arrays import Array, Float, Key

ACTIVATIONS: dict[str, Callable[[Array], Array]] = {"tanh": jnp.tanh, "relu": jax.nn.relu, "silu": jax.nn.silu}
"""Names a config may use."""


class Network(NamedTuple):
    """A module's parameters, and the normalisation of its inputs."""

    layers: dict[str, dict[str, Array]]
    """Of each layer ("layer0" first): "kernel" and "bias"."""
    mean: Float[Array, "n_0"]
    """Subtracted from the input, in the input's unit."""
    scale: Float[Array, "n_0"]
    """The input is divided by this, in the input's unit."""


class MLP(nn.Module):
    """A fully connected network; the last layer is linear."""

    widths: tuple[int, ...]
    """Of the hidden layers and of the output."""
    activation: str = "tanh"

    @nn.compact
    def __call__(self, x: Float[Array, "... n_0"]) -> Float[Array, "... n_last"]:
        """Output for the normalised input ``x``."""
        function = ACTIVATIONS[self.activation]
        for i, width in enumerate(self.widths):
            x = nn.Dense(width, name=f"layer{i}")(function(x) if i else x)
        return x


class EquivariantMLP(nn.Module):
    """The same, of pairs of units: a mirrored input gives the mirrored output."""

    widths: tuple[int, ...]
    """Of the hidden layers, which count both units of a pair and are even, and of the output."""
    reflections: tuple[np.ndarray, np.ndarray]
    """Of input ``[n_0, n_0]`` and output ``[n_last, n_last]``."""
    activation: str = "tanh"

    @nn.compact
    def __call__(self, x: Float[Array, "... n_0"]) -> Float[Array, "... n_last"]:
        """Output for the normalised input ``x``."""
        *hidden, last = self.widths
        if any(width % 2 for width in hidden):
            raise ValueError(f"hidden layers of {tuple(hidden)} units do not consist of pairs; choose even widths.")
        function = ACTIVATIONS[self.activation]
        even, odd = (x @ part for part in parts(self.reflections[0]))
        for i, width in enumerate(hidden):
            both, apart = _Pairs(width // 2, name=f"layer{i}")(even, odd)
            there, mirrored = function(both + apart), function(both - apart)
            even, odd = (there + mirrored) * np.sqrt(0.5), (there - mirrored) * np.sqrt(0.5)
        both, apart = _Pairs(last, name=f"layer{len(hidden)}")(even, odd)
        keep_even, keep_odd = parts(self.reflections[1])
        return both @ keep_even + apart @ keep_odd


class _Pairs(nn.Module):
    """A layer of pairs: kernel ``[2 n_in, n_out]``, the weights for sums above those for differences."""

    width: int

    @nn.compact
    def __call__(self, even: Array, odd: Array) -> tuple[Array, Array]:
        n = even.shape[-1]
        kernel = self.param("kernel", nn.initializers.lecun_normal(), (2 * n, self.width))
        bias = self.param("bias", nn.initializers.zeros, (self.width,))
        return even @ kernel[:n] + bias, odd @ kernel[n:]


def init(module: nn.Module, key: Key[jax.Array, ""], n_in: int) -> Network:
    """Fresh weights (LeCun normal, zero bias) for ``n_in`` inputs."""
    return Network(module.init(key, jnp.zeros(n_in))["params"], jnp.zeros(n_in), jnp.ones(n_in))


def apply(module: nn.Module, net: Network, x: Float[Array, "... n_0"]) -> Float[Array, "... n_last"]:
    """Output for the input ``x``."""
    return jnp.asarray(module.apply({"params": net.layers}, (x - net.mean) / net.scale))


def with_normaliser(
    net: Network, inputs: Float[Array, "... n_0"], reflection: Float[np.ndarray, "n_0 n_0"] | None = None
) -> Network:
    """The network normalised by the mean and standard deviation of ``inputs``, and of their mirror images if their
    ``reflection`` is given."""
    rows = inputs.reshape(-1, inputs.shape[-1])
    if reflection is not None:
        rows = jnp.concatenate([rows, rows @ reflection])
    mean: Array = jnp.mean(rows, axis=0)
    scale: Array = jnp.maximum(jnp.std(rows, axis=0), 1e-3)
    if reflection is not None:
        # Exactly: sums of many numbers and of their negatives need not be zero.
        mean, scale = parts(reflection)[0] @ mean, parts(np.abs(reflection))[0] @ scale
    return net._replace(mean=mean, scale=scale)


def parts(reflection: Float[np.ndarray, "n n"]) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]]:
    """Projections on what the mirror leaves and on what it turns round."""
    one = np.eye(len(reflection), dtype=np.float32)
    return (one + reflection) / 2, (one - reflection) / 2


def power_iterate(
    weight: Float[Array, "n m"], vector: Float[Array, "m"], steps: int = 1
) -> tuple[Float[Array, ""], Float[Array, "m"]]:
    """Estimate the spectral norm of ``weight``, going on from ``vector``: (norm, new vector)."""
    for _ in range(steps):
        left = weight @ vector
        left = left / (jnp.linalg.norm(left) + 1e-12)
        vector = weight.T @ left
        vector = vector / (jnp.linalg.norm(vector) + 1e-12)
    return jnp.linalg.norm(weight @ vector), vector


def cap_spectral_norm(net: Network, vectors: dict[str, Array], cap: float) -> tuple[Network, dict[str, Array]]:
    """Scale down each layer whose spectral norm exceeds ``cap``, as DAIML does after every update.

    ``vectors`` holds one right singular vector estimate per layer, kept from update to update: the weights move slowly,
    so one step of power iteration each time follows them.
    """
    layers, following = {}, {}
    for name, layer in net.layers.items():
        norm, following[name] = power_iterate(layer["kernel"], vectors[name])
        layers[name] = layer | {"kernel": layer["kernel"] * jnp.minimum(1.0, cap / jnp.maximum(norm, 1e-12))}
    return net._replace(layers=layers), following
