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
    """Settings of the pushing controller, with the paper's values where it gives them.

    The defaults are for pushing an object aside, without a goal for its yaw.
    """

    control: MppiConfig = MppiConfig(
        cost_scale=40.0,
        sigma=(0.04, 0.03, 0.20),
        low=(-0.15, -0.10, -0.45),
        high=(0.15, 0.10, 0.45),
        noise_correlation=0.9,
    )
    """Settings of MPPI."""
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
    """Weights of the cost terms."""
    speed: SpeedProfile = SpeedProfile(limit=0.25)
    """Allowed speed of the robot."""
    margins: Margins = Margins(object=0.06, stride=3)
    """Margins to obstacles."""
    estimate: EstimateConfig = EstimateConfig()
    """Settings of the contact parameter estimate (`online.Posterior`)."""
    adapt: AdaptConfig = field(default_factory=AdaptConfig)
    """Settings of the adaptation of a psi without the contact model (`online.Printed`)."""
    adapts: bool = True
    """Update the estimate of the object during a push. False is for comparison."""
    governor: GovernorConfig = GovernorConfig()
    """Settings of the governor, which bounds the forward lean."""
    governor_room: float = 1.0
    """Largest distance of the commanded lean below the governor's lean [rad]. Larger gives the plan more freedom; 1
    means no lower bound from the governor."""
    foresees_governor: bool = False
    """Apply the governor's current bounds in roll-outs too. Without them, roll-outs assume stronger pushes than the
    governor allows, and overestimate how much steering turns an object with little resistance."""

    def light(self) -> PushConfig:
        """These settings with 128 roll-outs instead of 500, for small computers."""
        return replace(self, control=replace(self.control, num_rollouts=128))


def pose_push_config() -> PushConfig:
    """Settings for pushing an object to a pose: its yaw counts, and it must stop at its goal."""
    base = PushConfig()
    return replace(
        base,
        # Small, slowly varying noise, because abrupt changes of the plan shake rolling objects off the hands.
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
    """Settings with Eq. 8 and 9 as printed and the white noise of Williams et al.

    Values that the paper does not give are our own. Two additions remain because the controller does not work without
    them: ``cost_scale``, and the governor with its speed limit.
    """
    base = PushConfig()
    return replace(
        base,
        control=replace(base.control, noise_correlation=0.0),
        cost=PushCost(yaw_weight=1.0, effort=base.cost.effort, change=base.cost.change),
        margins=Margins(),
        # noise_scale is above 1 because labels are differences of noisy twists, whose errors are correlated.
        adapt=AdaptConfig(to_prior=False, outlier=math.inf, noise_scale=2.0),
    )
