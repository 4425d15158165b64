"""Channels first: how arrays lie inside the transition.

Outside, a state is ``[..., n]``. Inside, it is ``[n, ...]``, so that each channel of a batch of roll-outs is one whole
vector of samples: on a CPU that makes arithmetic on poses and contacts several times as fast, and the networks' matrix
products need no transposition. This module is the only place where one becomes the other.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx.arrays import Array, Float, Scalar, Shaped
from shmoo_mjx.types import SystemState

MOVING = tuple(name for name in SystemState._fields if name not in ("face", "size"))
"""Fields of a state that change during a push."""


def channels_first(x: Shaped[Array, "... n"]) -> Shaped[Array, "n ..."]:
    """The last axis first."""
    return jnp.moveaxis(jnp.asarray(x), -1, 0)


def channels_last(x: Shaped[Array, "n ..."]) -> Shaped[Array, "... n"]:
    """The first axis last."""
    return jnp.moveaxis(x, 0, -1)


def to_channels_first(state: SystemState, batch: tuple[int, ...]) -> SystemState:
    """A state with channels first and its batch dimensions spread to ``batch``; face and size are not copied.

    Face and size get batch dimensions of length 1 where they are the same for all.
    """
    moving = {name: jnp.asarray(getattr(state, name)) for name in MOVING}
    spread = {name: channels_first(jnp.broadcast_to(x, (*batch, x.shape[-1]))) for name, x in moving.items()}
    face, size = jnp.asarray(state.face), jnp.asarray(state.size)
    face = face.reshape((1,) * (len(batch) + 1 - face.ndim) + face.shape)
    size = size.reshape((1,) * (len(batch) - size.ndim) + size.shape)
    return SystemState(**spread, face=channels_first(face), size=size)


def to_channels_last(state: SystemState) -> SystemState:
    """The inverse of `to_channels_first`: channels last, face and size spread over the whole batch."""
    batch = state.robot_pose.shape[1:]
    moving = {name: channels_last(getattr(state, name)) for name in MOVING}
    face = channels_last(jnp.broadcast_to(state.face, (state.face.shape[0], *batch)))
    return SystemState(**moving, face=face, size=jnp.broadcast_to(state.size, batch))


def time_first(x: Shaped[Array, "*S T n"]) -> Shaped[Array, "T *S n"]:
    """Time as the first axis. In memory the roll-outs' samples lie side by side: what computes in this order reads them
    as vectors."""
    return jnp.moveaxis(x, -2, 0)


def mean_over_time(x: Shaped[Array, "T *S"]) -> Shaped[Array, "*S"]:
    """Mean over the first axis: as a product, for which XLA has faster code than for a sum."""
    return jnp.tensordot(jnp.full(len(x), 1.0 / len(x)), x, axes=1)


def once(tree: Any) -> Any:
    """The same values, computed once: left alone, XLA repeats cheap-looking geometry for every use of it."""
    return jax.lax.optimization_barrier(tree)


class SO2(NamedTuple):
    """A rotation by some angle, kept as its cosine and sine: those are worth computing once."""

    c: Float[Array, "..."]
    s: Float[Array, "..."]

    @classmethod
    def from_angle(cls, angle: Scalar | Float[Array, "..."]) -> SO2:
        """R_z(angle)."""
        return cls(jnp.cos(angle), jnp.sin(angle))

    def apply(self, vector: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
        """`se2.rotate` with channels first: turns the first two of ``vector``'s two or three."""
        x, y = vector[0], vector[1]
        return jnp.stack([self.c * x - self.s * y, self.s * x + self.c * y, *vector[2:]])

    def inverse_apply(self, vector: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
        """The inverse rotation."""
        return self.inverse().apply(vector)

    def compose(self, other: SO2) -> SO2:
        """The rotation by the sum of both angles."""
        return SO2(self.c * other.c - self.s * other.s, self.s * other.c + self.c * other.s)

    def inverse(self) -> SO2:
        """The rotation by the negative angle."""
        return SO2(self.c, -self.s)
