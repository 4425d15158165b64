"""Faces of a rectangular footprint on which the robot pushes: its four sides, and its corners between the hands."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_RADIUS, REACH, SEPARATION


def faces_of(half_extents: tuple[float, float]) -> Float[np.ndarray, "4 4"]:
    """Faces of the four sides in {O}.

    Args:
        half_extents: half length and half width of the footprint [m].

    Returns:
        One row per face: centre x, y [m], direction of the inward normal [rad], half width [m]. The order is rear
            (pushes towards +x), right (+y), front (-x), left (-y).
    """
    a, b = half_extents
    return np.array([(-a, 0.0, 0.0, b), (0.0, -b, np.pi / 2, a), (a, 0.0, -np.pi, b), (0.0, b, -np.pi / 2, a)])


def corners_of(half_extents: tuple[float, float]) -> Float[np.ndarray, "4 4"]:
    """Faces of the four corners in {O}. Each hand touches one of the two adjacent sides; the corner is between them.

    Args:
        half_extents: half length and half width of the footprint [m].

    Returns:
        One row per corner, in the format of :func:`faces_of`. The order is rear right (pushes towards +x, +y), front
            right, front left, rear left.
    """
    deep = SEPARATION / 2 - (np.sqrt(2) - 1) * HAND_RADIUS  # distance from the corner to the plane at the hands' front
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    centres = signs * (np.array(half_extents) - deep / np.sqrt(2))
    half_width = np.full((4, 1), SEPARATION / 2)
    return np.concatenate([centres, np.arctan2(-signs[:, 1], -signs[:, 0])[:, None], half_width], axis=1)


def heading(object_pose: Float[Array, "... 3"], face: Float[Array, "... 4"]) -> Scalar | Float[Array, "..."]:
    """Heading in {W} of a robot that pushes on ``face`` of an object at ``object_pose`` [rad]."""
    return se2.wrap(object_pose[..., 2] + face[..., 2])


def stand_off(
    object_pose: Float[np.ndarray, "3"],
    face: Float[np.ndarray, "4"],
    gap: float,
    lateral: float = 0.0,
    *,
    reach: float = REACH,
) -> Float[np.ndarray, "3"]:
    """Pose of {R} in {W} in front of ``face``, with a gap between the hands and the face.

    Args:
        object_pose: pose of {O} in {W} [m, rad].
        face: face, in the format of :func:`faces_of`.
        gap: clearance between the hands' surface and the face [m].
        lateral: shift along the face, to the robot's left [m].
        reach: x of the hands' midpoint in {R} [m].

    Returns:
        Pose (x, y, yaw) [m, rad].
    """
    in_face = np.array([-(gap + reach + HAND_RADIUS), lateral, 0.0])
    return se2.compose(np.asarray(object_pose, dtype=float), se2.compose(face[:3], in_face))
