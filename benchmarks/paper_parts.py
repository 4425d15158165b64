"""Pushing controllers of the paper's system with one part changed: without each of its two additions to MPPI, and
without its white noise.

Run: shmoo experiment pushing --quick --condition-seed 25 --policies paper benchmarks.paper_parts:metres ...

The command must run in the root of the repository, as for any user's own controller. docs/paper_system.md has the
results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from shmoo_mjx.behavior.methods import METHODS
from shmoo_mjx.control.governor import GovernorConfig
from shmoo_mjx.control.presets import PushConfig
from shmoo_mjx.control.pushing import PushController

_PAPER = METHODS["paper"]
Make = Callable[[Any, PushConfig], PushController]


def _with(config: PushConfig) -> Make:
    return lambda weights, other: PushController(_PAPER.load(), config)


def _control(**settings: Any) -> PushConfig:
    return replace(_PAPER.pose_pushing, control=replace(_PAPER.pose_pushing.control, **settings))


metres = _with(_control(cost_scale=1.0))
"""The temperature of 0.7 acts on Eq. 9 in metres."""
governor = _with(replace(_PAPER.pose_pushing, governor=GovernorConfig(gain=0.0)))
"""No bounds on the forward lean."""
white = _with(_control(noise_correlation=0.9))
"""Noise that is correlated in time, as in ours."""
