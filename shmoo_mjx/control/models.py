"""The learned core as a model for MPPI."""

from __future__ import annotations

from shmoo_mjx.control.mppi import RolloutFn
from shmoo_mjx.dynamics import core
from shmoo_mjx.dynamics.core import CoreConfig, Params


def learned(params: Params, config: CoreConfig | None = None) -> RolloutFn:
    """R and psi a, with the coefficients that ``params`` holds: (SystemState, controls ``[S, T, 3]``) -> ``[S, T]``."""
    return lambda state, controls: core.rollout(params, state, controls, config)[0]
