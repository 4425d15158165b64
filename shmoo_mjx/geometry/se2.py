"""Poses, twists and wrenches on the plane.

A pose is ``[..., 3]`` = (x, y, yaw) in m and rad; a twist (vx, vy, wz) in m/s and rad/s; a wrench (fx, fy, tz) in N and
N m. Every function takes NumPy or JAX arrays, keeps leading batch dimensions, and answers in the kind it was given.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from shmoo_mjx.arrays import Array, ArrayT, Float, Scalar, ScalarT

_PLAIN = (np.ndarray, np.generic, float, int)


def array_module(*arrays: Scalar | np.generic | Array) -> Any:
    """numpy if every array is a plain NumPy array or number, jax.numpy otherwise."""
    for array in arrays:  # all() of a generator takes twice as long, and this is asked 5,000 times per simulated second
        if not isinstance(array, _PLAIN):
            import jax.numpy as jnp

            return jnp
    return np


def stack(*columns: np.generic | ArrayT) -> ArrayT:
    """The columns, of one shape and kind, as the last axis of an array."""
    xp = array_module(*columns)
    if xp is not np:
        return xp.stack(columns, axis=-1)
    out = xp.empty((*columns[0].shape, len(columns)), columns[0].dtype)
    for i, column in enumerate(columns):  # numpy.stack takes twice as long
        out[..., i] = column
    return out


def wrap(angle: ScalarT) -> ScalarT:
    """The same angle [rad] in [-pi, pi)."""
    xp = array_module(angle)
    if xp is np:
        return xp.mod(angle + np.pi, 2 * np.pi) - np.pi
    # XLA takes a remainder number by number, and this in vectors.
    return angle - 2 * xp.pi * xp.floor((angle + xp.pi) / (2 * xp.pi))


def rotate(vector: Float[ArrayT, "... n"], angle: float | np.generic | Float[ArrayT, "..."]) -> Float[ArrayT, "... n"]:
    """R_z(angle) applied to the first two of ``vector``'s two or three entries; a third entry is kept.

    Turns a planar vector, twist or wrench (about the same point) from a frame whose yaw is ``angle`` into the world
    frame; with ``-angle`` it goes the other way.
    """
    xp = array_module(vector, angle)
    c, s = xp.cos(angle), xp.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    out = [c * x - s * y, s * x + c * y]
    if vector.shape[-1] == 3:
        out.append(vector[..., 2] if xp is np else xp.broadcast_to(vector[..., 2], out[0].shape))
    return stack(*out)


def transform_point(pose: Float[ArrayT, "... 3"], point: Float[ArrayT, "... 2"]) -> Float[ArrayT, "... 2"]:
    """A point given in the frame ``pose``, in that pose's parent frame."""
    return array_module(pose, point).add(pose[..., :2], rotate(point, pose[..., 2]))


def inverse_transform_point(pose: Float[ArrayT, "... 3"], point: Float[ArrayT, "... 2"]) -> Float[ArrayT, "... 2"]:
    """A point of the parent frame, in the frame ``pose``."""
    return rotate(array_module(pose, point).subtract(point, pose[..., :2]), -pose[..., 2])


def compose(a: Float[ArrayT, "... 3"], b: Float[ArrayT, "... 3"]) -> Float[ArrayT, "... 3"]:
    """The pose ``b``, given in frame ``a``, in ``a``'s parent frame (a * b). Yaw is not wrapped."""
    xp = array_module(a, b)
    return xp.concatenate([transform_point(a, b[..., :2]), (a[..., 2] + b[..., 2])[..., None]], axis=-1)


def relative(a: Float[ArrayT, "... 3"], b: Float[ArrayT, "... 3"]) -> Float[ArrayT, "... 3"]:
    """The pose ``b`` seen from ``a``, both given in one parent frame (a^-1 * b), yaw wrapped."""
    xp = array_module(a, b)
    return xp.concatenate([inverse_transform_point(a, b[..., :2]), wrap(b[..., 2] - a[..., 2])[..., None]], axis=-1)


def cross(a: Float[ArrayT, "... 2"], b: Float[ArrayT, "... 2"]) -> Float[ArrayT, "..."]:
    """z component of the cross product of planar vectors: the moment of force b at lever arm a."""
    return array_module(a, b).subtract(a[..., 0] * b[..., 1], a[..., 1] * b[..., 0])
