"""Governor of the forward lean: a velocity loop with force feed-forward that bounds the commands of MPPI.

If an object sticks, a planner leans more and more until the object breaks away. The robot then falls forward with it,
because a push can not brake a rolling object. The governor keeps the lean near that of the velocity loop of the cascade
(Sec. III). The speed therefore stays near the allowed speed and the hands stay on the object, even if the model is
wrong. The loop has an integral term, so that an object that sticks just below the balancing lean does not stay stuck.

The functions are for one robot (vmap for more) and accept NumPy and JAX arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT, touches
from shmoo_mjx.plant.robot import shmoobot
from shmoo_mjx.types import DT

_INTEGRAL_GAIN = 0.1
"""Integral gain: lean per metre of lag behind the allowed speed [rad/m]. Larger pushes a stuck object harder sooner."""
INTEGRAL_LIMIT = 0.04
"""Upper limit of the integral state [rad], which corresponds to a force of 18 N."""


@dataclass(frozen=True)
class GovernorConfig:
    """Settings of the velocity loop."""

    gain: float = 0.25
    """Proportional gain: lean per m/s below the allowed speed [rad s/m]. Larger reaches that speed sooner; 0 disables
    the governor."""


def static_lean(force: Scalar | Float[Array, "..."]) -> Scalar | Float[Array, "..."]:
    """Lean [rad] that balances a forward force of the hands [N]: m g l phi = F h."""
    return force * HAND_HEIGHT / shmoobot().flatness[2]


def forward_lean(
    config: GovernorConfig, obs: ObjectObservation, limit: Scalar, integral: Scalar
) -> tuple[Scalar, Scalar]:
    """Lean [rad] that brings the robot to the speed ``limit`` against the sensed force, and the next ``integral``.

    The force feed-forward uses the whole sensed force at rest and 30 % of it at the allowed speed. At speed, most of
    the force may accelerate the object, and compensating it would diverge.

    Args:
        config: gains.
        obs: current observation.
        limit: allowed speed [m/s].
        integral: integral state of the velocity loop [rad]; 0 at the start of a push.
    """
    twist, rate = obs.robot_twist, obs.lean_rate
    xp, yaw = se2.array_module(obs.robot_pose, twist, rate, obs.wrench, limit, integral), obs.robot_pose[2]
    a, b, _ = shmoobot().flatness
    # Use the speed of the flat output, because the base first moves in the wrong direction when the lean changes.
    speed = se2.rotate(twist[:2], -yaw)[0] + b / a * rate[0]
    behind = xp.where(touches(obs.wrench), limit - speed, 0.0) * DT
    integral = xp.clip(integral + _INTEGRAL_GAIN * behind, 0.0, INTEGRAL_LIMIT)
    force = xp.maximum(se2.rotate(obs.wrench[:2], -yaw)[0], 0.0)
    share = 1.0 - 0.7 * xp.clip(speed / limit, 0.0, 1.0)
    return share * static_lean(force) + config.gain * (limit - speed) + integral, integral


def govern(u: Float[Array, "... 3"], low: Scalar, high: Scalar) -> Float[Array, "... 3"]:
    """``u`` (phi_x, phi_y, gamma) [rad] with its forward lean clipped to [``low``, ``high``]."""
    xp = se2.array_module(u, high)
    return xp.concatenate([xp.clip(u[..., :1], low, high), u[..., 1:]], axis=-1)
