"""Choice of the face to push and of an intermediate goal: arcs that bring an object to a pose, over two pushes.

A push moves an object along the inward normal of its face, and steering bends that way into an arc. No dynamics is
needed for the choice: what coasts or drags is the controller's business, and the choice is made anew after each push.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.geometry import se2
from shmoo_mjx.planning.clearance import ClearanceField
from shmoo_mjx.planning.footprints import footprints_free

_CURVATURE = 0.45
"""Largest curvature of a push [1/m]: 26 deg over a metre, what steering gives light and heavy objects alike."""
_LONGEST = 2.6
"""Longest push that is looked ahead [m]."""
YAW_WEIGHT = 0.25
"""Metres that a yaw error of 1 rad counts for [m/rad]: about half the side of an object."""
_WALK = 0.01
"""Metres of error that a metre of walking to the face counts for [1]: decides only between faces that are as good."""
_SECOND = 0.6
"""Metres of error that a second push counts for [m]: the first one errs too, and then there is farther to go."""
_WALL_CLEARANCE = 0.06
"""Distance from walls that the footprint keeps at the end of a push [m]: what the pushing controller keeps, too."""


class Choice(NamedTuple):
    """A push to make next."""

    side: int
    """Index of the face."""
    goal: Float[np.ndarray, "3"]
    """Where this push is to bring the object, in {W}."""
    expected: float
    """Error left after this push, or after a second one, with what the pushes cost [m]."""


def residual(
    pose: Float[Array, "*b 3"], goal: Float[Array, "3"], yaw_weight: float
) -> Scalar | Float[np.ndarray, "*b"]:
    """Error [m] of ``pose`` against ``goal``, the yaw on the circle."""
    offset = np.asarray(pose)[..., :2] - np.asarray(goal)[:2]
    yaw = se2.wrap(np.asarray(pose)[..., 2] - np.asarray(goal)[2])
    return np.hypot(offset[..., 0], offset[..., 1]) + yaw_weight * np.abs(yaw)


def arc_ends(
    pose: Float[Array, "*b 3"], face: Float[Array, "4"], lengths: Float[Array, "L"], curvatures: Float[Array, "K"]
) -> Float[np.ndarray, "*b L K 3"]:
    """Object poses in {W} after pushes of these lengths [m] and curvatures [1/m].

    Args:
        pose: where the object stands.
        face: as faces.faces_of gives it.
        lengths: along the arc.
        curvatures: positive turns left.
    """
    s, k = np.meshgrid(lengths, curvatures, indexing="ij")
    turn = s * k
    # sinc keeps the straight push among the arcs without a special case.
    chord = s * np.sinc(turn / (2 * np.pi))
    step = np.stack([chord * np.cos(turn / 2), chord * np.sin(turn / 2)], axis=-1)
    moved = se2.rotate(step, np.full(s.shape, face[2]))
    local = np.concatenate([moved, turn[..., None]], axis=-1)
    return se2.compose(np.asarray(pose, dtype=float)[..., None, None, :], local)


def choose(
    pose: Float[np.ndarray, "3"],
    goal: Float[np.ndarray, "3"],
    faces: Float[np.ndarray, "F 4"],
    ways: Sequence[float | None],
    field: ClearanceField,
    half_extents: tuple[float, float],
) -> Choice | None:
    """The push that, alone or followed by another one, leaves the least error; None if no face can be reached.

    Args:
        pose: of the object in {W}.
        goal: where it is to be.
        faces: as faces.faces_of gives them.
        ways: length of the way to each face [m], None where it can't be reached or must not be pushed.
        field: clearance without the object itself.
        half_extents: of the footprint [m].
    """
    found: list[Choice] = []
    usable = [i for i, way in enumerate(ways) if way is not None]
    for i in usable:
        walk = _WALK * float(ways[i] or 0.0)
        error, end = _best_single(pose, goal, faces[i])
        # The goal itself is what the controller is given: it may do better than any arc.
        if end is not None:
            found.append(Choice(i, np.asarray(goal, dtype=float), float(error) + walk))
        found += _through(pose, goal, faces, usable, i, field, half_extents, walk)
    return min(found, key=lambda c: c.expected) if found else None


def _best_single(
    pose: Float[Array, "*b 3"], goal: Float[np.ndarray, "3"], face: Float[np.ndarray, "4"]
) -> tuple[Scalar | Float[np.ndarray, "*b"], Float[np.ndarray, "3"] | None]:
    """Least error after one push from ``pose`` and where the first of them ends."""
    curvatures = np.linspace(-_CURVATURE, _CURVATURE, 13)
    ends = arc_ends(pose, face, np.linspace(0.03, _LONGEST, 60), curvatures)
    errors = residual(ends, goal, YAW_WEIGHT).reshape(*ends.shape[:-3], -1)
    best = np.argmin(errors, axis=-1)
    if errors.ndim > 1:
        return np.min(errors, axis=-1), None
    return np.min(errors, axis=-1), ends.reshape(-1, 3)[best]


def _through(
    pose: Float[np.ndarray, "3"],
    goal: Float[np.ndarray, "3"],
    faces: Float[np.ndarray, "F 4"],
    usable: Sequence[int],
    first: int,
    field: ClearanceField,
    half_extents: tuple[float, float],
    walk: float,
) -> list[Choice]:
    """Pushes on face ``first`` to places from which a push on another face leads to the goal."""
    curvatures = np.linspace(-_CURVATURE, _CURVATURE, 5)
    stops = arc_ends(pose, faces[first], np.linspace(0.2, 1.4, 7), curvatures).reshape(-1, 3)
    stops = stops[footprints_free(field, stops, np.array(half_extents), wall_clearance=_WALL_CLEARANCE)]
    if not len(stops):
        return []
    found = []
    for second in usable:
        if second != first:
            errors, _ = _best_single(stops, goal, faces[second])
            best = int(np.argmin(errors))
            found.append(Choice(first, stops[best], float(errors[best]) + _SECOND + walk))
    return found
