"""The quadratic program behind a flat trajectory.

With the flat output S of ``flat_model``, a quintic B-spline for S in x and in y gives position, speed and lean as
linear functions of its control points, so that limits on them and a corridor round the path make a quadratic program.
Its variables are the control points' x, then their y, then one slack per sample time.
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
"""Directions of an octagon's sides: a disc written as linear constraints."""
_INSCRIBED = float(np.cos(np.pi / 8))
_INTERVALS = 12
"""Number of polynomial pieces of the spline: one in 0.3 s."""
SAMPLES = 24
"""Number of times at which limits and corridor are imposed: two on each piece."""
LEAN_RECOVERY = 0.20
"""Lean never exceeded in a recovery [rad]: twice the limit of common driving."""
_LEAN_ACCELERATION_MAX = 5.0
"""Acceleration of the lean never exceeded [rad/s^2]: about the drive's torque over the body's inertia about the ball
axis."""
_TRACKING_WEIGHT = 1.0
"""Weight of the squared distance from the reference [1/m^2]; the other weights are relative to it."""
_END_WEIGHT = 100.0
"""Weight of that distance at the end of the horizon where that is the path's end [1/m^2]: it is to be reached."""
_SMOOTH_WEIGHT = 2e-3
"""Weight of the squared fourth derivative of S, to which the drive's torque is proportional [s^8/m^2]."""
_SLACK_WEIGHT = 200.0
"""Weight of leaving the corridor [1/m], and in a recovery of excess speed [s/m]: so high that only the limits make it
leave."""


@dataclass(frozen=True)
class TrajectoryConfig:
    """Limits and horizon."""

    horizon: float = 3.5
    """Length of a trajectory [s]; it always ends at rest, so that following an old one to its end is safe. Longer goes
    faster, for there is more way to stop, and takes longer to compute."""
    speed: float = 0.45
    """Speed aimed at [m/s]; more is sooner there and strays farther from its path."""
    speed_max: float = 0.60
    """Speed not exceeded at the sample times [m/s], and between them by little, except in a recovery; more lets the
    robot catch up after a stop."""
    lean_max: float = 0.10
    """Lean never exceeded [rad], except in a recovery; more accelerates and brakes harder."""
    acceleration: float = 0.35
    """Acceleration of the reference along the path [m/s^2], below g times ``lean_max``; more is sooner at its speed."""
    robot_radius: float = 0.25
    """Radius of the disc that must stay clear, margin included [m]; more keeps off walls and finds no way through
    narrow places."""


class Planner(NamedTuple):
    """What depends on model and configuration only; made once by ``init``. n control points, K samples."""

    model: FlatModel
    cfg: TrajectoryConfig
    times: Float[np.ndarray, "K"]
    """Sample times [s], the last one being the horizon."""
    position: Float[np.ndarray, "K n"]
    """Control points to ball position."""
    on_way: sparse.csc_matrix
    """``[2n + K, 2n + K]`` upper half of the quadratic cost."""
    at_end: sparse.csc_matrix
    """The same where the horizon ends at the path's end."""
    rows: sparse.csc_matrix
    """``[R, 2n + K]`` left-hand sides: 14 equalities, then inequalities."""
    recovery_rows: sparse.csc_matrix
    """The same with slack on speed."""


def init(model: FlatModel, cfg: TrajectoryConfig = TrajectoryConfig()) -> Planner:
    """Evaluates the spline basis and assembles the matrices once for all solves."""
    times = np.linspace(0.0, cfg.horizon, SAMPLES + 1)[1:]
    value, speed, tilt, jerk, snap = (_basis(cfg, times, order) for order in range(5))
    lag, pull = model.b / model.c, model.a / model.c
    position, velocity, lean = value - lag * tilt, speed - lag * jerk, pull * tilt
    # The fourth derivative is linear between knots, so that limits at the knots hold everywhere.
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
    """Solves for the spline.

    Args:
        planner: from ``init``.
        state: flat state at the start.
        reference: where to be at the sample times [m].
        width: radius of the disc round each reference point that should not be left [m].
        at_end: weigh the last point as the path's end.
        recovery: allow LEAN_RECOVERY and, at a price, speeds above ``speed_max``.

    Returns:
        Control points and the largest slack, or None if the limits contradict the state.
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
    """Knots of the clamped spline with this many equal pieces over [0, horizon] s."""
    inner = np.linspace(0.0, horizon, intervals + 1)
    return np.concatenate([np.zeros(DEGREE), inner, np.full(DEGREE, horizon)])


@lru_cache(maxsize=8)
def basis_splines(intervals: int, horizon: float) -> tuple[BSpline, ...]:
    """The basis of S and of its first four derivatives, one column of coefficients per control point.

    Remembered, because to derive them takes far longer than to evaluate them; not to be written to.
    """
    basis = BSpline(knot_vector(intervals, horizon), np.eye(intervals + DEGREE), DEGREE)
    return (basis, *(basis.derivative(order) for order in range(1, 5)))


def _basis(cfg: TrajectoryConfig, times: Float[np.ndarray, "K"], order: int) -> Float[np.ndarray, "K n"]:
    """Control points to the derivative of S of this order."""
    return basis_splines(_INTERVALS, cfg.horizon)[order](times)


def _tracking_weights(at_end: bool) -> Float[np.ndarray, "K"]:
    weights = np.full(SAMPLES, _TRACKING_WEIGHT / SAMPLES)
    if at_end:
        weights[-1] = _END_WEIGHT
    return weights


def _quadratic(position: Float[np.ndarray, "K n"], snap: Float[np.ndarray, "K n"], at_end: bool) -> sparse.csc_matrix:
    """Upper half of the quadratic cost: tracking and smoothness; slack costs linearly."""
    k = SAMPLES
    hessian = 2 * (position.T * _tracking_weights(at_end)) @ position
    hessian += 2 * _SMOOTH_WEIGHT / k * snap.T @ snap
    return sparse.csc_matrix(
        sparse.triu(sparse.block_diag([sparse.csc_matrix(hessian)] * 2 + [sparse.csc_matrix((k, k))]))
    )


class _Quantities(NamedTuple):
    """Control points to what is limited."""

    ends: Float[np.ndarray, "7 n"]
    """S and its derivatives at the start and the end."""
    velocity: Float[np.ndarray, "K n"]
    lean: Float[np.ndarray, "K n"]
    position: Float[np.ndarray, "K n"]
    lean_acceleration: Float[np.ndarray, "J n"]
    """At the knots."""


def _rows(quantities: _Quantities, recovery: bool) -> sparse.csc_matrix:
    """Left-hand sides, in the order of ``_bounds``."""
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
    """Right-hand sides of the equalities (state at the start, rest at the end) and of the inequalities."""
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
    """``[4 K, 2 n]``: plus and minus each axis's part of the quantity; cheaper than the octagon, and stricter."""
    signed = np.vstack([np.eye(2), -np.eye(2)])
    return sparse.kron(signed, sparse.csc_matrix(rows), format="csc")
