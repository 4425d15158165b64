"""Pushing controllers for ablations: ours without one of its parts, to measure the effect of the part in closed loop.

Run: shmoo experiment pushing --condition-seed 25 --policies ours benchmarks.without:aim benchmarks.without:governor

The command must run in the root of the repository, as for any user's own controller. docs/results/ablations.md has the
results.
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
"""No cost of overspeed, and no slowing down before the goal."""
heading_and_overspeed = _changed(lambda config: _without_overspeed(config, heading_weight=0.0))
"""Both parts at once, because removing one of them changes little."""
governor = _changed(lambda config: replace(config, governor=replace(config.governor, gain=0.0)))
"""No bounds on the forward lean, in plan and command."""
governor_room = _changed(lambda config: replace(config, governor_room=1.0))
"""Only the upper bound of the governor."""
foresees_governor = _changed(lambda config: replace(config, foresees_governor=False))
"""Roll-outs without the bounds of the governor."""
running_lateral_foresees = _changed(
    lambda config: replace(
        config, foresees_governor=False, cost=replace(config.cost, running_weight=0.0, lateral_weight=0.0)
    )
)
"""All three parts at once, because removing one of them changes little."""
