"""Ours without one of its parts, as pushing controllers: what each part brings with the loop closed.

Run: shmoo experiment pushing --condition-seed 25 --policies ours benchmarks.without:aim benchmarks.without:governor

From the repository's root, like any controller of one's own. docs/results/ablations.md has the results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from shmoo_mjx.control.presets import PushConfig
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.learning.weights import Weights

Make = Callable[[Weights, PushConfig], PushController]


def _changed(change: Callable[[PushConfig], PushConfig]) -> Make:
    return lambda weights, config: PushController(weights, change(config))


def _cost(**terms: float) -> Make:
    return _changed(lambda config: replace(config, cost=replace(config.cost, **terms)))


running, lateral, heading, aim, speed = (
    _cost(**{f"{term}_weight": 0.0}) for term in ("running", "lateral", "heading", "aim", "speed")
)


def _without_overspeed(config: PushConfig, **terms: float) -> PushConfig:
    cost = replace(config.cost, overspeed_weight=0.0, **terms)
    return replace(config, cost=cost, speed=replace(config.speed, slow_down=0.0))


overspeed = _changed(_without_overspeed)
"""Neither what speeding costs nor the governor's slowing down before the goal."""
heading_and_overspeed = _changed(lambda config: _without_overspeed(config, heading_weight=0.0))
"""Each of the two is hardly missed."""
governor = _changed(lambda config: replace(config, governor=replace(config.governor, gain=0.0)))
"""No bounds on the forward lean, in plan and command."""
governor_room = _changed(lambda config: replace(config, governor_room=1.0))
"""The governor's upper bound alone."""
foresees_governor = _changed(lambda config: replace(config, foresees_governor=False))
"""Roll-outs that lean as far as they like."""
running_lateral_foresees = _changed(
    lambda config: replace(
        config, foresees_governor=False, cost=replace(config.cost, running_weight=0.0, lateral_weight=0.0)
    )
)
"""Each of the three is hardly missed."""
