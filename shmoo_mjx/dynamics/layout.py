"""Conversion between the channels-last layout of states and the channels-first layout inside the transition.

Outside the transition a state is ``[..., n]``. Inside it is ``[n, ...]``, so each channel of a batch of roll-outs is
contiguous in memory. On a CPU this makes arithmetic on poses and contacts several times as fast, and the matrix
products of the networks need no transposition. Only this module converts between the two.
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
    """Move the last axis to the front."""
    return jnp.moveaxis(jnp.asarray(x), -1, 0)


def channels_last(x: Shaped[Array, "n ..."]) -> Shaped[Array, "... n"]:
    """Move the first axis to the end."""
    return jnp.moveaxis(x, 0, -1)


def to_channels_first(state: SystemState, batch: tuple[int, ...]) -> SystemState:
    """A state with channels first, broadcast to the batch dimensions ``batch``.

    Face and size are not broadcast: they get batch dimensions of length 1 where one value holds for all.
    """
    moving = {name: jnp.asarray(getattr(state, name)) for name in MOVING}
    spread = {name: channels_first(jnp.broadcast_to(x, (*batch, x.shape[-1]))) for name, x in moving.items()}
    face, size = jnp.asarray(state.face), jnp.asarray(state.size)
    face = face.reshape((1,) * (len(batch) + 1 - face.ndim) + face.shape)
    size = size.reshape((1,) * (len(batch) - size.ndim) + size.shape)
    return SystemState(**spread, face=channels_first(face), size=size)


def to_channels_last(state: SystemState) -> SystemState:
    """The inverse of `to_channels_first`: channels last, with face and size broadcast over the whole batch."""
    batch = state.robot_pose.shape[1:]
    moving = {name: channels_last(getattr(state, name)) for name in MOVING}
    face = channels_last(jnp.broadcast_to(state.face, (state.face.shape[0], *batch)))
    return SystemState(**moving, face=face, size=jnp.broadcast_to(state.size, batch))


def time_first(x: Shaped[Array, "*S T n"]) -> Shaped[Array, "T *S n"]:
    """Move the time axis to the front.

    Roll-outs store equal times side by side in memory, so computation in this order is vectorised.
    """
    return jnp.moveaxis(x, -2, 0)


def mean_over_time(x: Shaped[Array, "T *S"]) -> Shaped[Array, "*S"]:
    """Mean over the first axis, written as a matrix product because XLA has faster code for it than for a sum."""
    return jnp.tensordot(jnp.full(len(x), 1.0 / len(x)), x, axes=1)


def once(tree: Any) -> Any:
    """The same values, behind an optimization barrier. Without it XLA recomputes cheap geometry for every use."""
    return jax.lax.optimization_barrier(tree)


class SO2(NamedTuple):
    """A planar rotation, stored as cosine and sine so that they are computed once."""

    c: Float[Array, "..."]
    """Cosine of the angle."""
    s: Float[Array, "..."]
    """Sine of the angle."""

    @classmethod
    def from_angle(cls, angle: Scalar | Float[Array, "..."]) -> SO2:
        """The rotation R_z(angle), for an angle in rad."""
        return cls(jnp.cos(angle), jnp.sin(angle))

    def apply(self, vector: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
        """Rotate the first two of the two or three components of ``vector``: `se2.rotate` with channels first."""
        x, y = vector[0], vector[1]
        return jnp.stack([self.c * x - self.s * y, self.s * x + self.c * y, *vector[2:]])

    def inverse_apply(self, vector: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
        """Rotate ``vector`` by the negative angle."""
        return self.inverse().apply(vector)

    def compose(self, other: SO2) -> SO2:
        """The rotation by the sum of both angles."""
        return SO2(self.c * other.c - self.s * other.s, self.s * other.c + self.c * other.s)

    def inverse(self) -> SO2:
        """The rotation by the negative angle."""
        return SO2(self.c, -self.s)
