"""Quasi-static pushing: an ellipsoidal limit surface and Coulomb friction at the pusher, integrated over the push.

The motion per step is V = B w. w is the wrench of the pusher's force, and B is a symmetric positive definite matrix
(Goyal's limit surface as an ellipsoid). The force keeps the pusher outside the outline and lies in the friction cone.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from shmoo_mjx.arrays import Array
from shmoo_mjx.evaluation import push_outline
from shmoo_mjx.geometry import se2

NOMINAL = np.array([np.log(0.6), np.log(0.2), 0.0, 0.0, 0.0, 0.0, 0.0])
"""Nominal parameters: log of (radius of gyration of friction / size), log of the friction coefficient at the pusher,
two parameters of the anisotropy of friction under the object, centre of friction (x, y) / size, and gap before contact
/ size."""
SPREAD = np.array([0.3, 0.4, 0.15, 0.15, 0.1, 0.1, 0.02])
"""Standard deviation of each parameter about its nominal value."""


def push(start: Array, end: Array, corners: Array, radius: float, *, parameters: Array, steps: int = 60) -> np.ndarray:
    """Motion ``[P, N, 3]`` of the object in its frame before the push [m, m, rad], for each of P sets of parameters.

    Args:
        start: ``[N, 2]`` centre of the pusher before the push, in the object's frame [m].
        end: ``[N, 2]`` centre of the pusher after the push, in the same frame [m]. The pusher moves straight.
        corners: ``[M, 2]`` corners of the outline [m].
        radius: radius of the pusher [m].
        parameters: ``[P, 7]`` parameters in the order of NOMINAL.
        steps: number of integration steps.
    """
    scale, shape = push_outline.size(corners), (len(parameters), len(start), 3)
    mobility = np.repeat([_mobility(p, scale) for p in parameters], len(start), axis=0)
    friction, gap = np.repeat(np.exp(parameters[:, 1]), len(start)), np.repeat(parameters[:, 6] * scale, len(start))
    back = np.tile(push_outline.contact(start, corners).normal, (len(parameters), 1)) * gap[:, None]
    first, last = np.tile(start, (len(parameters), 1)) + back, np.tile(end, (len(parameters), 1)) + back
    pose = np.zeros((len(first), 3))
    for k in range(steps):
        old, new = (first + (last - first) * (i / steps) for i in (k, k + 1))
        before, after = se2.inverse_transform_point(pose, old), se2.inverse_transform_point(pose, new)
        pose = _moved(pose, _twist(after, after - before, corners, radius, mobility=mobility, friction=friction))
    return pose.reshape(shape)


def identify(
    start: Array, end: Array, motion: Array, *, corners: Array, radius: float, prior: tuple[Array, Array] | None = None
) -> np.ndarray:
    """Parameters ``[7]`` that explain the measured motion of N pushes best, with a robust loss and a normal prior.

    Args:
        start: as in `push`.
        end: as in `push`.
        motion: ``[N, 3]`` measured motion of the object in its frame before the push [m, m, rad].
        corners: as in `push`.
        radius: as in `push`.
        prior: mean and standard deviation of the parameters (default: NOMINAL and SPREAD).
    """
    mean, spread = prior or (NOMINAL, SPREAD)
    noise = 0.1 * np.linalg.norm(end - start, axis=1).mean()
    unit = np.array([1.0, 1.0, push_outline.size(corners)]) / noise

    def residuals(parameters: Array) -> np.ndarray:
        error = (push(start, end, corners, radius, parameters=parameters) - motion) * unit
        return np.concatenate([error.reshape(len(parameters), -1), (parameters - mean) / spread], axis=1)

    def jacobian(parameters: Array) -> np.ndarray:
        # The push is only piecewise smooth, so the step of the differences is as large as a tenth of the spread.
        step = SPREAD / 10
        high, low = np.split(residuals(parameters + np.concatenate([np.diag(step), -np.diag(step)])), 2)
        return np.asarray((high - low).T / (2 * step))

    def loss(squared: Array) -> np.ndarray:
        root = np.sqrt(1 + squared)
        robust = np.stack([2 * (root - 1), 1 / root, -0.5 / root**3])
        robust[:, -len(mean) :] = np.stack([squared, np.ones_like(squared), np.zeros_like(squared)])[:, -len(mean) :]
        return robust

    return np.asarray(
        least_squares(lambda p: residuals(p[None])[0], mean, jacobian, x_scale=spread, loss=loss, max_nfev=12).x
    )


def start_of_push(start: Array, end: Array, corners: Array, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """``start`` and ``end [N, 2]``, moved along the normal so that the pusher just touches at the start [m]."""
    touch = push_outline.contact(start, corners)
    shift = (radius - touch.distance)[:, None] * touch.normal
    return np.asarray(start + shift), np.asarray(end + shift)


def _mobility(parameters: Array, scale: float) -> np.ndarray:
    """Matrix B ``[3, 3]`` about the origin of the object's frame."""
    gyration = np.exp(parameters[0]) * scale
    b = np.diag([1 + parameters[2], 1 - parameters[2], 1 / gyration**2])
    b[0, 1] = b[1, 0] = parameters[3]
    x, y = parameters[4:6] * scale
    move = np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [0.0, 0.0, 1.0]])
    return np.asarray(move @ b @ move.T)


def _twist(tip: Array, travel: Array, corners: Array, radius: float, *, mobility: Array, friction: Array) -> np.ndarray:
    """Motion ``[N, 3]`` of the object while the pusher arrives at ``tip`` after ``travel``, all in the object's
    frame."""
    touch = push_outline.contact(tip, corners)
    depth, (nx, ny), (cx, cy) = radius - touch.distance, -touch.normal.T, touch.point.T
    approach, slide = travel[:, 0] * nx + travel[:, 1] * ny, travel[:, 1] * nx - travel[:, 0] * ny
    slide = slide * np.clip(depth / np.maximum(approach, 1e-9), 0.0, 1.0)
    # Columns of the map from a force at the contact to the twist, and the compliance of the contact point.
    from_x = mobility[:, :, 0] - cy[:, None] * mobility[:, :, 2]
    from_y = mobility[:, :, 1] + cx[:, None] * mobility[:, :, 2]
    xx, xy = from_x[:, 0] - cy * from_x[:, 2], from_x[:, 1] + cx * from_x[:, 2]
    yy = from_y[:, 1] + cx * from_y[:, 2]
    want_x, want_y = depth * nx - slide * ny, depth * ny + slide * nx
    determinant = xx * yy - xy**2
    fx, fy = (yy * want_x - xy * want_y) / determinant, (xx * want_y - xy * want_x) / determinant
    tangential = fy * nx - fx * ny
    slips = np.abs(tangential) > friction * (fx * nx + fy * ny)
    signed = friction * np.sign(tangential)
    ex, ey = nx - signed * ny, ny + signed * nx
    speed = nx * (xx * ex + xy * ey) + ny * (xy * ex + yy * ey)
    press = depth / np.maximum(speed, 1e-3)
    fx, fy = np.where(slips, ex * press, fx), np.where(slips, ey * press, fy)
    touching = depth > 0.0
    return np.asarray(from_x * (fx * touching)[:, None] + from_y * (fy * touching)[:, None])


def _moved(pose: Array, twist: Array) -> np.ndarray:
    shift = se2.rotate(twist[:, :2], pose[:, 2] + twist[:, 2] / 2)
    return np.concatenate([pose[:, :2] + shift, pose[:, 2:] + twist[:, 2:]], axis=1)
