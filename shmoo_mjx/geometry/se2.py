"""Planar poses, twists and wrenches.

A pose is ``[..., 3]`` = (x, y, yaw) in m and rad, a twist (vx, vy, wz) in m/s and rad/s, a wrench (fx, fy, tz) in N and
N m. All functions accept NumPy or JAX arrays with any leading batch dimensions and return arrays of the same kind.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from shmoo_mjx.arrays import Array, ArrayT, Float, Scalar, ScalarT

_PLAIN = (np.ndarray, np.generic, float, int)


def array_module(*arrays: Scalar | np.generic | Array) -> Any:
    """The module ``numpy`` if all arguments are NumPy arrays or numbers, otherwise ``jax.numpy``."""
    for array in arrays:  # a loop is twice as fast as all(), and this runs 5,000 times per simulated second
        if not isinstance(array, _PLAIN):
            import jax.numpy as jnp

            return jnp
    return np


def stack(*columns: np.generic | ArrayT) -> ArrayT:
    """Stack arrays of the same shape and kind along a new last axis."""
    xp = array_module(*columns)
    if xp is not np:
        return xp.stack(columns, axis=-1)
    out = xp.empty((*columns[0].shape, len(columns)), columns[0].dtype)
    for i, column in enumerate(columns):  # numpy.stack takes twice as long
        out[..., i] = column
    return out


def wrap(angle: ScalarT) -> ScalarT:
    """Wrap an angle [rad] to [-pi, pi)."""
    xp = array_module(angle)
    if xp is np:
        return xp.mod(angle + np.pi, 2 * np.pi) - np.pi
    # XLA vectorises this formula but not the remainder.
    return angle - 2 * xp.pi * xp.floor((angle + xp.pi) / (2 * xp.pi))


def rotate(vector: Float[ArrayT, "... n"], angle: float | np.generic | Float[ArrayT, "..."]) -> Float[ArrayT, "... n"]:
    """Rotate the first two entries of ``vector`` by R_z(angle); an optional third entry is kept.

    This transforms a planar vector, twist or wrench (about the same point) from a frame with yaw ``angle`` [rad] to the
    world frame. Use ``-angle`` for the opposite direction.
    """
    xp = array_module(vector, angle)
    c, s = xp.cos(angle), xp.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    out = [c * x - s * y, s * x + c * y]
    if vector.shape[-1] == 3:
        out.append(vector[..., 2] if xp is np else xp.broadcast_to(vector[..., 2], out[0].shape))
    return stack(*out)


def transform_point(pose: Float[ArrayT, "... 3"], point: Float[ArrayT, "... 2"]) -> Float[ArrayT, "... 2"]:
    """Transform a point [m] from the frame ``pose`` to its parent frame."""
    return array_module(pose, point).add(pose[..., :2], rotate(point, pose[..., 2]))


def inverse_transform_point(pose: Float[ArrayT, "... 3"], point: Float[ArrayT, "... 2"]) -> Float[ArrayT, "... 2"]:
    """Transform a point [m] from the parent frame to the frame ``pose``."""
    return rotate(array_module(pose, point).subtract(point, pose[..., :2]), -pose[..., 2])


def compose(a: Float[ArrayT, "... 3"], b: Float[ArrayT, "... 3"]) -> Float[ArrayT, "... 3"]:
    """Pose a * b: transform ``b`` from frame ``a`` to the parent frame of ``a``. Yaw is not wrapped."""
    xp = array_module(a, b)
    return xp.concatenate([transform_point(a, b[..., :2]), (a[..., 2] + b[..., 2])[..., None]], axis=-1)


def relative(a: Float[ArrayT, "... 3"], b: Float[ArrayT, "... 3"]) -> Float[ArrayT, "... 3"]:
    """Pose a^-1 * b: ``b`` relative to ``a``, both given in the same parent frame. Yaw is wrapped."""
    xp = array_module(a, b)
    return xp.concatenate([inverse_transform_point(a, b[..., :2]), wrap(b[..., 2] - a[..., 2])[..., None]], axis=-1)


def cross(a: Float[ArrayT, "... 2"], b: Float[ArrayT, "... 2"]) -> Float[ArrayT, "..."]:
    """z component of the cross product of planar vectors, such as the moment of force ``b`` at lever arm ``a``."""
    return array_module(a, b).subtract(a[..., 0] * b[..., 1], a[..., 1] * b[..., 0])
