"""Desired hand positions by the steering rule of Sec. III, shared by the plant and the dynamics core."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float, Scalar
from shmoo_mjx.geometry import se2

REACH = 0.42
"""x of the hands' midpoint in {R} with extended arms [m]."""
TUCKED_REACH = 0.20
"""x of the hands' midpoint in {R} with arms folded for driving [m]."""
SEPARATION = 0.36
"""Distance l between the hands with extended arms [m]."""
HAND_HEIGHT = 0.38
"""Height of the hands above the floor while pushing [m]. It is low so that boxes slide instead of toppling."""
TUCKED_HEIGHT = 0.68
"""Height of the hands above the floor with folded arms [m]. With lower hands, the elbows would protrude sideways."""
HAND_RADIUS = 0.04
"""Radius of the spherical hand [m]."""
CONTACT_FORCE = 2.0
"""Planar force above which the hands count as touching an object [N]. Smaller values are within the error of the
estimate from joint torques."""


def touches(wrench: Float[Array, "... 3"]) -> np.bool | Bool[Array, "..."]:
    """Whether the hands touch an object, from their planar wrench (fx, fy, tz) on it [N, N m]. False for NaN."""
    xp = se2.array_module(wrench)
    return xp.hypot(wrench[..., 0], wrench[..., 1]) > CONTACT_FORCE


def hand_targets(
    gamma: Scalar | Float[Array, "..."], reach: Scalar | Float[Array, "..."] = REACH
) -> Float[Array, "... 2 2"]:
    """Desired hand centres in {R}: [p_l, p_r] = [x, y] +- R_z(gamma)^T l/2 (Sec. III).

    Args:
        gamma: steering angle [rad]; a positive angle moves the left hand forward and turns the object to the right.
        reach: x of the midpoint in {R} [m]; the distance between the hands is proportional to it.

    Returns:
        (left, right) x (x, y) [m].
    """
    xp = se2.array_module(gamma, reach)
    left, right = hand_components(gamma, reach)
    return xp.stack([xp.stack(xp.broadcast_arrays(*left), -1), xp.stack(xp.broadcast_arrays(*right), -1)], -2)


def hand_components(
    gamma: Scalar | Float[Array, "..."], reach: Scalar | Float[Array, "..."] = REACH
) -> tuple[
    tuple[Scalar | Float[Array, "..."], Scalar | Float[Array, "..."]],
    tuple[Scalar | Float[Array, "..."], Scalar | Float[Array, "..."]],
]:
    """Components of `hand_targets`: ((left x, left y), (right x, right y)) [m], each with the shape of ``gamma``."""
    xp = se2.array_module(gamma, reach)
    gamma = xp.asarray(gamma)
    half = SEPARATION / 2 * (reach / REACH)
    half_x, half_y = half * xp.sin(gamma), half * xp.cos(gamma)
    return (reach + half_x, half_y), (reach - half_x, -half_y)
