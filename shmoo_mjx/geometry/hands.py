"""Where the two hands are asked to be: the steering rule of Sec. III, shared by the plant and the dynamics core."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float, Scalar
from shmoo_mjx.geometry import se2

REACH = 0.42
"""x of the point midway between the hands in {R} when the arms are extended [m]."""
TUCKED_REACH = 0.20
"""x of that point when the arms are folded for driving [m]."""
SEPARATION = 0.36
"""Distance l between the hands when the arms are extended [m]."""
HAND_HEIGHT = 0.38
"""Height of the hands above the floor while pushing [m]: low, so that boxes slide rather than topple."""
TUCKED_HEIGHT = 0.68
"""Their height when the arms are folded [m]: with the hands lower the elbows stick out beside the body."""
HAND_RADIUS = 0.04
"""Radius of the spherical hand [m]; the contact surface is this far ahead of the hand's centre."""
CONTACT_FORCE = 2.0
"""Force of the hands from which they touch an object [N]: below it a reading of the joint torques says nothing."""


def touches(wrench: Float[Array, "... 3"]) -> np.bool | Bool[Array, "..."]:
    """Whether the hands touch an object on which their planar wrench is ``wrench``; not if it is NaN."""
    xp = se2.array_module(wrench)
    return xp.hypot(wrench[..., 0], wrench[..., 1]) > CONTACT_FORCE


def hand_targets(
    gamma: Scalar | Float[Array, "..."], reach: Scalar | Float[Array, "..."] = REACH
) -> Float[Array, "... 2 2"]:
    """Desired hand centres in {R}: [p_l, p_r] = [x, y] +- R_z(gamma)^T l/2 (Sec. III).

    Args:
        gamma: steering angle [rad]; positive moves the left hand forward and turns the object to the right.
        reach: x of the midpoint in {R} [m]; the hands come together in proportion as the arms fold.

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
    """`hand_targets` as its parts: ((left x, left y), (right x, right y)), each of gamma's shape [m]."""
    xp = se2.array_module(gamma, reach)
    gamma = xp.asarray(gamma)
    half = SEPARATION / 2 * (reach / REACH)
    half_x, half_y = half * xp.sin(gamma), half * xp.cos(gamma)
    return (reach + half_x, half_y), (reach - half_x, -half_y)
