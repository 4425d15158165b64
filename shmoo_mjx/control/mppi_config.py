"""Settings of MPPI."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from shmoo_mjx.errors import ShmooError


@dataclass(frozen=True)
class MppiConfig:
    """Static (hashable) settings of MPPI, in the caller's units of control and cost.

    Raises:
        ShmooError: a field is not finite or out of its range, or does not have the length of ``sigma``.
    """

    sigma: tuple[float, ...]
    """Standard deviation of the control noise per channel, in the unit of the control. Larger searches more widely and
    less finely; 0 disables the noise of a channel."""
    low: tuple[float, ...]
    """Lower bound per channel, in the unit of the control."""
    high: tuple[float, ...]
    """Upper bound per channel, in the unit of the control."""
    num_rollouts: int = 500
    """S, number of roll-outs per plan, 3 to 100 000. The first is the nominal, the second is zero control, and the
    others are sampled. More gives less noisy plans and takes more time."""
    horizon: int = 30
    """T, number of time steps per roll-out, 1 to 1000. More looks further ahead and takes more time."""
    temperature: float = 0.7
    """lambda, in units of ``cost_scale`` times cost. Lower follows the best roll-outs, higher the mean of all."""
    cost_scale: float = 1.0
    """Factor on every cost before the temperature [1/unit of cost]. Larger has the effect of a lower temperature; 1
    uses the temperature as in the paper. With a cost in metres, the temperature 0.7 hardly distinguishes roll-outs that
    end 0.1 m apart."""
    noise_correlation: float = 0.8
    """Correlation of the noise between consecutive time steps, in [0, 1). The noise is a stationary AR(1) process with
    standard deviation ``sigma``. 0 is the white noise of Williams et al.; near 1 each roll-out has an almost constant
    perturbation."""

    def __post_init__(self) -> None:
        for name in ("sigma", "low", "high"):
            # Convert lists and arrays, which are not hashable.
            object.__setattr__(self, name, _numbers(name, getattr(self, name)))
        for name in ("low", "high"):
            count = len(getattr(self, name))
            if count != self.controls:
                raise ShmooError(
                    f"MppiConfig: {name} has {count} entries and sigma {self.controls}; give one per control channel."
                )
        # The upper limits are far above what is useful. Much more would need more memory than computers have.
        for name, least, most in (("num_rollouts", 3, 100_000), ("horizon", 1, 1000)):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or not least <= value <= most:
                raise ShmooError(f"MppiConfig: {name} is {value}; give a whole number from {least} to {most}.")
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
        """m, the number of control channels."""
        return len(self.sigma)


def _numbers(name: str, values: Iterable[float]) -> tuple[float, ...]:
    """Convert ``values`` to one finite number per control channel, or raise ShmooError."""
    try:
        numbers = tuple(float(value) for value in values)
    except (TypeError, ValueError):
        numbers = ()
    if not numbers or not all(map(math.isfinite, numbers)):
        raise ShmooError(f"MppiConfig: {name} is {values}; give one finite number per control channel.")
    return numbers
