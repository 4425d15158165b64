"""Expected time of each option for an object in the path, from the object's estimated dynamics.

Pushes are rolled out over posterior samples (`planning.reach`). An outcome is the time until the object has left the
robot's path, which may be never. A failed push costs its own time and that of the best remaining option.
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
from shmoo_mjx.behavior.routes import PACE, PATH_MARGIN, Route, Routes
from shmoo_mjx.behavior.state import Option
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
"""Time from the end of the walk to contact [s]: to stop, to extend the arms and to reach the face."""
AWAY = 3.5
"""Time to back away, to fold the arms and to start driving again [s]."""
LEAST = _SETUP + AWAY
"""Minimum time of any push [s]."""
GIVES_UP = 6.0
"""Time until a push without effect ends [s]."""
BLOCKED = 300.0
"""Cost of giving up [s]: a person has to help."""
_TRUST = 0.25
"""Factor on a side's success probability for each failed push there. After a failure the model is probably wrong."""
_ERRS = 0.05
"""Assumed share of roll-outs with a wrong prediction."""
_BEARINGS = (-0.5, -0.25, 0.0, 0.25, 0.5)
"""Directions of push goals on a side, to the left of its normal [rad]. Corners are pushed straight ahead."""
_EVERY = 5
"""Stride over the time steps of a roll-out."""
_TOUCHING = 0.01
"""Clearance at which the reduced footprint counts as touching a wall [m]."""
_STEERED = 0.08
"""How far object and robot may enter walls in a roll-out [m]. Roll-outs ignore walls, but the pushing controller steers
away from them."""
_GRAIN = np.array([0.1, 0.1, 0.3])
"""Resolution at which poses count as equal [m, m, rad]; also the cell size."""
_WINDOW = 5.0
"""Half size of the window around the object in which the path is checked [m], larger than a push."""
_BESIDE = 1.0
"""How far beside its path the robot may pass the object [m]. Anything farther is a detour."""
_ENDS = 9
"""Number of cells nearest to an end of the path, at least one of which must be free."""


@dataclass(eq=False)
class Push:
    """A push on one face in one direction."""

    side: int
    """Index of the face: `faces_of`, then `corners_of`."""
    goal: Float[np.ndarray, "3"]
    """Target pose of the object in {W}, slightly beyond where it has left the path; the median of the samples."""
    free: Float[np.ndarray, "S"]
    """Time until the path is free in each sample [s]; infinite if never."""
    ends: Float[np.ndarray, "S T 2"]
    """Predicted positions of the object."""
    probability: float = 0.0
    """Probability that the push frees the path."""
    works: float = np.inf
    """Expected time to the robot's goal if the push succeeds [s]."""
    seconds: float = np.inf
    """Expected time to the robot's goal, failures and their consequences included [s]."""


class _PushOptions(NamedTuple):
    """The candidate pushes and the side of each."""

    side: np.ndarray
    options: Options


def make_options(
    pose: Float[np.ndarray, "3"], half_extents: tuple[float, float], places: Float[np.ndarray, "8 3"]
) -> _PushOptions:
    """Candidate pushes: on every side in several directions, on every corner straight ahead, and on each to its place.

    The number of options is constant, so that the roll-out compiles once.
    """
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
    """Predicts the outcomes of pushes on ``sides``, in several directions each.

    Args:
        foresight: predictor of the pushing controller (`planning.reach.Foresight`).
        target: the object.
        path: path of the robot without the object.
        clearance: distance to obstacles without the object.
        sides: indices of the sides that may be pushed.
        places: target poses of the object in {W} for some of the sides.
        seed: seed of the posterior samples.
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
    """The best push on each side, the fastest first, with its probability and expected times.

    A failed push costs the best remaining option: a push on another side, evaluated on the samples in which this push
    fails, or the time without a push.

    Args:
        pushes: the predicted pushes.
        walks: time until the hands touch each side [s].
        failed: sides of this object's failed pushes.
        rest: time of the path past the object to the goal [s].
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


def path_clear(routes: Routes, position: Float[Array, "2"], index: int) -> bool:
    """Whether the robot, now at ``position``, can pass object ``index`` at its current pose.

    The criterion is that of the roll-outs. If it were stricter, a push would go on with goals that are always just
    ahead.
    """
    through = routes.quickest(position, without=index)
    detour = routes.quickest(position, {index: PATH_MARGIN})
    # The planner, which keeps more from walls than the cells of `_passes`, must find a way past the object too. Going
    # aside and back again makes a path longer by at most twice _BESIDE.
    if through is None or detour is None or detour.seconds > through.seconds + 2.0 * _BESIDE / PACE:
        return False
    target, clearance = routes.belief.objects[index], routes.belief.clearance(without=index)
    pose = target.pose[None]
    return bool(_passes(pose, target.pose, target.half_extents, path=through.path, clearance=clearance)[0])


def time_without_push(through: Route, detour: Route | None) -> float:
    """Time to the goal without a push [s]: by ``detour``, or by giving up if there is none."""
    return through.seconds + BLOCKED if detour is None else detour.seconds


def describe_options(options: Sequence[Push], detour: float | None) -> str:
    """Text that describes the pushes and the detour, which takes ``detour`` [s] if there is one."""
    # Without a detour the mean mixes success with giving up, which is not informative.
    mean = [f", {push.seconds:.0f} s on average" if detour is not None else "" for push in options]
    pushes = [
        f"push from {SIDES[push.side]} {push.works:.0f} s ({push.probability:.0%}{average})"
        for push, average in zip(options, mean, strict=True)
    ]
    return "; ".join([*pushes, "no way round" if detour is None else f"go round {detour:.0f} s"])


def option_list(options: Sequence[Push], detour: float | None) -> tuple[Option, ...]:
    """The pushes, and the detour that takes ``detour`` [s] if there is one, as the options of a decision."""
    pushes = [Option(f"push from {SIDES[push.side]}", push.works, push.seconds, push.probability) for push in options]
    return (*pushes, *([] if detour is None else [Option("go round", detour, detour, 1.0)]))


def walk_time(length: float) -> float:
    """Time of a path of this length to a face, until contact [s]."""
    return length / PACE + _SETUP


def _goal(free: Float[Array, "S"], poses: Float[Array, "S T 3"]) -> Float[np.ndarray, "3"]:
    """Median over the samples of the object's pose one second after the path is free.

    The goal lies beyond that point, because a push slows down near its goal.
    """
    good = np.flatnonzero(np.isfinite(free))
    at = np.minimum(np.round(free[good] / (DT * _EVERY)).astype(int) + 1, poses.shape[1] - 1)
    there = poses[good, at]
    turned = there[0, 2] + np.median(se2.wrap(there[:, 2] - there[0, 2]))
    return np.array([*np.median(there[:, :2], axis=0), turned])


def _times(
    outcomes: Outcomes, target: ObjectBelief, path: Path, clearance: DistanceField
) -> tuple[Float[np.ndarray, "O S"], Float[np.ndarray, "O S T 3"], Float[np.ndarray, "O S T 2"]]:
    """Time until the robot can pass the object [s], infinite if never or if something hits a wall before.

    Returns:
        These times, the evaluated poses, and the predicted positions, which stay constant after a wall is hit.
    """
    # A roll-out that diverges is placed off the map, which counts as wall.
    poses, robots = (np.nan_to_num(np.asarray(a, float)[:, :, _EVERY - 1 :: _EVERY], nan=1e6) for a in outcomes)
    a, b = (max(half - _STEERED, 0.0) for half in target.half_extents)
    rim = np.array([(x * a, y * b) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y])
    hits = (clearance.at(se2.transform_point(poses[..., None, :], rim)) < _TOUCHING).any(axis=-1)
    hits |= clearance.at(robots[..., :2]) < shmoobot().radius - _STEERED
    possible = ~np.logical_or.accumulate(hits, axis=2)
    # Nearly equal poses are evaluated once.
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
    """Whether the robot can pass the object, now at ``pose``, at each of ``poses``.

    It can if free cells connect both ends of its path near the object.
    """
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
    """Whether free cells connect both ends, given each cell's distance from them."""
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
    """Cells that the robot can't occupy, on a square around an object at the centre of the middle cell."""
    reach = int((np.hypot(*half_extents) + ROBOT_RADIUS + PATH_MARGIN) / _GRAIN[0]) + 1
    ticks = _GRAIN[0] * np.arange(-reach, reach + 1)
    cells = np.stack(np.meshgrid(ticks, ticks, indexing="ij"), axis=-1)
    return _near(np.array([0.0, 0.0, yaw]), half_extents, cells)


def _near(
    pose: Float[np.ndarray, "*p 3"], half_extents: tuple[float, float], points: Float[np.ndarray, "*q 2"]
) -> Bool[np.ndarray, "*r"]:
    """Whether an object at ``pose`` leaves the robot no room at a point."""
    local = np.abs(se2.inverse_transform_point(pose, points))
    return np.asarray(np.linalg.norm(np.maximum(local - half_extents, 0.0), axis=-1) < ROBOT_RADIUS + PATH_MARGIN)


def _dense(points: Float[np.ndarray, "N 2"], spacing: float = 0.1) -> Float[np.ndarray, "M 2"]:
    """Points along a polyline with a spacing of slightly more than ``spacing``."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, lengths[-1], max(2, int(lengths[-1] / spacing)))
    return np.stack([np.interp(at, lengths, points[:, k]) for k in range(2)], axis=-1)
