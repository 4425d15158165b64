"""Perceptrons that are equivariant under reflection: the answer to a mirrored input is the mirrored answer.

Robot and floor are alike on both sides, so a network that prefers one has mistaken chance for a law, and whoever plans
with it steers against an imagined turn. Here no weights can: hidden units come in pairs that see an input and its
mirror image with the same weights. What a pair's sum and difference are multiplied with is kept apart, so a layer of n
units costs half the products of a plain one (group convolution over the group of two elements, Cohen and Welling 2016).

A reflection is a symmetric matrix R with R R = 1: signs, and channels that change places.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float, Key
from shmoo_mjx.dynamics import mlp
from shmoo_mjx.dynamics.mlp import MLP

__all__ = ["FusedEquivariantMLP", "apply", "fuse", "init", "parts", "with_normaliser"]


class FusedEquivariantMLP(NamedTuple):
    """The network made ready for roll-outs: channels first, the normaliser folded into the first layer."""

    even: tuple[Float[Array, "_out _in"], ...]
    """One ``[n_out / 2, n_in / 2]`` per layer, for the sums of pairs; the first ``[n_1 / 2, n_0]``."""
    odd: tuple[Float[Array, "_out _in"], ...]
    """The same for their differences."""
    biases: tuple[Float[Array, "_out"], ...]
    skip: Float[Array, "n_last n_0"] | None = None
    """A linear map of the input that is added to the output."""

    def followed_by(self, linear: Callable[[Float[Array, "n_last ..."]], Float[Array, "m ..."]]) -> FusedEquivariantMLP:
        """The network followed by a linear map of its outputs."""
        even, odd, biases = ((*x[:-1], linear(x[-1])) for x in (self.even, self.odd, self.biases))
        return self._replace(even=even, odd=odd, biases=biases)

    def with_affine(self, skip: Float[Array, "n_last n_0"] | None, bias: Float[Array, "n_last"]) -> FusedEquivariantMLP:
        """The network with ``skip`` times its input and ``bias`` added to its output."""
        return self._replace(biases=(*self.biases[:-1], self.biases[-1] + bias), skip=skip)

    def forward(self, x: Float[Array, "n_0 ..."], activation: str = "tanh") -> Float[Array, "n_last ..."]:
        """What `apply` gives, with channels first."""
        function = mlp.ACTIVATIONS[activation]
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


def init(key: Key[Array, ""], widths: Sequence[int]) -> MLP:
    """Fresh weights (LeCun normal, zero bias); ``widths`` count both units of a pair and are even but for the ends.

    Each layer's weights are ``[n_in, n_out / 2]``, those for sums above those for differences; the first layer's are
    ``[2 n_0, n_1 / 2]`` and the last layer's ``[n_in, n_last]``.
    """
    first, *hidden, last = widths
    if any(width % 2 for width in hidden):
        raise ValueError(f"hidden layers of {tuple(hidden)} units do not consist of pairs; choose even widths.")
    keys = jax.random.split(key, len(widths) - 1)
    pairs = list(pairwise((first, *(width // 2 for width in hidden), last)))
    weights = tuple(jax.random.normal(k, (2 * n, m)) / jnp.sqrt(2 * n) for k, (n, m) in zip(keys, pairs, strict=True))
    return MLP(weights, tuple(jnp.zeros(m) for _, m in pairs), jnp.zeros(first), jnp.ones(first))


def parts(reflection: Float[np.ndarray, "n n"]) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]]:
    """Projections on what the mirror leaves and on what it turns round."""
    one = np.eye(len(reflection), dtype=np.float32)
    return (one + reflection) / 2, (one - reflection) / 2


def with_normaliser(net: MLP, inputs: Float[Array, "... n_0"], reflection: Float[np.ndarray, "n_0 n_0"]) -> MLP:
    """The same network, normalised by ``inputs`` and their mirror images."""
    rows = inputs.reshape(-1, inputs.shape[-1])
    net = mlp.with_normaliser(net, jnp.concatenate([rows, rows @ reflection]))
    # Exactly: sums of many numbers and of their negatives need not be zero.
    return net._replace(mean=parts(reflection)[0] @ net.mean, scale=parts(np.abs(reflection))[0] @ net.scale)


def apply(
    net: MLP,
    x: Float[Array, "... n_0"],
    reflections: tuple[Float[np.ndarray, "n_0 n_0"], Float[np.ndarray, "n_last n_last"]],
    activation: str = "tanh",
) -> Float[Array, "... n_last"]:
    """Output for input ``x``; the reflections are of input and output."""
    function = mlp.ACTIVATIONS[activation]
    x = (x - net.mean) / net.scale
    even, odd = (x @ part for part in parts(reflections[0]))
    for weight, bias in zip(net.weights[:-1], net.biases[:-1], strict=True):
        n = len(weight) // 2
        both, apart = even @ weight[:n] + bias, odd @ weight[n:]
        there, mirrored = function(both + apart), function(both - apart)
        even, odd = (there + mirrored) * np.sqrt(0.5), (there - mirrored) * np.sqrt(0.5)
    n = len(net.weights[-1]) // 2
    keep_even, keep_odd = parts(reflections[1])
    return (even @ net.weights[-1][:n] + net.biases[-1]) @ keep_even + odd @ net.weights[-1][n:] @ keep_odd


def fuse(
    net: MLP, reflections: tuple[Float[np.ndarray, "n_0 n_0"], Float[np.ndarray, "n_last n_last"]]
) -> FusedEquivariantMLP:
    """Prepare a network for `FusedEquivariantMLP.forward`; once per plan, so that its steps need not."""
    halves = [jnp.split(weight, 2) for weight in net.weights]
    even, odd = (list(weights) for weights in zip(*halves, strict=True))
    for weights, into, out in zip((even, odd), *(parts(r) for r in reflections), strict=True):
        weights[0] = into @ weights[0] / net.scale[:, None]
        weights[-1] = weights[-1] @ out
        weights[1:] = [weight * np.sqrt(0.5) for weight in weights[1:]]
    biases = [*net.biases[:-1], net.biases[-1] @ parts(reflections[1])[0]]
    biases[0] = biases[0] - net.mean @ even[0]
    return FusedEquivariantMLP(tuple(w.T for w in even), tuple(w.T for w in odd), tuple(biases))
