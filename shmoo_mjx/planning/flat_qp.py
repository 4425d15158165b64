"""The quadratic program (QP) of a flat trajectory.

With the flat output S of ``flat_model``, a quintic B-spline for S in x and in y makes position, speed and lean linear
functions of the control points. Limits on them and a corridor around the path then give a QP. Its variables are the x
coordinates of the control points, then their y coordinates, then one slack per sample time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import clarabel
import numpy as np
from scipy import sparse
from scipy.interpolate import BSpline

from shmoo_mjx.arrays import Float
from shmoo_mjx.planning.flat_model import FlatModel

DEGREE = 5
_ANGLES = np.arange(8) * np.pi / 4
_NORMALS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1)
"""Normals of an octagon, which approximates a disc by linear constraints."""
_INSCRIBED = float(np.cos(np.pi / 8))
_INTERVALS = 12
"""Number of polynomial pieces of the spline: about one per 0.3 s."""
SAMPLES = 24
"""Number of times at which limits and corridor are imposed: two per piece."""
LEAN_RECOVERY = 0.20
"""Lean limit in a recovery [rad]: twice the limit in normal driving."""
_LEAN_ACCELERATION_MAX = 5.0
"""Limit of the lean acceleration [rad/s^2]: about the drive's torque over the body's inertia about the ball axis."""
_TRACKING_WEIGHT = 1.0
"""Weight of the squared distance from the reference [1/m^2]. The other weights are relative to it."""
_END_WEIGHT = 100.0
"""Weight of that distance at the end of the horizon, if the horizon ends at the path's end [1/m^2]."""
_SMOOTH_WEIGHT = 2e-3
"""Weight of the squared fourth derivative of S, to which the drive's torque is proportional [s^8/m^2]."""
_SLACK_WEIGHT = 200.0
"""Weight of leaving the corridor [1/m] and, in a recovery, of excess speed [s/m]. It is so high that slack is only used
where the limits require it."""


@dataclass(frozen=True)
class TrajectoryConfig:
    """Limits and horizon of a trajectory."""

    horizon: float = 3.5
    """Duration of a trajectory [s]. It always ends at rest, so following an old trajectory to its end is safe. Larger
    values allow faster driving, because there is more time to stop, and take longer to compute."""
    speed: float = 0.45
    """Target speed [m/s]. Larger values drive faster and deviate more from the path."""
    speed_max: float = 0.60
    """Speed limit at the sample times, except in a recovery [m/s]. Between them it is exceeded only slightly. Larger
    values let the robot catch up after a stop."""
    lean_max: float = 0.10
    """Lean limit outside a recovery [rad]. Larger values accelerate and brake harder."""
    acceleration: float = 0.35
    """Acceleration of the reference along the path [m/s^2], below g times ``lean_max``. Larger values reach the target
    speed earlier."""
    robot_radius: float = 0.25
    """Radius of the disc that must stay clear, margin included [m]. Larger values keep more distance from walls and
    exclude narrow passages."""


class Planner(NamedTuple):
    """Precomputed data that depends on model and configuration only (``init``). n control points, K samples."""

    model: FlatModel
    cfg: TrajectoryConfig
    times: Float[np.ndarray, "K"]
    """Sample times [s]. The last one is the horizon."""
    position: Float[np.ndarray, "K n"]
    """Maps control points to ball positions."""
    on_way: sparse.csc_matrix
    """``[2n + K, 2n + K]`` upper triangle of the quadratic cost."""
    at_end: sparse.csc_matrix
    """The same, for a horizon that ends at the path's end."""
    rows: sparse.csc_matrix
    """``[R, 2n + K]`` constraint matrix: 14 equalities, then inequalities."""
    recovery_rows: sparse.csc_matrix
    """The same, with slack on speed."""


def init(model: FlatModel, cfg: TrajectoryConfig = TrajectoryConfig()) -> Planner:
    """Evaluates the spline basis and assembles the matrices once for all solves."""
    times = np.linspace(0.0, cfg.horizon, SAMPLES + 1)[1:]
    value, speed, tilt, jerk, snap = (_basis(cfg, times, order) for order in range(5))
    lag, pull = model.b / model.c, model.a / model.c
    position, velocity, lean = value - lag * tilt, speed - lag * jerk, pull * tilt
    # The fourth derivative is linear between knots, so limits at the knots hold everywhere.
    lean_acceleration = pull * _basis(cfg, np.linspace(0.0, cfg.horizon, _INTERVALS + 1), 4)
    ends = [_basis(cfg, np.zeros(1), k)[0] for k in range(4)]
    ends += [_basis(cfg, np.full(1, cfg.horizon), k)[0] for k in range(1, 4)]
    quantities = _Quantities(np.array(ends), velocity, lean, position, lean_acceleration)
    return Planner(
        model=model,
        cfg=cfg,
        times=times,
        position=position,
        on_way=_quadratic(position, snap, at_end=False),
        at_end=_quadratic(position, snap, at_end=True),
        rows=_rows(quantities, recovery=False),
        recovery_rows=_rows(quantities, recovery=True),
    )


def solve(
    planner: Planner,
    state: Float[np.ndarray, "4 2"],
    reference: Float[np.ndarray, "K 2"],
    width: Float[np.ndarray, "K"],
    *,
    at_end: bool,
    recovery: bool = False,
) -> tuple[Float[np.ndarray, "n 2"], float] | None:
    """Solves for the spline's control points.

    Args:
        planner: precomputed data from ``init``.
        state: flat state at the start.
        reference: reference positions at the sample times [m].
        width: radius of the corridor around each reference point [m].
        at_end: whether the last point gets the weight of the path's end.
        recovery: allows LEAN_RECOVERY and, at a cost, speeds above ``speed_max``.

    Returns:
        Control points and the largest slack, or None if the limits are infeasible from the state.
    """
    n = planner.position.shape[1]
    linear = -2 * (planner.position.T * _tracking_weights(at_end)) @ reference
    cost = np.concatenate([linear.T.ravel(), np.full(SAMPLES, _SLACK_WEIGHT / SAMPLES)])
    pinned, limits = _bounds(planner.cfg, state, reference, width, recovery=recovery)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solver = clarabel.DefaultSolver(
        planner.at_end if at_end else planner.on_way,
        cost,
        planner.recovery_rows if recovery else planner.rows,
        np.concatenate([pinned, limits]),
        [clarabel.ZeroConeT(len(pinned)), clarabel.NonnegativeConeT(len(limits))],
        settings,
    )
    solution = solver.solve()
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        return None
    x = np.array(solution.x)
    return x[: 2 * n].reshape(2, n).T, float(max(x[2 * n :].max(), 0.0))


def knot_vector(intervals: int, horizon: float) -> Float[np.ndarray, "k"]:
    """Knots of the clamped spline with ``intervals`` equal pieces over [0, horizon] s."""
    inner = np.linspace(0.0, horizon, intervals + 1)
    return np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, horizon)])


@lru_cache(maxsize=8)
def basis_splines(intervals: int, horizon: float) -> tuple[BSpline, ...]:
    """Basis of S and of its first four derivatives, with one column of coefficients per control point.

    Cached, because deriving them takes far longer than evaluating them. Callers must not modify them.
    """
    basis = BSpline(knot_vector(intervals, horizon), np.eye(intervals + DEGREE), DEGREE)
    return (basis, *(basis.derivative(order) for order in range(1, 5)))


def _basis(cfg: TrajectoryConfig, times: Float[np.ndarray, "K"], order: int) -> Float[np.ndarray, "K n"]:
    """Maps control points to the derivative of S of this order."""
    return basis_splines(_INTERVALS, cfg.horizon)[order](times)


def _tracking_weights(at_end: bool) -> Float[np.ndarray, "K"]:
    weights = np.full(SAMPLES, _TRACKING_WEIGHT / SAMPLES)
    if at_end:
        weights[-1] = _END_WEIGHT
    return weights


def _quadratic(position: Float[np.ndarray, "K n"], snap: Float[np.ndarray, "K n"], at_end: bool) -> sparse.csc_matrix:
    """Upper triangle of the quadratic cost: tracking and smoothness. Slack has a linear cost."""
    k = SAMPLES
    hessian = 2 * (position.T * _tracking_weights(at_end)) @ position
    hessian += 2 * _SMOOTH_WEIGHT / k * snap.T @ snap
    return sparse.csc_matrix(
        sparse.triu(sparse.block_diag([sparse.csc_matrix(hessian)] * 2 + [sparse.csc_matrix((k, k))]))
    )


class _Quantities(NamedTuple):
    """Matrices that map control points to the constrained quantities."""

    ends: Float[np.ndarray, "7 n"]
    """S and its derivatives at the start and the end."""
    velocity: Float[np.ndarray, "K n"]
    lean: Float[np.ndarray, "K n"]
    position: Float[np.ndarray, "K n"]
    lean_acceleration: Float[np.ndarray, "J n"]
    """At the J knots."""


def _rows(quantities: _Quantities, recovery: bool) -> sparse.csc_matrix:
    """Constraint matrix, in the order of ``_bounds``."""
    ends, velocity, lean, position, lean_acceleration = quantities
    k = len(position)
    slack = -sparse.kron(np.ones((8, 1)), sparse.identity(k))
    blocks = [
        [sparse.kron(np.eye(2), sparse.csc_matrix(ends)), None],
        [_octagon(velocity), slack if recovery else None],
        [_octagon(lean), None],
        [_octagon(position), slack],
        [_box(lean_acceleration), None],
        [None, -sparse.identity(k)],
    ]
    return sparse.csc_matrix(sparse.bmat(blocks))


def _bounds(
    cfg: TrajectoryConfig,
    state: Float[np.ndarray, "4 2"],
    reference: Float[np.ndarray, "K 2"],
    width: Float[np.ndarray, "K"],
    *,
    recovery: bool,
) -> tuple[Float[np.ndarray, "14"], Float[np.ndarray, "r"]]:
    """Right-hand sides of the equalities (initial state, rest at the end) and of the inequalities."""
    k = SAMPLES
    pinned = np.concatenate([np.concatenate([state[:, i], np.zeros(3)]) for i in range(2)])
    limits = [
        np.full(8 * k, cfg.speed_max * _INSCRIBED),
        np.full(8 * k, (LEAN_RECOVERY if recovery else cfg.lean_max) * _INSCRIBED),
        (_NORMALS @ reference.T).ravel() + np.tile(width * _INSCRIBED, 8),
        np.full(4 * (_INTERVALS + 1), _LEAN_ACCELERATION_MAX / np.sqrt(2)),
        np.zeros(k),
    ]
    return pinned, np.concatenate(limits)


def _octagon(rows: Float[np.ndarray, "K n"]) -> sparse.csc_matrix:
    """``[8 K, 2 n]``: each octagon normal times the planar quantity that ``rows`` give per axis."""
    return sparse.kron(_NORMALS, sparse.csc_matrix(rows), format="csc")


def _box(rows: Float[np.ndarray, "K n"]) -> sparse.csc_matrix:
    """``[4 K, 2 n]``: plus and minus each component of the quantity. Cheaper and stricter than the octagon."""
    signed = np.vstack([np.eye(2), -np.eye(2)])
    return sparse.kron(signed, sparse.csc_matrix(rows), format="csc")
