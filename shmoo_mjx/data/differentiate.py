"""Accelerations from recorded twists: the labels of R and O (Sec. III-C)."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.geometry import se2
from shmoo_mjx.types import DT


def sample_acceleration(twist: Array, dt: float = DT) -> Array:
    """Mean acceleration over each sample, ``(twist[k + 1] - twist[k]) / dt``.

    The mean is used instead of the derivative at the start, because Eq. 1 integrates the acceleration over exactly one
    sample, and the recorded force is also a mean over it.

    Args:
        twist: twists ``[..., L, 3]`` at the start of each sample, in {W} [m/s, rad/s].
        dt: sample time [s].

    Returns:
        Accelerations ``[..., L - 1, 3]`` in {W} [m/s^2, rad/s^2]. The last sample has no label.
    """
    return (twist[..., 1:, :] - twist[..., :-1, :]) / dt


def body_acceleration(pose: Array, twist: Array, dt: float = DT) -> np.ndarray:
    """`sample_acceleration` in the body frame at the start of each sample.

    Args:
        pose: poses ``[..., L, 3]`` in {W} [m, rad].
        twist: twists ``[..., L, 3]`` in {W} [m/s, rad/s].
        dt: sample time [s].

    Returns:
        Accelerations ``[..., L - 1, 3]`` in the body frame [m/s^2, rad/s^2].
    """
    return np.asarray(se2.rotate(sample_acceleration(np.asarray(twist), dt), -np.asarray(pose)[..., :-1, 2]))
