"""Local trajectories that a ball-balancing robot can follow, by differential flatness and one QP.

This module turns a path into the reference and the corridor of the QP in ``flat_qp``. It checks the solution and
evaluates it as a trajectory.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.flat_model import FlatModel
from shmoo_mjx.planning.flat_qp import DEGREE, LEAN_RECOVERY, SAMPLES, Planner, basis_splines, solve
from shmoo_mjx.planning.paths import Path, point_at, project, tangent_at

_CORRIDOR = (0.04, 0.50)
"""Minimum and maximum half width of the corridor [m]. The minimum keeps the QP feasible. The maximum stops the robot
from cutting corners."""
_NARROW = 0.20
"""Half width of the corridor below which the reference slows down in proportion, down to a third [m]. It is three times
the tracking error."""
_STRAY = 0.06
"""Tracking error of the robot, 95th percentile of measurements [m]. The corridor keeps this extra distance from walls
where possible."""
_GENTLE_LEAN = 0.02
"""Reduced lean limit for leaving a nearby obstacle when the normal trajectory is refused [rad]. The ball first rolls
towards the obstacle: by 1 cm with this limit, by 2 to 3 cm with 0.10 rad."""
_NEAR = 0.03
"""Distance beyond the radius within which the reduced limit is tried [m]."""


class Trajectory(NamedTuple):
    """A trajectory, or the reason why there is none."""

    ok: bool
    """Whether the trajectory may be driven."""
    reason: str
    """Empty if ok, else one sentence."""
    control_points: Float[np.ndarray, "n 2"]
    """Control points of S in {W} [m]."""
    horizon: float
    """Duration [s]."""
    model: FlatModel
    """The flat model that it was computed with."""
    reference: Float[np.ndarray, "K 2"]
    """Points of the path that were tracked, in {W} [m]."""
    reaches_end: bool
    """Whether the trajectory ends at the path's end."""
    recovery: bool = False
    """Whether the limits on lean and speed were relaxed because the state violates them, for example after a shove."""


class TrajectorySample(NamedTuple):
    """State of the trajectory at given times, in {W}."""

    position: Float[np.ndarray, "... 2"]
    """Position of the ball [m]."""
    velocity: Float[np.ndarray, "... 2"]
    """Velocity of the ball [m/s]."""
    acceleration: Float[np.ndarray, "... 2"]
    """Acceleration of the ball [m/s^2]."""
    lean: Float[np.ndarray, "... 2"]
    """Feed-forward lean towards +x and +y [rad]."""
    lean_rate: Float[np.ndarray, "... 2"]
    """Rate of that lean [rad/s]."""


def plan(
    planner: Planner, state: Float[Array, "4 2"], path: Path, clearance: DistanceField | None = None
) -> Trajectory:
    """The smoothest trajectory that follows the path within the limits and ends at rest.

    Args:
        planner: precomputed data from ``flat_qp.init``.
        state: flat state in {W}, see ``FlatModel.flat_state``.
        path: the global path; the part behind the robot is skipped.
        clearance: distance to walls and obstacles, from which the corridor follows; None for open floor.

    Returns:
        The trajectory. ``ok`` is False, with the reason, if the limits are infeasible from the state or if the
        trajectory is too close to an obstacle. The required distance is the radius, plus the tracking error where the
        path has room for it, but never more than the present distance. If the state violates the limits, the result is
        a ``recovery``: it may lean up to LEAN_RECOVERY and exceeds ``speed_max`` as little as possible.
    """
    state = np.asarray(state, dtype=float)
    cfg = planner.cfg
    if not np.isfinite(state).all():
        return _failed(planner, "the robot's state is not finite", np.zeros((SAMPLES, 2)))
    reference, width, at_end = _reference(planner, state, path, clearance)

    def attempt(lean_max: float = cfg.lean_max, recovery: bool = False) -> Trajectory | None:
        limited = planner._replace(cfg=replace(cfg, lean_max=lean_max))
        solution = solve(limited, state, reference, width, at_end=at_end, recovery=recovery)
        if solution is None:
            return None
        trajectory = Trajectory(True, "", solution[0], cfg.horizon, planner.model, reference, at_end, recovery)
        reason = _leans_too_far(trajectory, planner)
        return trajectory._replace(ok=not reason, reason=reason)

    trajectory = attempt() or attempt(recovery=True)
    if trajectory is None:
        speed, lean = np.linalg.norm(state[1]), np.linalg.norm(state[2]) * planner.model.a / planner.model.c
        text = f"no trajectory keeps the limits from a speed of {speed:.2f} m/s and a lean of {lean:.3f} rad"
        return _failed(planner, text, reference)
    if clearance is None or not trajectory.ok or not (reason := _too_near(trajectory, planner, clearance)):
        return trajectory
    if float(clearance.at(evaluate(trajectory, 0.0).position)) < cfg.robot_radius + _NEAR:
        # To lean away from an obstacle, the ball first rolls towards it. A smaller lean makes this motion smaller.
        gentle = attempt(_GENTLE_LEAN)
        if gentle is not None and gentle.ok and not _too_near(gentle, planner, clearance):
            return gentle
    return trajectory._replace(ok=False, reason=reason)


def evaluate(trajectory: Trajectory, t: Scalar | Float[Array, "..."]) -> TrajectorySample:
    """State of the trajectory ``t`` s after its start. Beyond the horizon it rests at its end."""
    t = np.asarray(t, dtype=float)
    after = (t > trajectory.horizon)[..., None]
    intervals = len(trajectory.control_points) - DEGREE
    within, points = np.clip(t, 0.0, trajectory.horizon), trajectory.control_points
    s = [
        BSpline.construct_fast(basis.t, basis.c @ points, basis.k)(within)
        for basis in basis_splines(intervals, trajectory.horizon)
    ]
    a, b, c = trajectory.model
    lag, tilt = b / c, a / c
    return TrajectorySample(
        position=s[0] - lag * s[2],
        velocity=np.where(after, 0.0, s[1] - lag * s[3]),
        acceleration=np.where(after, 0.0, s[2] - lag * s[4]),
        lean=np.where(after, 0.0, tilt * s[2]),
        lean_rate=np.where(after, 0.0, tilt * s[3]),
    )


def _reference(
    planner: Planner, state: Float[np.ndarray, "4 2"], path: Path, clearance: DistanceField | None
) -> tuple[Float[np.ndarray, "K 2"], Float[np.ndarray, "K"], bool]:
    """Reference points on the path, corridor half widths there, and whether the reference reaches the path's end."""
    cfg, lag = planner.cfg, planner.model.b / planner.model.c
    here = state[0] - lag * state[2]
    s = project(path, here)
    v = max(0.0, float((state[1] - lag * state[3]) @ tangent_at(path, s)))
    ahead = np.linspace(s, min(s + cfg.speed_max * cfg.horizon, path.length), 40)
    half_width = np.full(40, _CORRIDOR[1])
    if clearance is not None:
        room = clearance.at(point_at(path, ahead)) - cfg.robot_radius - _STRAY
        half_width = np.clip(room, _CORRIDOR[0], _CORRIDOR[1])
    step = cfg.horizon / SAMPLES
    along, a = [], cfg.acceleration
    for t in planner.times:
        slow = np.clip(np.interp(s, ahead, half_width) / _NARROW, 1 / 3, 1.0)
        stop_at_end = np.sqrt(2 * a * max(path.length - s, 0.0))
        v = max(0.0, min(v + a * step, cfg.speed * slow, stop_at_end, a * (cfg.horizon - t)))
        s = min(s + v * step, path.length)
        along.append(s)
    return point_at(path, np.array(along)), np.interp(along, ahead, half_width), bool(path.length - s < 0.02)


def _leans_too_far(trajectory: Trajectory, planner: Planner) -> str:
    """Reason why the trajectory leans too far, or an empty string. It also checks between the QP's samples."""
    cfg = planner.cfg
    lean = np.linalg.norm(evaluate(trajectory, np.linspace(0.0, trajectory.horizon, 120)).lean, axis=1)
    allowed = 1.05 * (LEAN_RECOVERY if trajectory.recovery else cfg.lean_max)
    if lean.max() > max(allowed, float(lean[0])):
        return f"the trajectory would have to lean by {lean.max():.2f} rad, more than {allowed:.2f} rad"
    return ""


def _too_near(trajectory: Trajectory, planner: Planner, clearance: DistanceField) -> str:
    """Reason why the trajectory comes too close to an obstacle, or an empty string."""
    times = np.linspace(0.0, trajectory.horizon, 120)
    distance = clearance.at(evaluate(trajectory, times).position)
    # Required distance: the radius, plus the tracking error where the path has room for it, because fast turns leave
    # the corridor, whose width has a minimum. A robot that is already too close must not come closer. The field is
    # uncertain by half a cell.
    radius, here = planner.cfg.robot_radius, float(distance[0])
    beside_path = float(np.min(clearance.at(trajectory.reference))) - _CORRIDOR[0]
    allowed = min(float(np.clip(beside_path, radius, radius + _STRAY)), here) - 0.5 * float(clearance.resolution)
    worst = int(np.argmin(distance))
    if distance[worst] >= allowed:
        return ""
    return (
        f"the trajectory would come within {distance[worst]:.2f} m of an obstacle after {times[worst]:.1f} s, "
        f"where {allowed:.2f} m are needed"
    )


def _failed(planner: Planner, reason: str, reference: Float[np.ndarray, "K 2"]) -> Trajectory:
    points = np.zeros((planner.position.shape[1], 2))
    return Trajectory(False, reason, points, planner.cfg.horizon, planner.model, reference, False)
