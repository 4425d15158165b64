"""The flat output of the ball-balancing robot, and the closed-form motion from rest to rest.

One plane of the robot, linearised about upright, obeys a x'' + b phi'' = c phi with x the ball's position and phi the
lean. S = x + (b/a) phi is a flat output: phi = (a/c) S'' and x = S - (b/c) S''.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Numbers, Scalar


class FlatModel(NamedTuple):
    """Coefficients of a x'' + b phi'' = c phi, for both planes."""

    a: float
    """[kg m]"""
    b: float
    """[kg m^2]"""
    c: float
    """[N m]"""

    def flat_state(
        self,
        position: Numbers | Float[Array, "2"],
        velocity: Numbers | Float[Array, "2"],
        lean: Numbers | Float[Array, "2"],
        lean_rate: Numbers | Float[Array, "2"],
    ) -> Float[np.ndarray, "4 2"]:
        """S and its first three derivatives from ball position, velocity, lean, lean rate in {W}."""
        position, velocity, lean, lean_rate = (
            np.asarray(v, dtype=float)[:2] for v in (position, velocity, lean, lean_rate)
        )
        lever, pull = self.b / self.a, self.c / self.a
        return np.stack([position + lever * lean, velocity + lever * lean_rate, pull * lean, pull * lean_rate])


def rest_to_rest(distance: float, duration: float, t: Scalar | Float[Array, "*t"]) -> Float[np.ndarray, "*t 5"]:
    """S and its first four derivatives at times t of the degree-9 motion from rest to rest.

    s(u) = 126 u^5 - 420 u^6 + 540 u^7 - 315 u^8 + 70 u^9, the polynomial whose derivatives up to the fourth vanish at
    both ends.
    """
    shape = np.polynomial.Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])
    u = np.clip(np.asarray(t, dtype=float) / duration, 0.0, 1.0)
    return distance * np.stack([shape.deriv(k)(u) / duration**k if k else shape(u) for k in range(5)], axis=-1)


def rest_to_rest_time(model: FlatModel, distance: float, lean_max: float, speed_max: float = np.inf) -> float:
    """Shortest duration [s] of ``rest_to_rest`` that keeps |lean| and |S'| below their limits [rad, m/s]."""
    by_lean = np.sqrt(9.372 * model.a * distance / (model.c * lean_max))
    return float(max(by_lean, 2.461 * distance / speed_max))
