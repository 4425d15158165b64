"""The learned dynamics model in the form for MPPI."""

from __future__ import annotations

from shmoo_mjx.control.mppi import RolloutFn
from shmoo_mjx.dynamics import core
from shmoo_mjx.dynamics.core import CoreConfig, Params


def learned(params: Params, config: CoreConfig | None = None) -> RolloutFn:
    """Roll-out function of R and psi a: from a SystemState and controls ``[S, T, 3]`` to a SystemState ``[S, T]``.

    ``params`` includes the coefficients a.
    """
    return lambda state, controls: core.rollout(params, state, controls, config)[0]
