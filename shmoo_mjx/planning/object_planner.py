"""Object planner, Algorithm 1 (Sec. IV-B): goal of an object that blocks the path, and whether it can be moved.

The functions take plain NumPy arrays and return a decision. The caller provides the collision check, and with it the
map, the path and the object's footprint. The planning stage uses the roll-outs of MPPI with T = 50, S = 500.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float, Int
from shmoo_mjx.geometry import se2

AREA = 2.0
"""Side of the square around the object that contains the first goals [m]. Larger values allow longer pushes."""
_GRID_STEP = 0.1
"""Spacing of those goals [m]."""
CONE = math.radians(35)
"""Half angle of the cone around an accessible face's push direction that contains the first goals [rad]. A wider cone
contains goals that steering hardly reaches."""
BEST = 3
"""Number of lowest-cost roll-outs that K sums over. The paper does not give it."""
CollisionFree = Callable[[Float[np.ndarray, "N 3"]], Bool[np.ndarray, "N"]]
"""(object poses in {W}) -> True where the whole footprint is clear of map and path."""


@dataclass(frozen=True)
class ObjectPlannerConfig:
    """Settings of Algorithm 1. They are the paper's values where the paper gives them."""

    min_displacement: float = 0.6
    """Minimum distance of a first goal from the object [m]. Larger values need more free space. The optimal roll-outs
    end at the goal, so K is at most three times its square: with a goal nearer than 0.32 m every object would look
    immovable."""
    threshold: float = 0.3
    """K below which an object is not manipulable [m^2]. Three roll-outs of 0.32 m each reach it. Larger values classify
    more objects as immovable."""

    def __post_init__(self) -> None:
        if BEST * self.min_displacement**2 <= self.threshold:
            raise ValueError("min_displacement is so small that K could not reach its threshold")


class InitialGoal(NamedTuple):
    """Result of the initialisation stage."""

    goal: Float[np.ndarray, "3"] | None
    """Pose in {W} with the object's yaw; None if no candidate is left."""
    direction: int | None
    """Index of the push direction of the goal; None without directions or goal."""
    candidates: Float[np.ndarray, "M 3"]
    """Collision-free poses (the goal buffer), nearest first."""
    reason: str
    """One phrase that explains the result."""


class ObjectDecision(NamedTuple):
    """Result of the planning stage."""

    manipulable: bool
    """Whether the object can be moved."""
    K: float
    """Sum over the best roll-outs of the squared end displacement [m^2]; NaN if no roll-out is finite."""
    G: float
    """Distance between the object and the mean end position of the best roll-outs [m]: the criterion in the paper's
    text."""
    goal: Float[np.ndarray, "3"] | None
    """Pose in {W}; None if the object is not manipulable or no roll-out ends collision-free."""
    candidates: Float[np.ndarray, "M 3"]
    """Collision-free end poses (the goal buffer), nearest first."""
    reason: str
    """One phrase that explains the decision."""


def goal_grid(object_pose: Float[Array, "3"], area: float = AREA) -> Float[np.ndarray, "N 3"]:
    """Grid of poses over a square with side ``area`` [m] around ``object_pose``, with the object's yaw."""
    pose = np.asarray(object_pose, dtype=float)
    count = math.floor(area / 2 / _GRID_STEP + 1e-9)
    ticks = np.arange(-count, count + 1) * _GRID_STEP
    dx, dy = np.meshgrid(ticks, ticks, indexing="ij")
    return np.stack([pose[0] + dx.ravel(), pose[1] + dy.ravel(), np.full(dx.size, pose[2])], axis=-1)


def initial_goal(
    object_pose: Float[Array, "3"],
    collision_free: CollisionFree,
    push_directions: Float[Array, "F"] | None = None,
    cfg: ObjectPlannerConfig | None = None,
    *,
    area: float = AREA,
) -> InitialGoal:
    """Algorithm 1, lines 1-6: the closest collision-free goal. It does not use the object's dynamics.

    Args:
        object_pose: x^o_t in {W}.
        collision_free: check of footprint poses against map and path.
        push_directions: headings in {W} [rad] in which the robot can push, one per reachable face. Goals outside all
            cones are excluded. None allows all. Among equally close goals, the one with the smallest deviation from a
            heading is chosen.
        cfg: settings.
        area: side of the square around the object that contains the goals [m].

    Returns:
        The goal and all candidates.
    """
    cfg = cfg or ObjectPlannerConfig()
    pose = np.asarray(object_pose, dtype=float)
    grid = goal_grid(pose, area)
    distance = _distance(grid, pose)
    grid = grid[distance >= max(cfg.min_displacement, 1e-9) - 1e-9]
    deviation, nearest = _deviation(grid, pose, push_directions)
    within = deviation <= CONE
    if not within.any():
        return InitialGoal(None, None, np.zeros((0, 3)), "no goal lies in a direction in which the robot can push")
    grid, deviation, nearest = grid[within], deviation[within], nearest[within]
    free = np.asarray(collision_free(grid), dtype=bool)
    if not free.any():
        return InitialGoal(None, None, np.zeros((0, 3)), f"none of {len(grid)} goals near the object is collision-free")
    grid, deviation, nearest = grid[free], deviation[free], nearest[free]
    # Rounding makes mirror-image goals exactly equally close, so the smaller deviation decides between them.
    order = np.lexsort((np.round(deviation, 6), np.round(_distance(grid, pose), 6)))
    grid, direction = grid[order], int(nearest[order[0]])
    reason = f"closest of {len(grid)} collision-free goals, {float(_distance(grid[:1], pose)[0]):.2f} m away"
    return InitialGoal(grid[0], None if push_directions is None else direction, grid, reason)


def planning_stage(
    end_poses: Float[Array, "S 3"],
    costs: Float[Array, "S"],
    object_pose: Float[Array, "3"],
    collision_free: CollisionFree,
    *,
    cfg: ObjectPlannerConfig | None = None,
    manipulable: bool | None = None,
) -> ObjectDecision:
    """Algorithm 1, lines 7-16: whether the object can be moved, and a goal that the model can reach.

    Non-finite roll-outs are ignored. The goal buffer starts empty, which is a deviation from the paper: with the first
    stage's goals in it, as printed, the closest goal would often be one that no roll-out reaches.

    Args:
        end_poses: x^{o,T} of each roll-out in {W}.
        costs: cost of each roll-out; the lowest costs define the optimal roll-outs x^*.
        object_pose: x^o_t in {W}.
        collision_free: check of footprint poses against map and path.
        cfg: settings.
        manipulable: overrides the decision by K, if given.

    Returns:
        The decision with K, G and the candidates.
    """
    cfg = cfg or ObjectPlannerConfig()
    pose = np.asarray(object_pose, dtype=float)
    ends, cost = np.asarray(end_poses, dtype=float), np.asarray(costs, dtype=float)
    finite = np.isfinite(cost) & np.isfinite(ends).all(axis=-1)
    ends, cost = ends[finite], cost[finite]
    empty = np.zeros((0, 3))
    if not len(ends):
        reason = "no roll-out of the model is finite"
        return ObjectDecision(bool(manipulable), math.nan, math.nan, None, empty, reason)
    best = ends[np.argsort(cost, kind="stable")[:BEST]]
    # With fewer finite roll-outs than K sums over, their mean replaces the missing ones.
    k = float(np.mean(_distance(best, pose) ** 2) * BEST)
    g = float(np.linalg.norm(best[:, :2].mean(axis=0) - pose[:2]))
    text = f"K = {k:.3f} m²"
    if manipulable is None:
        manipulable = k >= cfg.threshold
        text += f" {'>=' if manipulable else '<'} {cfg.threshold:g} m²"
    if not manipulable:
        return ObjectDecision(False, k, g, None, empty, text)
    buffer = ends[np.asarray(collision_free(ends), dtype=bool)]
    if not len(buffer):
        return ObjectDecision(True, k, g, None, empty, f"{text}, but none of {len(ends)} roll-outs ends collision-free")
    buffer = buffer[np.argsort(_distance(buffer, pose), kind="stable")]
    reason = f"{text}; closest of {len(buffer)} reachable collision-free goals"
    return ObjectDecision(True, k, g, buffer[0], buffer, reason)


def _distance(poses: Float[np.ndarray, "N 3"], pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "N"]:
    return np.linalg.norm(poses[:, :2] - pose[:2], axis=-1)


def _deviation(
    poses: Float[np.ndarray, "N 3"], pose: Float[np.ndarray, "3"], directions: Float[Array, "F"] | None
) -> tuple[Float[np.ndarray, "N"], Int[np.ndarray, "N"]]:
    """Angle between each displacement and the nearest push direction, and the index of that direction."""
    if directions is None:
        return np.zeros(len(poses)), np.zeros(len(poses), dtype=int)
    headings = np.atleast_1d(np.asarray(directions, dtype=float))
    if not len(headings):
        return np.full(len(poses), np.inf), np.zeros(len(poses), dtype=int)
    bearing = np.arctan2(poses[:, 1] - pose[1], poses[:, 0] - pose[0])
    angles = np.abs(se2.wrap(bearing[:, None] - headings[None, :]))
    return angles.min(axis=1), angles.argmin(axis=1)
