"""Multi-layer perceptrons as plain pytrees, with the normalisation of their inputs stored beside the weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx.arrays import Array, Float, Key

__all__ = [
    "ACTIVATIONS",
    "MLP",
    "FusedMLP",
    "apply",
    "cap_spectral_norm",
    "fuse",
    "init",
    "power_iterate",
    "with_normaliser",
]

ACTIVATIONS: dict[str, Callable[[Array], Array]] = {"tanh": jnp.tanh, "relu": jax.nn.relu, "silu": jax.nn.silu}
"""Names a config may use."""


class MLP(NamedTuple):
    """Weights of a fully connected network; the hidden activation is an argument of `apply`."""

    weights: tuple[Float[Array, "_n_in _n_out"], ...]
    """One per layer."""
    biases: tuple[Float[Array, "_n_out"], ...]
    """One per layer."""
    mean: Float[Array, "n_0"] | Float[Array, ""]
    """Subtracted from the input, in the input's unit."""
    scale: Float[Array, "n_0"] | Float[Array, ""]
    """The input is divided by this, in the input's unit."""


class FusedMLP(NamedTuple):
    """The same network made ready for roll-outs: channels first, the normaliser folded into the first layer."""

    weights: tuple[Float[Array, "_n_out _n_in"], ...]
    """One per layer."""
    biases: tuple[Float[Array, "_n_out"], ...]
    """One per layer."""
    skip: Float[Array, "n_last n_0"] | None = None
    """A linear map of the input that is added to the output."""

    def followed_by(self, linear: Callable[[Float[Array, "n_last ..."]], Float[Array, "m ..."]]) -> FusedMLP:
        """The network followed by a linear map of its outputs."""
        weights, biases = ((*x[:-1], linear(x[-1])) for x in (self.weights, self.biases))
        return self._replace(weights=weights, biases=biases)

    def with_affine(self, skip: Float[Array, "n_last n_0"] | None, bias: Float[Array, "n_last"]) -> FusedMLP:
        """The network with ``skip`` times its input and ``bias`` added to its output."""
        return self._replace(biases=(*self.biases[:-1], self.biases[-1] + bias), skip=skip)

    def forward(self, x: Float[Array, "n_0 ..."], activation: str = "tanh") -> Float[Array, "n_last ..."]:
        """What `apply` gives, with channels first."""
        function = ACTIVATIONS[activation]
        ones = (1,) * (x.ndim - 1)
        h = x
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            h = jnp.tensordot(weight, h, axes=1) + bias.reshape(-1, *ones)
            h = function(h) if i + 1 < len(self.weights) else h
        return h if self.skip is None else h + jnp.tensordot(self.skip, x, axes=1)


def init(key: Key[Array, ""], widths: Sequence[int]) -> MLP:
    """Fresh weights (LeCun normal, zero bias) for layers of ``widths``, e.g. (28, 128, 128, 50, 5)."""
    keys = jax.random.split(key, len(widths) - 1)
    pairs = list(pairwise(widths))
    weights = tuple(jax.random.normal(k, (n, m)) / jnp.sqrt(n) for k, (n, m) in zip(keys, pairs, strict=True))
    biases = tuple(jnp.zeros(m) for _, m in pairs)
    return MLP(weights, biases, jnp.zeros(widths[0]), jnp.ones(widths[0]))


def with_normaliser(mlp: MLP, inputs: Float[Array, "... n_0"], floor: float = 1e-3) -> MLP:
    """The same network, its input normaliser set to the mean and standard deviation of ``inputs``."""
    rows = inputs.reshape(-1, inputs.shape[-1])
    return mlp._replace(mean=jnp.mean(rows, axis=0), scale=jnp.maximum(jnp.std(rows, axis=0), floor))


def apply(mlp: MLP, x: Float[Array, "... n_0"], activation: str = "tanh") -> Float[Array, "... n_last"]:
    """Output for input ``x``; the last layer is linear."""
    function = ACTIVATIONS[activation]
    h = (x - mlp.mean) / mlp.scale
    for weight, bias in zip(mlp.weights[:-1], mlp.biases[:-1], strict=True):
        h = function(h @ weight + bias)
    return h @ mlp.weights[-1] + mlp.biases[-1]


def fuse(mlp: MLP) -> FusedMLP:
    """Prepare a network for `FusedMLP.forward`; once per plan, so that its steps need not."""
    first = mlp.weights[0].T / mlp.scale
    biases = (mlp.biases[0] - first @ mlp.mean, *mlp.biases[1:])
    return FusedMLP((first, *(w.T for w in mlp.weights[1:])), biases)


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


def cap_spectral_norm(
    mlp: MLP, vectors: tuple[Float[Array, "_n_out"], ...], cap: float
) -> tuple[MLP, tuple[Float[Array, "_n_out"], ...]]:
    """Scale down each layer whose spectral norm exceeds ``cap``, as DAIML does after every update.

    ``vectors`` holds one right singular vector estimate per layer, kept from update to update: the weights move slowly,
    so one step of power iteration each time follows them.
    """
    weights, following = [], []
    for weight, vector in zip(mlp.weights, vectors, strict=True):
        norm, vector = power_iterate(weight, vector)
        weights.append(weight * jnp.minimum(1.0, cap / jnp.maximum(norm, 1e-12)))
        following.append(vector)
    return mlp._replace(weights=tuple(weights)), tuple(following)
