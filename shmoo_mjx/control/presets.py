"""Settings of the pushing controller, and its presets."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from shmoo_mjx.control.cost import PushCost
from shmoo_mjx.control.governor import GovernorConfig
from shmoo_mjx.control.mppi_config import MppiConfig
from shmoo_mjx.control.obstacles import Margins
from shmoo_mjx.control.speed import SpeedProfile
from shmoo_mjx.learning.adaptation import AdaptConfig
from shmoo_mjx.learning.estimate import EstimateConfig


@dataclass(frozen=True)
class PushConfig:
    """Settings of the pushing controller; the paper's values where it gives them. The defaults push an object aside:
    its yaw does not count."""

    control: MppiConfig = MppiConfig(
        cost_scale=40.0,
        sigma=(0.04, 0.03, 0.20),
        low=(-0.15, -0.10, -0.45),
        high=(0.15, 0.10, 0.45),
        noise_correlation=0.9,
    )
    cost: PushCost = PushCost(
        yaw_weight=0.0,
        effort=0.002,
        change=0.01,
        running_weight=1.0,
        clearance_weight=15.0,
        lateral_weight=0.2,
        heading_weight=0.1,
        aim_weight=2.0,
        speed_weight=1.0,
        overspeed_weight=15.0,
    )
    speed: SpeedProfile = SpeedProfile(limit=0.25)
    margins: Margins = Margins(object=0.06, stride=3)
    estimate: EstimateConfig = EstimateConfig()
    """How contact parameters are learned (`online.Posterior`)."""
    adapt: AdaptConfig = field(default_factory=AdaptConfig)
    """How a psi without contact model learns (`online.Printed`)."""
    adapts: bool = True
    """False keeps the estimate of the object as it is, for comparison."""
    governor: GovernorConfig = GovernorConfig()
    """Bounds on the forward lean."""
    governor_room: float = 1.0
    """Largest distance of the plan below the governor's lean [rad]; more leaves more to the plan, 1 is no bound."""
    foresees_governor: bool = False
    """Roll-outs lean within the governor's present bounds too. Otherwise they foresee firmer pushes than there will be,
    and believe that steering turns what hardly resists."""

    def light(self) -> PushConfig:
        """The preset for small computers: these settings with 128 roll-outs in place of 500."""
        return replace(self, control=replace(self.control, num_rollouts=128))


def pose_push_config() -> PushConfig:
    """Settings for bringing an object to a pose: its yaw counts, and it has to stop at its goal."""
    base = PushConfig()
    return replace(
        base,
        # Small, slow noise: a plan that jumps about shakes what rolls off the hands.
        control=replace(base.control, sigma=(0.015, 0.012, 0.07), noise_correlation=0.95),
        cost=replace(
            base.cost,
            yaw_weight=0.6,
            change=0.03,
            lateral_weight=0.8,
            aim_weight=0.7,
            speed_weight=0.3,
            overspeed_weight=3.0,
        ),
        speed=SpeedProfile(limit=0.16, at_goal=0.07, slow_down=0.25),
        governor_room=0.04,
        foresees_governor=True,
    )


def printed_push_config() -> PushConfig:
    """Eq. 8 and 9 as printed, and Williams' white noise; numbers that the paper does not give are ours.

    Two additions remain, without which it can't run: ``cost_scale``, and the governor with its speed limit.
    """
    base = PushConfig()
    return replace(
        base,
        control=replace(base.control, noise_correlation=0.0),
        cost=PushCost(yaw_weight=1.0, effort=base.cost.effort, change=base.cost.change),
        margins=Margins(),
        # Labels are differences of noisy twists, whose errors are correlated: noise_scale is above 1.
        adapt=AdaptConfig(to_prior=False, outlier=math.inf, noise_scale=2.0),
    )
