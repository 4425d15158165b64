"""Allowed speed of the robot during a push."""

from __future__ import annotations

from dataclasses import dataclass

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.geometry import se2


@dataclass(frozen=True)
class SpeedProfile:
    """Allowed speed of the robot as a function of the object's distance from its goal.

    A push can not brake a rolling object, so the object must arrive slowly.
    """

    limit: float = 0.4
    """Largest allowed speed [m/s]. Larger is faster, but rolling objects can roll away from the hands."""
    at_goal: float = 0.0
    """Allowed speed at the goal [m/s], used if ``slow_down`` is not zero. Larger arrives faster."""
    slow_down: float = 0.0
    """Increase of the allowed speed per metre from the goal, up to ``limit`` [1/s]. Larger slows down later; 0 gives
    ``limit`` everywhere."""

    def allowed(self, distance: Scalar | Float[Array, "..."]) -> Scalar | Float[Array, "..."]:
        """Allowed speed [m/s] at a ``distance`` [m] between the object and its goal."""
        if not self.slow_down:
            return self.limit + 0.0 * distance
        return se2.array_module(distance).minimum(self.at_goal + self.slow_down * distance, self.limit)
