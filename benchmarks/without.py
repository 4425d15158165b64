"""Ours without one of its parts, as pushing controllers: what each part brings with the loop closed.

Run: shmoo experiment pushing --condition-seed 25 --policies ours benchmarks.without:aim benchmarks.without:governor

From the repository's root, like any controller of one's own. What came of it stands in docs/paper_map.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from shmoo_mjx.control.pushing import PushConfig, PushController
from shmoo_mjx.learning.weights import Weights

Make = Callable[[Weights, PushConfig], PushController]


def _without(**terms: float) -> Make:
    """Ours with other values of `PushCost`."""
    return lambda weights, config: PushController(weights, replace(config, cost=replace(config.cost, **terms)))


running, lateral, heading, aim, speed = (
    _without(**{f"{term}_weight": 0.0}) for term in ("running", "lateral", "heading", "aim", "speed")
)
overspeed = _without(overspeed_weight=0.0, slow_down=0.0)
"""Neither what speeding costs nor the governor's slowing down before the goal."""


def governor(weights: Weights, config: PushConfig) -> PushController:
    """No bounds on the forward lean, in plan and command."""
    return PushController(weights, replace(config, governor=replace(config.governor, gain=0.0)))


def governor_room(weights: Weights, config: PushConfig) -> PushController:
    """The governor's upper bound alone."""
    return PushController(weights, replace(config, governor_room=1.0))


def foresees_governor(weights: Weights, config: PushConfig) -> PushController:
    """Roll-outs that lean as far as they like."""
    return PushController(weights, replace(config, foresees_governor=False))
