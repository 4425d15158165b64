"""Searches for sequences of pushes that bring an object to a pose.

Single pushes on each side are rolled out once, in several directions, with the median of the estimated dynamics. A push
may end anywhere along its way. The dynamics do not depend on the object's pose, so a sequence is a composition of these
displacements.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float, Int
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.learning.online import LearnerState
from shmoo_mjx.planning.reach import Options, goal_ahead

YAW_WEIGHT = 0.25
"""Position error that a yaw error of 1 rad equals [m/rad]: about half the side of an object."""
ERROR = 0.05
"""Expected error of a first push [m], and of each metre that it moves the object [1]."""
_WEIGHT = 3
"""Number of pushes that `ERROR` counts as, beside the pushes so far. Larger values give more pushes to an object that
moves otherwise than predicted."""
_WALK = 0.01
"""Cost of walking to the face [1]. It only decides between faces that are otherwise equal."""
_ARCS = ((0.25, 2.5), (0.55, 2.5), (0.6, 1.4))
_DIRECTIONS = ((0.0, 4.0), *((sign * bearing, far) for bearing, far in _ARCS for sign in (1, -1)))
"""Bearing [rad] and distance [m] of push goals on a side: straight ahead, and along gentle and sharp arcs."""
_TURNS = (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3)
"""Yaw offsets of the goal for pushes towards it [rad]. They compensate for the object turning less than steered."""
_STEP, _LONGEST = 0.02, 3.2
"""Spacing of the possible end points along a push, and the maximum length of a push [m]."""
_FIRST, _SECOND = 12, 4
"""Stride over these end points for a first and for a second push."""
_SHORTEST = 0.1
"""Minimum length of a push along its face's normal [m]. A push to a nearer goal, or to a goal beside the face, would
end at once."""


class PushDisplacements(NamedTuple):
    """Displacements of an object by N single pushes."""

    side: Int[np.ndarray, "N"]
    """Index of the face in `faces_of`."""
    moved: Float[np.ndarray, "N 3"]
    """Pose of the object after the push, in {O} before the push."""
    way: Float[np.ndarray, "N"]
    """Length of the object's way [m]. Turns count with `YAW_WEIGHT`."""
    aimed: Bool[np.ndarray, "N"]
    """Whether the push steers towards the goal. False if it goes in a direction relative to the object."""


class Choice(NamedTuple):
    """The next push."""

    side: int
    """Index of the face."""
    goal: Float[np.ndarray, "3"]
    """Target pose of the object for this push, in {W}."""
    cost: float
    """Predicted residual after the last push, plus the expected errors of the pushes [m]."""


def residual(pose: Float[Array, "*b 3"], goal: Float[Array, "3"]) -> Float[np.ndarray, "*b"]:
    """Error [m] of ``pose`` relative to ``goal``. The wrapped yaw error counts with `YAW_WEIGHT`."""
    offset = np.asarray(pose)[..., :2] - np.asarray(goal)[:2]
    yaw = se2.wrap(np.asarray(pose)[..., 2] - np.asarray(goal)[2])
    return np.asarray(np.hypot(offset[..., 0], offset[..., 1]) + YAW_WEIGHT * np.abs(yaw))


def push_error(errors: Sequence[float]) -> float:
    """Expected error of the next push in the units of `ERROR`: the weighted mean of it and the ``errors`` so far."""
    return float(np.mean([ERROR] * _WEIGHT + list(errors)))


def push_displacements(
    foresight: Any,
    *,
    adapt: LearnerState | None,
    kind: str | None,
    half_extents: tuple[float, float],
    goal: Float[Array, "3"],
) -> PushDisplacements:
    """Predicted displacements of single pushes on each side: in several directions, and towards a goal.

    Args:
        foresight: provides ``median_poses`` like `Foresight` (`planning.reach.contact_foresight`).
        adapt: learner state of the object; None before the first contact.
        kind: the object's recognised kind, or None.
        half_extents: half sizes of its footprint [m].
        goal: target pose in {O}.
    """
    faces = faces_of(half_extents)
    towards = goal + np.array([(0.0, 0.0, turn) for turn in _TURNS])
    goals = [[*(goal_ahead(np.zeros(3), face, *direction) for direction in _DIRECTIONS), *towards] for face in faces]
    side = np.repeat(np.arange(len(faces)), len(goals[0]))
    options = Options(faces[side].astype(np.float32), np.concatenate(goals).astype(np.float32))
    poses = foresight.median_poses(adapt, kind, half_extents, options)
    steps = np.diff(poses, axis=1, prepend=0.0)
    way = np.cumsum(np.hypot(steps[..., 0], steps[..., 1]) + YAW_WEIGHT * np.abs(steps[..., 2]), axis=1)
    lengths = np.arange(_STEP, _LONGEST, _STEP)
    there = way[:, None] >= lengths[:, None]
    option, length = np.nonzero(there.any(axis=2))
    ends = poses[option, np.argmax(there, axis=2)[option, length]]
    aimed = np.tile(np.arange(len(goals[0])) >= len(_DIRECTIONS), len(faces))
    return PushDisplacements(side[option], ends, lengths[length], aimed[option])


def choose_push(
    reached: PushDisplacements,
    pose: Float[np.ndarray, "3"],
    goal: Float[np.ndarray, "3"],
    *,
    faces: Float[np.ndarray, "F 4"],
    ways: Sequence[float | None],
    free: Callable[[Float[np.ndarray, "N 3"]], Bool[np.ndarray, "N"]],
    error: float = ERROR,
) -> Choice | None:
    """The first push of the sequence of zero, one or two pushes with the least cost. None if zero pushes are best.

    The last push costs its expected error. The one before costs less, because the next choice corrects its error.

    Args:
        reached: predicted displacements (`push_displacements`).
        pose: pose of the object in {W}.
        goal: target pose in {W}.
        faces: faces as `faces_of` returns them.
        ways: length of the way to each face [m]; None if the face is unreachable or must not be pushed.
        free: whether the object may stand at each of these poses in {W} between two pushes.
        error: expected error of a push (`push_error`). Larger values give fewer and shorter pushes.
    """
    walks = _WALK * np.array([np.inf if way is None else way for way in ways])
    reached = PushDisplacements(*(part[np.isfinite(walks)[reached.side]] for part in reached))
    side = reached.side
    normals = np.stack([np.cos(faces[:, 2]), np.sin(faces[:, 2])], axis=-1)[side]
    ends = np.asarray(se2.compose(pose, reached.moved))
    best, least = None, float(residual(pose, goal))
    # Pushes that lead to the goal get the goal itself as their target, because feedback may do better than the
    # roll-out.
    leads = normals @ se2.inverse_transform_point(pose, goal[:2]) >= _SHORTEST
    costs = error * (1.0 + reached.way) + walks[side]
    errors = np.where(leads, residual(ends, goal) + costs, np.inf)
    if len(side) and errors.min() < least:
        k = int(np.argmin(errors))
        best, least = Choice(int(side[k]), np.asarray(goal, dtype=float), float(errors[k])), float(errors[k])
    anywhere = np.flatnonzero(~reached.aimed & (np.einsum("ni,ni->n", normals, reached.moved[:, :2]) >= _SHORTEST))
    first = anywhere[::_FIRST]
    first = first[free(ends[first])]
    if len(first):
        second = PushDisplacements(*(part[anywhere[::_SECOND]] for part in reached))
        errors = _after(ends[first], side[first], second, goal=goal, error=error)
        # The next choice corrects what this push errs. What it costs is time, for which `ERROR` stands too.
        errors += ERROR * (1.0 + reached.way[first]) + walks[side[first]]
        k = int(np.argmin(errors))
        if errors[k] < least:
            best = Choice(int(side[first[k]]), ends[first[k]], float(errors[k]))
    return best


def _after(
    stops: Float[np.ndarray, "M 3"],
    first: Int[np.ndarray, "M"],
    reached: PushDisplacements,
    *,
    goal: Float[np.ndarray, "3"],
    error: float,
) -> Float[np.ndarray, "M"]:
    """Least cost of a second push from each stop on another side than ``first``: residual error plus push cost."""
    left = np.full(len(stops), np.inf)
    for pushed in np.unique(first):
        mine, others = first == pushed, reached.side != pushed
        if others.any():
            ends = se2.compose(stops[mine, None].astype(np.float32), reached.moved[others].astype(np.float32))
            left[mine] = (residual(ends, goal.astype(np.float32)) + error * (1.0 + reached.way[others])).min(axis=1)
    return left
