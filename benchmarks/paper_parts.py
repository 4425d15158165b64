"""The paper's system with one part changed, as pushing controllers: what each addition to it brings, and what the one
addition that it has is there for.

Run: shmoo experiment pushing --quick --condition-seed 25 --policies paper benchmarks.paper_parts:metres ...

From the repository's root, like any controller of one's own. What came of it stands in docs/paper_system.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from shmoo_mjx.control.governor import GovernorConfig
from shmoo_mjx.control.pushing import PushConfig, PushController
from shmoo_mjx.methods import METHODS

_PAPER = METHODS["paper"]
Make = Callable[[Any, PushConfig], PushController]


def _with(config: PushConfig) -> Make:
    return lambda weights, other: PushController(_PAPER.load(), config)


def _control(**settings: float) -> PushConfig:
    return replace(_PAPER.pose_pushing, control=replace(_PAPER.pose_pushing.control, **settings))


metres = _with(_control(cost_scale=1.0))
"""The temperature of 0.7 acts on Eq. 9 in metres."""
smooth = _with(_control(noise_correlation=0.9))
"""Noise that is correlated in time."""
governor = _with(replace(_PAPER.pose_pushing, governor=GovernorConfig()))
"""Bounds on the forward lean."""
both = _with(replace(_control(noise_correlation=0.9), governor=GovernorConfig()))
"""Correlated noise and the governor."""
