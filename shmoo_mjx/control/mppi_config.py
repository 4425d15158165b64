"""Settings of MPPI."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from shmoo_mjx.errors import ShmooError


@dataclass(frozen=True)
class MppiConfig:
    """Static (hashable) settings, in the caller's units of control and cost.

    Raises:
        ShmooError: a field that is not finite, out of its range, or not of the length of ``sigma``.
    """

    sigma: tuple[float, ...]
    """Standard deviation of the control noise per channel; 0 freezes a channel, more searches wider and less finely."""
    low: tuple[float, ...]
    """Lower bound per channel."""
    high: tuple[float, ...]
    """Upper bound per channel."""
    num_rollouts: int = 500
    """S, roll-outs per plan, at least 3: the first is the nominal, the second zero control, the others are sampled.
    More make the plan less noisy, and computing time grows with them."""
    horizon: int = 30
    """T, time steps per roll-out; more see farther ahead, and computing time grows with them."""
    temperature: float = 0.7
    """lambda, in units of ``cost_scale`` x cost; lower follows the best roll-outs, higher the mean of all."""
    cost_scale: float = 1.0
    """Factor on every cost before the temperature acts [1/unit of cost]: 1 leaves the temperature as the paper has it.
    With a cost in metres, 0.7 hardly tells roll-outs apart that end 0.1 m from each other."""
    noise_correlation: float = 0.8
    """Correlation of the noise from one time step to the next, in [0, 1): a stationary AR(1) process whose standard
    deviation stays ``sigma``. 0 is Williams' white noise; near 1 each roll-out holds one perturbation throughout."""

    def __post_init__(self) -> None:
        for name in ("sigma", "low", "high"):
            # Lists and arrays are welcome, but could not be hashed.
            object.__setattr__(self, name, _numbers(name, getattr(self, name)))
        for name in ("low", "high"):
            count = len(getattr(self, name))
            if count != self.controls:
                raise ShmooError(
                    f"MppiConfig: {name} has {count} entries and sigma {self.controls}; give one per control channel."
                )
        for name, least in (("num_rollouts", 3), ("horizon", 1)):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or value < least:
                raise ShmooError(f"MppiConfig: {name} is {value}; give a whole number from {least} on.")
        for name in ("temperature", "cost_scale"):
            if not 0 < getattr(self, name) < math.inf:
                raise ShmooError(f"MppiConfig: {name} is {getattr(self, name)}; give a finite number above 0.")
        if not 0 <= self.noise_correlation < 1:
            raise ShmooError(f"MppiConfig: noise_correlation is {self.noise_correlation}; give a number in [0, 1).")
        if min(self.sigma) < 0:
            raise ShmooError(f"MppiConfig: sigma is {self.sigma}; no entry may be negative.")
        if any(low > high for low, high in zip(self.low, self.high, strict=True)):
            raise ShmooError(f"MppiConfig: low is {self.low} and high {self.high}; low must not exceed high.")

    @property
    def controls(self) -> int:
        """m, number of control channels."""
        return len(self.sigma)


def _numbers(name: str, values: Iterable[float]) -> tuple[float, ...]:
    """One finite number per control channel."""
    try:
        numbers = tuple(float(value) for value in values)
    except (TypeError, ValueError):
        numbers = ()
    if not numbers or not all(map(math.isfinite, numbers)):
        raise ShmooError(f"MppiConfig: {name} is {values}; give one finite number per control channel.")
    return numbers
