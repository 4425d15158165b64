"""Governor on the forward lean: a velocity loop with force feed-forward that bounds what MPPI may command.

An object that sticks makes a planner lean harder until it breaks away, and then the robot falls forward with it: what
rolls can't be braked by pushing. The governor keeps the lean near that of the cascade's velocity loop (Sec. III), so
that the speed stays where it was allowed and the hands stay on the object, whatever the model believes. Like any
velocity loop it has an integral: what sticks just below the lean that balances what is felt would be stuck for good.
For one robot, on NumPy and JAX arrays alike; vmap for more.
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
"""Lean per metre by which the robot lags behind the speed allowed [rad/m]: what sticks is leant into within seconds."""
INTEGRAL_LIMIT = 0.04
"""Largest lean that comes of lagging behind [rad]: 18 N."""


@dataclass(frozen=True)
class GovernorConfig:
    """Gain of the velocity loop."""

    gain: float = 0.25
    """Lean per m/s left to the speed allowed [rad s/m]; 0 switches the governor off, more reaches that speed
    sooner."""


def static_lean(force: Scalar | Float[Array, "..."]) -> Scalar | Float[Array, "..."]:
    """Lean [rad] that balances a forward force [N] of the hands: m g l phi = F h."""
    return force * HAND_HEIGHT / shmoobot().flatness[2]


def forward_lean(
    config: GovernorConfig, obs: ObjectObservation, limit: Scalar, integral: Scalar
) -> tuple[Scalar, Scalar]:
    """Lean [rad] that brings the robot to the speed ``limit`` against what it feels, and the next ``integral``.

    At rest the whole felt force counts as resistance, at the speed allowed less than a third of it: by then most of it
    may be what accelerates the object, and leaning into that would diverge.

    Args:
        config: gains.
        obs: what is perceived now.
        limit: speed allowed [m/s].
        integral: state of the velocity loop [rad]; 0 at the start of a push.
    """
    twist, rate = obs.robot_twist, obs.lean_rate
    xp, yaw = se2.array_module(obs.robot_pose, twist, rate, obs.wrench, limit, integral), obs.robot_pose[2]
    a, b, _ = shmoobot().flatness
    # Speed of the flat output: the base first moves the wrong way when the lean changes.
    speed = se2.rotate(twist[:2], -yaw)[0] + b / a * rate[0]
    behind = xp.where(touches(obs.wrench), limit - speed, 0.0) * DT
    integral = xp.clip(integral + _INTEGRAL_GAIN * behind, 0.0, INTEGRAL_LIMIT)
    force = xp.maximum(se2.rotate(obs.wrench[:2], -yaw)[0], 0.0)
    share = 1.0 - 0.7 * xp.clip(speed / limit, 0.0, 1.0)
    return share * static_lean(force) + config.gain * (limit - speed) + integral, integral


def govern(u: Float[Array, "... 3"], low: Scalar, high: Scalar) -> Float[Array, "... 3"]:
    """``u`` (phi_x, phi_y, gamma) [rad] with its forward lean within ``low`` and ``high``."""
    xp = se2.array_module(u, high)
    return xp.concatenate([xp.clip(u[..., :1], low, high), u[..., 1:]], axis=-1)
