"""Multi-layer perceptrons as flax modules, plain and reflection-equivariant, and the spectral norm of their layers.

Robot and floor are symmetric left to right. A network with a left-right bias has fitted noise, and a planner that uses
it steers against a turn that does not exist. `EquivariantMLP` excludes this bias: the output for a mirrored input is
the mirrored output. Its hidden units form pairs that see an input and its mirror image with the same weights. Sums and
differences of pairs have separate weights, so a layer of n units needs half the products of a plain layer (group
convolution over the group of two elements, Cohen and Welling 2016).

A reflection is a symmetric matrix R with R R = 1. It consists of signs and exchanged channels.
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
"""Activation functions by the name that a config uses."""


class Network(NamedTuple):
    """Parameters of a module and the normalisation of its inputs."""

    layers: dict[str, dict[str, Array]]
    """The "kernel" and the "bias" of each layer, from "layer0" on."""
    mean: Float[Array, "n_0"]
    """Value subtracted from the input, in the input's unit."""
    scale: Float[Array, "n_0"]
    """Value by which the input is divided, in the input's unit."""


class MLP(nn.Module):
    """A fully connected network; the last layer is linear."""

    widths: tuple[int, ...]
    """Widths of the hidden layers and of the output."""
    activation: str = "tanh"
    """Name in ACTIVATIONS."""

    @nn.compact
    def __call__(self, x: Float[Array, "... n_0"]) -> Float[Array, "... n_last"]:
        """Output for the normalised input ``x``."""
        function = ACTIVATIONS[self.activation]
        for i, width in enumerate(self.widths):
            x = nn.Dense(width, name=f"layer{i}")(function(x) if i else x)
        return x


class EquivariantMLP(nn.Module):
    """A fully connected network of pairs of units, whose output for a mirrored input is the mirrored output."""

    widths: tuple[int, ...]
    """Widths of the hidden layers and of the output. A hidden width counts both units of each pair and is even."""
    reflections: tuple[np.ndarray, np.ndarray]
    """Reflection matrices of the input ``[n_0, n_0]`` and of the output ``[n_last, n_last]``."""
    activation: str = "tanh"
    """Name in ACTIVATIONS."""

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
    """A layer of pairs. Kernel ``[2 n_in, n_out]``: first the weights for sums, then those for differences."""

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
    """The network with its normalisation set to the mean and standard deviation of ``inputs``.

    With a ``reflection``, the statistics include the mirror images of the inputs.
    """
    rows = inputs.reshape(-1, inputs.shape[-1])
    if reflection is not None:
        rows = jnp.concatenate([rows, rows @ reflection])
    mean: Array = jnp.mean(rows, axis=0)
    scale: Array = jnp.maximum(jnp.std(rows, axis=0), 1e-3)
    if reflection is not None:
        # Makes the symmetry exact: rounding errors leave it approximate in the sums above.
        mean, scale = parts(reflection)[0] @ mean, parts(np.abs(reflection))[0] @ scale
    return net._replace(mean=mean, scale=scale)


def parts(reflection: Float[np.ndarray, "n n"]) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]]:
    """Projections on the even part (unchanged by the reflection) and on the odd part (sign reversed by it)."""
    one = np.eye(len(reflection), dtype=np.float32)
    return (one + reflection) / 2, (one - reflection) / 2


def power_iterate(
    weight: Float[Array, "n m"], vector: Float[Array, "m"], steps: int = 1
) -> tuple[Float[Array, ""], Float[Array, "m"]]:
    """Estimate the spectral norm of ``weight`` by power iteration.

    Args:
        weight: the matrix.
        vector: estimate of its right singular vector, the starting point.
        steps: number of iterations; more is more accurate.

    Returns:
        The norm and the new vector.
    """
    for _ in range(steps):
        left = weight @ vector
        left = left / (jnp.linalg.norm(left) + 1e-12)
        vector = weight.T @ left
        vector = vector / (jnp.linalg.norm(vector) + 1e-12)
    return jnp.linalg.norm(weight @ vector), vector


def cap_spectral_norm(net: Network, vectors: dict[str, Array], cap: float) -> tuple[Network, dict[str, Array]]:
    """Scale down each layer whose spectral norm exceeds ``cap``, as DAIML does after every update.

    ``vectors`` holds one estimate of a right singular vector per layer and is kept between updates. The weights change
    slowly, so one step of power iteration per update is enough.
    """
    layers, following = {}, {}
    for name, layer in net.layers.items():
        norm, following[name] = power_iterate(layer["kernel"], vectors[name])
        layers[name] = layer | {"kernel": layer["kernel"] * jnp.minimum(1.0, cap / jnp.maximum(norm, 1e-12))}
    return net._replace(layers=layers), following
