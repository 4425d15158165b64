"""Outline of an object from its contacts with a round pusher: a convex polygon, and contacts of points with it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull, HalfspaceIntersection

from shmoo_mjx.arrays import Array
from shmoo_mjx.geometry import se2

_TOLERANCE = 1e-3
"""Corners of the hull that protrude by less than this count as noise [m]."""
_SHORTEST = 4e-3
"""Faces of the hull shorter than this count as noise [m]."""


class Touch(NamedTuple):
    """Contact of each of N points with the outline."""

    point: Array
    """``[N, 2]`` nearest point of the outline [m]."""
    normal: Array
    """``[N, 2]`` outward unit vector at the nearest point."""
    distance: Array
    """``[N]`` distance from the outline, negative inside [m]."""


def estimate(touched: np.ndarray, radius: float, refine: int = 3) -> np.ndarray:
    """Corners ``[M, 2]`` of the outline, anticlockwise [m].

    Noise moves the convex hull of the pusher's centres outwards, so each face of the hull is fitted again to the points
    near it. Then all faces are moved inwards by the radius of the pusher, which gives sharp corners.

    Args:
        touched: ``[N, 2]`` centres of the pusher while it touched the object, in the object's frame [m].
        radius: radius of the pusher [m].
        refine: number of times that the faces are fitted.
    """
    # The centre of a round pusher follows an arc with a chord of 1.41 radii around a right angle. It is no face.
    normals, offsets = _faces(_corners(touched), max(1.5 * radius, _SHORTEST))
    for _ in range(refine):
        nearest = np.argmax(touched @ normals.T - offsets, axis=1)
        fitted = [_fit_face(touched[nearest == j], normals[j], offsets[j]) for j in range(len(offsets))]
        normals, offsets = np.stack([n for n, _ in fitted]), np.array([d for _, d in fitted])
    inside = touched[ConvexHull(touched).vertices].mean(axis=0)
    planes = np.concatenate([normals, radius - offsets[:, None]], axis=1)
    corners = HalfspaceIntersection(planes, inside).intersections
    return np.asarray(corners[ConvexHull(corners).vertices])


def align(points: Array, touched: Array) -> np.ndarray:
    """``points [N, 2]`` of another recording of the same shape, moved onto the outline of ``touched [M, 2]`` [m].

    The frames of two recordings differ, because the markers on the object are attached anew for each recording.
    """
    corners = estimate(np.asarray(points), 0.0)

    def gaps(change: Array) -> np.ndarray:
        moved = se2.inverse_transform_point(change[:3], touched)
        return np.asarray((contact(moved, corners).distance - change[3]) / _TOLERANCE)

    scale = (1e-3, 1e-3, 0.02, 1e-3)
    change = least_squares(gaps, np.zeros(4), loss="soft_l1", x_scale=scale).x
    return np.asarray(se2.transform_point(change[:3], points))


def contact(points: Array, corners: Array) -> Touch:
    """Contact of each of ``points [N, 2]`` with the polygon ``corners [M, 2]``, in one frame [m]."""
    edge = np.roll(corners, -1, axis=0) - corners
    edge_x, edge_y = edge.T
    length = np.hypot(edge_x, edge_y)
    # The coordinates are separate, because NumPy is slow at sums over an axis of length two.
    x, y = points[:, :1] - corners[:, 0], points[:, 1:] - corners[:, 1]
    inside = np.max((x * edge_y - y * edge_x) / length, axis=1) < 0.0
    along = np.clip((x * edge_x + y * edge_y) / length**2, 0.0, 1.0)
    away_x, away_y = x - along * edge_x, y - along * edge_y
    squared = away_x**2 + away_y**2
    row, face = np.arange(len(points)), np.argmin(squared, axis=1)
    away = np.stack([away_x[row, face], away_y[row, face]], axis=1)
    distance = np.sqrt(squared[row, face])
    outward = np.stack([edge_y, -edge_x], axis=1)[face] / length[face, None]
    # Points on or inside the outline get the normal of the face.
    own = (inside | (distance < 1e-6))[:, None]
    normal = np.where(own, outward, away / np.maximum(distance, 1e-12)[:, None])
    return Touch(points - away, normal, np.where(inside, -distance, distance))


def size(corners: Array) -> float:
    """Radius of the disc with the same area as the polygon ``corners [M, 2]`` [m]."""
    x, y = corners.T
    return float(np.sqrt(0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / np.pi))


def _corners(points: Array) -> np.ndarray:
    """Corners of the convex hull, without those that protrude by less than `_TOLERANCE`."""
    corners = points[ConvexHull(points).vertices]
    while len(corners) > 3:
        before, after = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0)
        base = after - before
        height = np.abs(se2.cross(base, corners - before)) / np.linalg.norm(base, axis=1)
        flattest = int(np.argmin(height))
        if height[flattest] > _TOLERANCE:
            break
        corners = np.delete(corners, flattest, axis=0)
    return np.asarray(corners)


def _faces(corners: Array, shortest: float) -> tuple[np.ndarray, np.ndarray]:
    """Outward normals ``[F, 2]`` and offsets ``[F]`` [m] of the faces longer than ``shortest`` [m]."""
    edge = np.roll(corners, -1, axis=0) - corners
    length = np.linalg.norm(edge, axis=1)
    normals = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / length[:, None]
    long = length > shortest
    return normals[long], np.sum(normals * corners, axis=1)[long]


def _fit_face(points: np.ndarray, normal: np.ndarray, offset: float) -> tuple[np.ndarray, float]:
    """Normal and offset of the face, fitted to the points nearest to it."""
    if len(points) < 3:
        return normal, offset
    tangent = np.array([-normal[1], normal[0]])
    spread = points - points.mean(axis=0)
    # The prior for the slope is zero, with the weight of three points at 1 cm, because few points close together do not
    # determine the direction.
    slope = (spread @ normal) @ (spread @ tangent) / (np.sum((spread @ tangent) ** 2) + 3 * 0.01**2)
    turned = normal - slope * tangent
    turned /= np.linalg.norm(turned)
    return turned, float(np.median(points @ turned))
