"""Driving: lean commands that follow a path by local flat trajectories, or track a velocity."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.geometry import se2
from shmoo_mjx.planning import flat_trajectory
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.flat_qp import Planner
from shmoo_mjx.planning.flat_trajectory import Trajectory
from shmoo_mjx.planning.paths import Path, point_at, project
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean
from shmoo_mjx.types import Observation

_REPLAN_EVERY = 0.5
"""Time between two local trajectories [s]. It is a seventh of their length, so the robot reacts to new obstacles in
time."""
STIFFNESS = 1.0
"""Acceleration of the flat output per metre of error [1/s^2]. With the delays of real sensing, 2.5 is unstable."""
DAMPING = 1.6
"""Acceleration of the flat output per m/s of error [1/s]: a damping ratio of 0.8."""
_STRAYED = (0.15, 0.3)
"""Deviation in position [m] and speed [m/s] above which a new trajectory starts from the measured state. Otherwise it
starts from the state planned by the previous one: measurements lag behind the commands, and trajectories that start
from them would circle around their end."""
LEAD = 0.25
"""Prediction time at which the lean is read from the trajectory [s]: the lag of the lean loop."""
_LEAN_LIMIT = 0.14
"""Maximum commanded lean while driving [rad]: the trajectory's own limit plus feedback."""
_LOOKAHEAD = 0.7
"""Distance along the path of the point that the robot faces [m]. Smaller values make the heading swing at bends."""


class DriveState(NamedTuple):
    """The local trajectory being followed."""

    trajectory: Trajectory | None
    """The trajectory; None before the first one."""
    start: float
    """Start time of the trajectory [s]."""
    failed_since: float | None
    """Time since which no local trajectory has been found [s]."""
    reason: str
    """Reason why the last one was rejected."""


def init() -> DriveState:
    """State without a trajectory."""
    return DriveState(None, -np.inf, None, "")


def follow(
    planner: Planner,
    state: DriveState,
    obs: Observation,
    path: Path | None,
    *,
    clearance: Callable[[], DistanceField],
) -> tuple[DriveState, Float[np.ndarray, "2"]]:
    """One control step along ``path``: the next state and the lean command in {R} [rad].

    A trajectory always ends at rest. Without a new trajectory or without a path, the old one therefore stops the robot.
    ``clearance`` is only evaluated when a new trajectory is due.
    """
    now = float(obs.time[0])
    position, velocity = obs.robot_pose[0, :2], obs.robot_twist[0, :2]
    yaw = obs.robot_pose[0, 2]
    flat = planner.model.flat_state(position, velocity, se2.rotate(obs.lean[0], yaw), se2.rotate(obs.lean_rate[0], yaw))
    if path is not None and now - state.start >= _REPLAN_EVERY - 1e-6:
        trajectory = flat_trajectory.plan(planner, _begin(planner, state, now, flat), path, clearance())
        if trajectory.ok:
            state = DriveState(trajectory, now, None, "")
        else:
            since = now if state.failed_since is None else state.failed_since
            state = state._replace(failed_since=since, reason=trajectory.reason)
    if state.trajectory is None:
        return state, velocity_command(obs, np.zeros(2))
    # The lean is commanded in {R}, which rotates further until the body has reached that lean.
    return state, _track(planner, state, now, flat, yaw=yaw + LEAD * obs.robot_twist[0, 2])


def _begin(planner: Planner, state: DriveState, now: float, flat: Float[np.ndarray, "4 2"]) -> Float[np.ndarray, "4 2"]:
    """Initial flat state of the next trajectory: the state planned by the last one, if the robot is near it."""
    if state.trajectory is None:
        return flat
    at = flat_trajectory.evaluate(state.trajectory, now - state.start)
    planned = planner.model.flat_state(at.position, at.velocity, at.lean, at.lean_rate)
    strayed = np.linalg.norm(flat[:2] - planned[:2], axis=1)
    return flat if strayed[0] > _STRAYED[0] or strayed[1] > _STRAYED[1] else planned


def _track(
    planner: Planner, state: DriveState, now: float, flat: Float[np.ndarray, "4 2"], *, yaw: Scalar
) -> Float[np.ndarray, "2"]:
    assert state.trajectory is not None
    a, b, c = planner.model
    elapsed = now - state.start
    wanted = flat_trajectory.evaluate(state.trajectory, np.array([elapsed, elapsed + LEAD]))
    position = wanted.position[0] + b / a * wanted.lean[0]
    velocity = wanted.velocity[0] + b / a * wanted.lean_rate[0]
    acceleration = c / a * wanted.lean[1] + DAMPING * (velocity - flat[1]) + STIFFNESS * (position - flat[0])
    lean = a / c * acceleration
    norm = float(np.linalg.norm(lean))
    return se2.rotate(lean * min(1.0, _LEAN_LIMIT / max(norm, 1e-9)), -yaw)


def velocity_command(
    obs: Observation, desired: Float[Array, "2"], gains: Gains | None = None
) -> Float[np.ndarray, "2"]:
    """Lean command in {R} [rad] for a velocity ``desired`` in {R} [m/s]."""
    velocity = se2.rotate(obs.robot_twist[0, :2], -obs.robot_pose[0, 2])
    lean = velocity_to_lean(gains or Gains(), velocity, obs.lean_rate[0], np.asarray(desired, dtype=float))
    return np.asarray(lean)


def yaw_ahead(obs: Observation, path: Path) -> float:
    """Heading in {W} [rad] towards a path point ahead. Near the path's end it is the current heading."""
    position = obs.robot_pose[0, :2]
    offset = point_at(path, project(path, position) + _LOOKAHEAD) - position
    return float(np.arctan2(offset[1], offset[0])) if np.hypot(*offset) > 0.3 else float(obs.robot_pose[0, 2])
