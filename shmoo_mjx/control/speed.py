"""How fast the robot may be on its way to the object's goal."""

from __future__ import annotations

from dataclasses import dataclass

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.geometry import se2


@dataclass(frozen=True)
class SpeedProfile:
    """Allowed speed of the robot by the object's distance from its goal: pushing can't brake what rolls, so that it
    has to arrive slowly."""

    limit: float = 0.4
    """Largest speed allowed [m/s]; more is faster, and loses what rolls."""
    at_goal: float = 0.0
    """Speed allowed at the goal [m/s], where ``slow_down`` is set."""
    slow_down: float = 0.0
    """Increase of the allowed speed per metre from the goal, up to ``limit`` [1/s]; more slows down later, 0 leaves the
    limit the same everywhere."""

    def allowed(self, distance: Scalar | Float[Array, "..."]) -> Scalar | Float[Array, "..."]:
        """Allowed speed [m/s] where the object is ``distance`` [m] from its goal."""
        if not self.slow_down:
            return self.limit + 0.0 * distance
        return se2.array_module(distance).minimum(self.at_goal + self.slow_down * distance, self.limit)
