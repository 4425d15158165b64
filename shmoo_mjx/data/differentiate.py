"""Accelerations from recorded twists, as the labels of R and O (Sec. III-C)."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.geometry import se2
from shmoo_mjx.types import DT


def sample_acceleration(twist: Array, dt: float = DT) -> Array:
    """Mean acceleration of each sample, ``(twist[k + 1] - twist[k]) / dt``.

    The mean over the sample, not a derivative at its start: Eq. 1 adds it to the twist over exactly this time, and the
    recorded force is the mean over the same time.

    Args:
        twist: ``[..., L, 3]`` at the start of each sample, in {W} [m/s, rad/s].
        dt: sample time [s].

    Returns:
        ``[..., L - 1, 3]`` in {W} [m/s^2, rad/s^2]; the last sample has no end and so no label.
    """
    return (twist[..., 1:, :] - twist[..., :-1, :]) / dt


def body_acceleration(pose: Array, twist: Array, dt: float = DT) -> np.ndarray:
    """`sample_acceleration` turned into the body's frame at the start of each sample, ``[..., L - 1, 3]``.

    ``pose [..., L, 3]`` and ``twist [..., L, 3]`` are in {W}.
    """
    return np.asarray(se2.rotate(sample_acceleration(np.asarray(twist), dt), -np.asarray(pose)[..., :-1, 2]))
