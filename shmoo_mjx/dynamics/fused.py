"""Networks in the form for roll-outs: channels first, with the normaliser folded into the first layer.

`networks` defines them for training. The fused form gives the same outputs and is faster, which matters because one
plan evaluates it thousands of times.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.dynamics.networks import ACTIVATIONS, Network, parts


class FusedMLP(NamedTuple):
    """`networks.MLP` in the form for roll-outs."""

    weights: tuple[Float[Array, "_n_out _n_in"], ...]
    """Weight matrix of each layer."""
    biases: tuple[Float[Array, "_n_out"], ...]
    """Bias of each layer."""
    skip: Float[Array, "n_last n_0"] | None = None
    """Linear map of the input that is added to the output."""

    def followed_by(self, linear: Callable[[Float[Array, "n_last ..."]], Float[Array, "m ..."]]) -> FusedMLP:
        """The network followed by a linear map of its outputs."""
        weights, biases = ((*x[:-1], linear(x[-1])) for x in (self.weights, self.biases))
        return self._replace(weights=weights, biases=biases)

    def with_affine(self, skip: Float[Array, "n_last n_0"] | None, bias: Float[Array, "n_last"]) -> FusedMLP:
        """The network with ``skip`` times its input and ``bias`` added to its output."""
        return self._replace(biases=(*self.biases[:-1], self.biases[-1] + bias), skip=skip)

    def forward(self, x: Float[Array, "n_0 ..."], activation: str = "tanh") -> Float[Array, "n_last ..."]:
        """The same output as `networks.apply`, with channels first."""
        function = ACTIVATIONS[activation]
        ones = (1,) * (x.ndim - 1)
        h = x
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            h = jnp.tensordot(weight, h, axes=1) + bias.reshape(-1, *ones)
            h = function(h) if i + 1 < len(self.weights) else h
        return h if self.skip is None else h + jnp.tensordot(self.skip, x, axes=1)


class FusedEquivariantMLP(NamedTuple):
    """`networks.EquivariantMLP` in the form for roll-outs."""

    even: tuple[Float[Array, "_out _in"], ...]
    """Weights of each layer for the sums of pairs, ``[n_out / 2, n_in / 2]``; the first is ``[n_1 / 2, n_0]``."""
    odd: tuple[Float[Array, "_out _in"], ...]
    """Weights of each layer for the differences of pairs, with the same shapes."""
    biases: tuple[Float[Array, "_out"], ...]
    """Bias of each layer."""
    skip: Float[Array, "n_last n_0"] | None = None
    """Linear map of the input that is added to the output."""

    def followed_by(self, linear: Callable[[Float[Array, "n_last ..."]], Float[Array, "m ..."]]) -> FusedEquivariantMLP:
        """The network followed by a linear map of its outputs."""
        even, odd, biases = ((*x[:-1], linear(x[-1])) for x in (self.even, self.odd, self.biases))
        return self._replace(even=even, odd=odd, biases=biases)

    def with_affine(self, skip: Float[Array, "n_last n_0"] | None, bias: Float[Array, "n_last"]) -> FusedEquivariantMLP:
        """The network with ``skip`` times its input and ``bias`` added to its output."""
        return self._replace(biases=(*self.biases[:-1], self.biases[-1] + bias), skip=skip)

    def forward(self, x: Float[Array, "n_0 ..."], activation: str = "tanh") -> Float[Array, "n_last ..."]:
        """The same output as `networks.apply`, with channels first."""
        function = ACTIVATIONS[activation]
        ones = (1,) * (x.ndim - 1)
        even = odd = x
        for i, (for_sums, for_differences, bias) in enumerate(zip(self.even, self.odd, self.biases, strict=True)):
            both = jnp.tensordot(for_sums, even, axes=1) + bias.reshape(-1, *ones)
            apart = jnp.tensordot(for_differences, odd, axes=1)
            if i + 1 < len(self.even):
                there, mirrored = function(both + apart), function(both - apart)
                even, odd = there + mirrored, there - mirrored
        out = both + apart
        return out if self.skip is None else out + jnp.tensordot(self.skip, x, axes=1)


def fuse(net: Network) -> FusedMLP:
    """Convert a `networks.MLP` to the form for roll-outs. Call it once per plan."""
    weights, biases = _layers(net)
    first = weights[0].T / net.scale
    return FusedMLP((first, *(w.T for w in weights[1:])), (biases[0] - first @ net.mean, *biases[1:]))


def fuse_equivariant(
    net: Network, reflections: tuple[Float[np.ndarray, "n_0 n_0"], Float[np.ndarray, "n_last n_last"]]
) -> FusedEquivariantMLP:
    """Convert a `networks.EquivariantMLP` to the form for roll-outs. Call it once per plan.

    ``reflections`` are the matrices of the input and of the output.
    """
    kernels, biases = _layers(net)
    halves = [jnp.split(kernel, 2) for kernel in kernels]
    even, odd = (list(weights) for weights in zip(*halves, strict=True))
    for weights, into, out in zip((even, odd), *(parts(r) for r in reflections), strict=True):
        weights[0] = into @ weights[0] / net.scale[:, None]
        weights[-1] = weights[-1] @ out
        weights[1:] = [weight * np.sqrt(0.5) for weight in weights[1:]]
    biases[-1] = biases[-1] @ parts(reflections[1])[0]
    biases[0] = biases[0] - net.mean @ even[0]
    return FusedEquivariantMLP(tuple(w.T for w in even), tuple(w.T for w in odd), tuple(biases))


def _layers(net: Network) -> tuple[list[Array], list[Array]]:
    """Kernels and biases in the order of the layers."""
    layers = [net.layers[f"layer{i}"] for i in range(len(net.layers))]
    return [layer["kernel"] for layer in layers], [layer["bias"] for layer in layers]
