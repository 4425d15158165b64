"""Which option about an object in the way takes the least time, by what is known of the object's dynamics.

Pushes are rolled out over samples of the posterior (`planning.reach`); an outcome is the time until the object has left
the robot's path, with a probability of never. A push that fails costs its time and the best of what is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.ndimage
import shapely

from shmoo_mjx.arrays import Array, Bool, Float
from shmoo_mjx.behavior.belief import ObjectBelief, all_faces
from shmoo_mjx.behavior.routes import PACE, Route
from shmoo_mjx.geometry import se2
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.paths import Path
from shmoo_mjx.planning.reach import STEPS, Options, Outcomes, goal_ahead
from shmoo_mjx.planning.scenario import ROBOT_RADIUS
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.types import DT

SIDES = (
    "behind", "the right", "the front", "the left", "behind on the right", "the front on the right",
    "the front on the left", "behind on the left",
)  # fmt: skip
"""Names of sides and corners."""
_SETUP = 3.2
"""Time from the end of the walk to contact: to stop, to extend the arms, to reach the face [s]."""
AWAY = 3.5
"""Time of backing away, of folding the arms, and of setting out again [s]."""
LEAST = _SETUP + AWAY
"""What every push takes at least [s]."""
GIVES_UP = 6.0
"""Time of a push that leads nowhere until this is seen [s]."""
BLOCKED = 300.0
"""What it counts for to give up [s]: somebody has to come."""
_TRUST = 0.25
"""What a push that failed leaves of the probability of another one on that side: something is not as it is modelled."""
_ERRS = 0.05
"""Share of roll-outs in which it comes otherwise."""
_BEARINGS = (-0.5, -0.25, 0.0, 0.25, 0.5)
"""Directions of the goals of pushes on a side, to the left of its normal [rad]; corners are pushed straight on."""
_EVERY = 5
"""Every so many samples of a roll-out are looked at."""
_TOUCHING = 0.01
"""Distance from walls at which what is left of the footprint has met them [m]."""
_STEERED = 0.08
"""How far the object and the robot may go into walls in a roll-out [m]: they do not know of walls, from which the
pushing controller steers away."""
_GRAIN = np.array([0.1, 0.1, 0.3])
"""Poses that are so near to each other are taken for one [m, m, rad]; also the size of cells."""
_WINDOW = 5.0
"""How far along each axis from the object its path is looked at [m]: farther than a push goes."""
_BESIDE = 1.0
"""How far beside its path the robot may pass it [m]: what is farther is a way round."""
_ENDS = 9
"""Cells nearest to an end of the path, of which one has to be free."""
_PATH_MARGIN = 0.05
"""What must be free beside the robot's radius between its path and the object [m]."""


@dataclass(eq=False)
class Push:
    """A push on one face in one direction."""

    side: int
    """Index among `faces_of` and, after them, `corners_of`."""
    goal: Float[np.ndarray, "3"]
    """Pose in {W} of the object a little after it has left the path, in the middle of the samples."""
    free: Float[np.ndarray, "S"]
    """Time until the path is free in each sample [s]; infinite where it never is."""
    ends: Float[np.ndarray, "S T 2"]
    """Predicted positions of the object."""
    probability: float = 0.0
    """That the path will be free."""
    works: float = np.inf
    """Expected time to the robot's goal if it succeeds [s]."""
    seconds: float = np.inf
    """Expected time to the robot's goal [s], failures and what follows them included."""


class _PushOptions(NamedTuple):
    """What each of the options is."""

    side: np.ndarray
    options: Options


def make_options(
    pose: Float[np.ndarray, "3"], half_extents: tuple[float, float], places: Float[np.ndarray, "8 3"]
) -> _PushOptions:
    """Pushes on every side in several directions, on every corner straight on, and on each to a place of its own;
    always as many."""
    which = [*((i, b) for i in range(4) for b in _BEARINGS), *((i, 0.0) for i in range(4, 8))]
    about = all_faces(half_extents)
    faces = np.stack([*(about[i] for i, _ in which), *about])
    goals = np.stack([*(goal_ahead(pose, about[i], bearing) for i, bearing in which), *places])
    side = np.array([*(i for i, _ in which), *range(8)])
    return _PushOptions(side, Options(faces.astype(np.float32), goals.astype(np.float32)))


def predict_pushes(
    foresight: Callable[..., Outcomes],
    target: ObjectBelief,
    path: Path,
    *,
    clearance: DistanceField,
    sides: Sequence[int],
    places: Mapping[int, Float[np.ndarray, "3"]],
    seed: int = 0,
) -> list[Push]:
    """What pushes on ``sides`` lead to, in several directions each.

    Args:
        foresight: of the pushing controller (`planning.reach.Foresight`).
        known: the object.
        path: of the robot, as if the object were not there.
        around: clearance without the object.
        sides: that may be pushed.
        places: where the object may be put from some of them, in {W}.
        seed: of the draws.
    """
    where = np.stack([places.get(side, target.pose) for side in range(8)])
    of = make_options(target.pose, target.half_extents, where)
    outcomes: Outcomes = foresight(
        target.adapt, target.kind, target.pose, target.half_extents, options=of.options, seed=seed
    )
    free, poses, ends = _times(outcomes, target, path, clearance)
    pushes = []
    for k in np.flatnonzero(np.isin(of.side, list(sides))):
        goal = _goal(free[k], poses[k]) if np.isfinite(free[k]).any() else np.asarray(of.options.goal[k], float)
        pushes.append(Push(int(of.side[k]), goal, free[k], ends[k]))
    return pushes


def rank_pushes(
    pushes: Sequence[Push], *, walks: Mapping[int, float], failed: Sequence[int], rest: float, otherwise: float
) -> list[Push]:
    """The best push on each side, the quickest first, with probability and expected seconds to the goal.

    What a push costs that fails is the best of what is left: another side, for those samples in which this one fails,
    or what can be done without a push.

    Args:
        found: what can be done.
        walks: time until the hands touch each side [s].
        failed: sides of pushes of this object that failed before.
        rest: time of the way past it to the goal [s].
        otherwise: time to the goal without a push [s].
    """
    side = np.array([push.side for push in pushes])
    free = np.stack([push.free for push in pushes])
    trust = np.array([_TRUST ** list(failed).count(i) for i in side])[:, None]
    p = trust * np.where(np.isfinite(free), 1.0 - _ERRS, _ERRS)
    before = np.array([walks[i] for i in side])[:, None] + AWAY
    there = np.where(np.isfinite(free), free, DT * STEPS) + rest
    succeeds = p * there
    works = (p * (before + there)).sum(axis=1) / p.sum(axis=1)
    alone = before + succeeds + (1.0 - p) * (GIVES_UP + otherwise)
    next_best = (1.0 - p) @ alone.T / (1.0 - p).sum(axis=1, keepdims=True)
    next_best[side[:, None] == side] = np.inf
    after = np.minimum(next_best.min(axis=1, initial=np.inf), otherwise)[:, None]
    seconds = (before + succeeds + (1.0 - p) * (GIVES_UP + after)).mean(axis=1)
    for push, *numbers in zip(pushes, p.mean(axis=1), works, seconds, strict=True):
        push.probability, push.works, push.seconds = map(float, numbers)
    best = {push.side: push for push in sorted(pushes, key=lambda push: -push.seconds)}
    return sorted(best.values(), key=lambda push: push.seconds)


def time_without_push(through: Route, detour: Route | None) -> float:
    """Time to the goal without a push, by the way ``detour`` or, without one, by giving up [s]."""
    return through.seconds + BLOCKED if detour is None else detour.seconds


def describe_options(options: Sequence[Push], detour: float | None) -> str:
    """Pushes and going round, which takes ``detour`` [s] if there is a way round, in words."""
    # Without a way round the mean is that of succeeding and of giving up, which says nothing to a reader.
    mean = [f", {push.seconds:.0f} s on average" if detour is not None else "" for push in options]
    pushes = [
        f"push from {SIDES[push.side]} {push.works:.0f} s ({push.probability:.0%}{average})"
        for push, average in zip(options, mean, strict=True)
    ]
    return "; ".join([*pushes, "no way round" if detour is None else f"go round {detour:.0f} s"])


def walk_time(length: float) -> float:
    """Time of a walk to contact [s]."""
    return length / PACE + _SETUP


def _goal(free: Float[Array, "S"], poses: Float[Array, "S T 3"]) -> Float[np.ndarray, "3"]:
    """The pose in the middle of those that samples have a second after the way is free: a goal at which a push would
    slow down is farther."""
    good = np.flatnonzero(np.isfinite(free))
    at = np.minimum(np.round(free[good] / (DT * _EVERY)).astype(int) + 1, poses.shape[1] - 1)
    there = poses[good, at]
    turned = there[0, 2] + np.median(se2.wrap(there[:, 2] - there[0, 2]))
    return np.array([*np.median(there[:, :2], axis=0), turned])


def _times(
    outcomes: Outcomes, target: ObjectBelief, path: Path, clearance: DistanceField
) -> tuple[Float[np.ndarray, "O S"], Float[np.ndarray, "O S T 3"], Float[np.ndarray, "O S T 2"]]:
    """Time at which the robot can pass the object [s], infinite where it never can or something meets a wall before;
    the poses that were looked at, and positions that stay where that happens."""
    # A roll-out that diverges is off the map, where all is wall.
    poses, robots = (np.nan_to_num(np.asarray(a, float)[:, :, _EVERY - 1 :: _EVERY], nan=1e6) for a in outcomes)
    a, b = (max(half - _STEERED, 0.0) for half in target.half_extents)
    rim = np.array([(x * a, y * b) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y])
    hits = (clearance.at(se2.transform_point(poses[..., None, :], rim)) < _TOUCHING).any(axis=-1)
    hits |= clearance.at(robots[..., :2]) < shmoobot().radius - _STEERED
    possible = ~np.logical_or.accumulate(hits, axis=2)
    # Poses that are nearly the same are looked at once.
    coarse = np.round(poses[possible] / _GRAIN).astype(int)
    unique, which = np.unique(coarse, axis=0, return_inverse=True)
    clear = np.zeros(possible.shape, bool)
    clear[possible] = _passes(unique * _GRAIN, target.pose, target.half_extents, path=path, clearance=clearance)[
        which.reshape(-1)
    ]
    times = DT * _EVERY * (1 + np.argmax(clear, axis=2))
    last = np.maximum(possible.sum(axis=2) - 1, 0)[..., None]
    ends = np.take_along_axis(poses, np.minimum(np.arange(poses.shape[2]), last)[..., None], axis=2)[..., :2]
    return np.where(clear.any(axis=2), times, np.inf), poses, ends


def _passes(
    poses: Float[np.ndarray, "N 3"],
    pose: Float[np.ndarray, "3"],
    half_extents: tuple[float, float],
    *,
    path: Path,
    clearance: DistanceField,
) -> Bool[np.ndarray, "N"]:
    """Whether the robot can pass the object, now at ``pose``, at each of ``poses``: free cells join both ends of its
    path near by."""
    if not len(poses):
        return np.zeros(0, bool)
    whole = _dense(path.points)
    middle = whole[np.argmin(np.linalg.norm(whole - pose[:2], axis=1))]
    inside = np.abs(whole - middle).max(axis=1) < _WINDOW
    near, beyond = whole[inside], whole[~inside]
    ticks = [np.arange(side.min() - _BESIDE, side.max() + _BESIDE, _GRAIN[0]) for side in near.T]
    cells = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1)
    beside = shapely.distance(shapely.LineString(path.points), shapely.points(cells)) < _BESIDE
    walls_off = (clearance.at(cells) >= ROBOT_RADIUS) & beside
    free = np.repeat(walls_off[None], len(poses), axis=0)
    size = np.array(walls_off.shape)
    at = np.clip(np.round((poses[:, :2] - cells[0, 0]) / _GRAIN[:2]).astype(int), -size, 2 * size)
    turns = np.round(poses[:, 2] / _GRAIN[2]).astype(int)
    for turn in np.unique(turns):
        taken = _taken(turn * _GRAIN[2], half_extents)
        mine = turns == turn
        for n, corner in zip(np.flatnonzero(mine), at[mine] - len(taken) // 2, strict=True):
            low, high = np.maximum(corner, 0), np.maximum(corner + len(taken), 0)
            part = free[n, low[0] : high[0], low[1] : high[1]]
            begin = low - corner
            part &= ~taken[begin[0] :, begin[1] :][: part.shape[0], : part.shape[1]]
    on_path = tuple(np.round((near - cells[0, 0]) / _GRAIN[:2]).astype(int).T)
    passes = (free[:, *on_path] == walls_off[on_path]).all(axis=1)
    passes[~passes] = _joined(free[~passes], [np.linalg.norm(cells - end, axis=-1) for end in (near[0], near[-1])])
    far = np.flatnonzero(np.abs(poses[:, :2] - middle).max(axis=1) > _WINDOW - np.hypot(*half_extents) - ROBOT_RADIUS)
    passes[far] &= ~_near(poses[far, None], half_extents, beyond).any(axis=1)
    return passes


def _joined(free: Bool[np.ndarray, "N h w"], from_end: Sequence[Float[np.ndarray, "h w"]]) -> Bool[np.ndarray, "N"]:
    """Whether free cells join both ends, given each cell's distance from them."""
    same = np.zeros((3, 3, 3), bool)
    same[1] = True
    labels, _ = scipy.ndimage.label(free, same)
    ends = []
    for distance in from_end:
        near_end = labels.reshape(len(free), math.prod(free.shape[1:]))[:, np.argsort(distance, axis=None)[:_ENDS]]
        ends.append(
            np.where(near_end.any(axis=1), near_end[np.arange(len(near_end)), np.argmax(near_end > 0, axis=1)], 0)
        )
    return np.asarray((ends[0] == ends[1]) & (ends[0] > 0))


def _taken(yaw: float, half_extents: tuple[float, float]) -> Bool[np.ndarray, "c c"]:
    """Cells that the robot can't stand in, on a square about an object at the centre of the middle cell."""
    reach = int((np.hypot(*half_extents) + ROBOT_RADIUS + _PATH_MARGIN) / _GRAIN[0]) + 1
    ticks = _GRAIN[0] * np.arange(-reach, reach + 1)
    cells = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1)
    return _near(np.array([0.0, 0.0, yaw]), half_extents, cells)


def _near(
    pose: Float[np.ndarray, "*p 3"], half_extents: tuple[float, float], points: Float[np.ndarray, "*q 2"]
) -> Bool[np.ndarray, "*r"]:
    """Whether an object at ``pose`` leaves the robot no room at a point."""
    local = np.abs(se2.inverse_transform_point(pose, points))
    return np.asarray(np.linalg.norm(np.maximum(local - half_extents, 0.0), axis=-1) < ROBOT_RADIUS + _PATH_MARGIN)


def _dense(points: Float[np.ndarray, "N 2"], spacing: float = 0.1) -> Float[np.ndarray, "M 2"]:
    """Points along a polyline, little more than ``spacing`` apart."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, lengths[-1], max(2, int(lengths[-1] / spacing)))
    return np.stack([np.interp(at, lengths, points[:, k]) for k in range(2)], axis=-1)
