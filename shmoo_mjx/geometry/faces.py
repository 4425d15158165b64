"""The four sides of a rectangular footprint as faces to push on, and its corners, held between the hands."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_RADIUS, REACH, SEPARATION


def faces_of(half_extents: tuple[float, float]) -> Float[np.ndarray, "4 4"]:
    """Faces in {O}: centre x, y [m], direction of the inward normal [rad], half the width [m].

    In the order rear (pushes towards +x), right (+y), front (-x), left (-y).
    """
    a, b = half_extents
    return np.array([(-a, 0.0, 0.0, b), (0.0, -b, np.pi / 2, a), (a, 0.0, -np.pi, b), (0.0, b, -np.pi / 2, a)])


def corners_of(half_extents: tuple[float, float]) -> Float[np.ndarray, "4 4"]:
    """Corners as faces in {O}, as :func:`faces_of` has the sides: the hands touch a side each, the corner between them.

    In the order rear right (pushes towards +x, +y), front right, front left, rear left.
    """
    deep = SEPARATION / 2 - (np.sqrt(2) - 1) * HAND_RADIUS  # from the corner to where the hands touch
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    centres = signs * (np.array(half_extents) - deep / np.sqrt(2))
    half_width = np.full((4, 1), SEPARATION / 2)
    return np.concatenate([centres, np.arctan2(-signs[:, 1], -signs[:, 0])[:, None], half_width], axis=1)


def heading(object_pose: Float[Array, "... 3"], face: Float[Array, "... 4"]) -> Scalar | Float[Array, "..."]:
    """Heading in {W} [rad] of a robot that faces ``face`` of an object at ``object_pose``."""
    return se2.wrap(object_pose[..., 2] + face[..., 2])


def stand_off(
    object_pose: Float[np.ndarray, "3"],
    face: Float[np.ndarray, "4"],
    gap: float,
    lateral: float = 0.0,
    *,
    reach: float = REACH,
) -> Float[np.ndarray, "3"]:
    """Pose of {R} in {W} that faces ``face``, with ``gap`` metres between it and the extended hands.

    Args:
        object_pose: of {O} in {W}.
        face: as in :func:`faces_of`.
        gap: clearance between hand surface and face [m].
        lateral: shift along the face, to the robot's left [m].
        reach: x of the hands' midpoint in {R} [m].
    """
    in_face = np.array([-(gap + reach + HAND_RADIUS), lateral, 0.0])
    return se2.compose(np.asarray(object_pose, dtype=float), se2.compose(face[:3], in_face))
