"""Differentially flat model of the ball-balancing robot.

One plane of the robot, linearised about upright, obeys a x'' + b phi'' = c phi, where x is the ball's position and phi
the lean. S = x + (b/a) phi is a flat output: phi = (a/c) S'' and x = S - (b/c) S''.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Numbers


class FlatModel(NamedTuple):
    """Coefficients of a x'' + b phi'' = c phi. Both planes have the same."""

    a: float
    """Coefficient of the ball's acceleration [kg m]."""
    b: float
    """Coefficient of the lean acceleration [kg m^2]."""
    c: float
    """Coefficient of the lean [N m]."""

    def flat_state(
        self,
        position: Numbers | Float[Array, "2"],
        velocity: Numbers | Float[Array, "2"],
        lean: Numbers | Float[Array, "2"],
        lean_rate: Numbers | Float[Array, "2"],
    ) -> Float[np.ndarray, "4 2"]:
        """S and its first three derivatives, given ball position, velocity, lean and lean rate in {W}."""
        position, velocity, lean, lean_rate = (
            np.asarray(v, dtype=float)[:2] for v in (position, velocity, lean, lean_rate)
        )
        lever, pull = self.b / self.a, self.c / self.a
        return np.stack([position + lever * lean, velocity + lever * lean_rate, pull * lean, pull * lean_rate])
