"""Low-level control of Shmoobot (Sec. III), one functional implementation for every engine and batch shape.

Cascade: the lean command passes a reference filter, a PID per plane turns lean error into drive torque with friction
compensation, a PI on yaw rate under a P on heading turns the robot, and each hand is held by a Cartesian impedance at
the place the steering rule gives. The CoM offset of the arms is subtracted from the lean command (feed-forward).
Everything works on NumPy and JAX arrays alike; C MuJoCo runs it with the former, MJX with the latter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from shmoo_mjx.arrays import Array, ArrayT, Float, Scalar
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import hand_targets
from shmoo_mjx.plant.robot import Robot, RobotState, shmoobot
from shmoo_mjx.types import Command


@dataclass(frozen=True)
class Gains:
    """Gains of the low-level control, SI units."""

    lean_p: float = 600.0
    lean_i: float = 300.0
    lean_d: float = 120.0
    friction_compensation: float = 0.8
    """Share of the nominal drive friction that is fed forward."""
    friction_speed: float = 0.2
    """Drive rate over which the Coulomb compensation changes sign [rad/s]."""
    lean_limit: float = 0.2
    """Largest commanded lean [rad]."""
    lean_bandwidth: float = 8.0
    """Natural frequency of the critically damped reference filter of the lean command [rad/s]."""
    lean_integral_limit: float = 0.08
    """Bound of the integral of the lean error [rad s]."""
    com_feed_forward: float = 1.0
    """Share of the arms' CoM offset that is subtracted from the lean command; 0 switches the feed-forward off."""
    yaw_p: float = 2.0
    yaw_rate_p: float = 8.0
    yaw_rate_i: float = 8.0
    yaw_integral_share: float = 0.5
    """Share of the yaw torque limit that the integral may take."""
    yaw_rate_limit: float = 0.8
    yaw_torque_limit: float = 3.0
    """Below what the ball's contact patch holds by torsional friction (about 3.7 N m)."""
    hand_stiffness: float = 600.0
    hand_damping: float = 40.0
    hand_speed: float = 0.6
    """Rate limit of the hands' reach and height [m/s] and of the steering angle [rad/s, 2.5 times this]."""
    arm_torque_limit: float = 60.0
    velocity_p: float = 0.16
    """Outer loop: lean per velocity error [rad s/m]."""


class LowLevelState(NamedTuple):
    """State of the low-level control."""

    lean_ref: Float[Array, "... 2"]
    """Filtered lean command [rad]."""
    lean_ref_rate: Float[Array, "... 2"]
    """[rad/s]"""
    lean_integral: Float[Array, "... 2"]
    """[rad s]"""
    yaw_integral: Scalar | Float[Array, "..."]
    """[rad]"""
    reach: Scalar | Float[Array, "..."]
    """[m]"""
    hand_height: Scalar | Float[Array, "..."]
    """[m]"""
    gamma: Scalar | Float[Array, "..."]
    """[rad]"""


def init(xp: Any, batch: tuple[int, ...], reach: float, hand_height: float) -> LowLevelState:
    """State at rest; ``xp`` is numpy or jax.numpy."""
    pair, scalar = xp.zeros((*batch, 2)), xp.zeros(batch)
    return LowLevelState(pair, pair, pair, scalar, scalar + reach, scalar + hand_height, scalar)


def velocity_to_lean(
    gains: Gains,
    velocity: Float[ArrayT, "... 2"],
    lean_rate: Float[ArrayT, "... 2"],
    desired: Float[ArrayT, "... 2"],
    *,
    robot: Robot | None = None,
) -> Float[ArrayT, "... 2"]:
    """Outer loop of the cascade: lean command [rad] from velocities in {R} [m/s].

    Regulates the velocity of the flat output S = x + (b/a) phi: the base itself first moves the wrong way when the lean
    changes, which a tight loop on it would amplify. The robot is Shmoobot unless another is given.
    """
    xp = se2.array_module(velocity, desired)
    a, b, _ = (robot or shmoobot()).flatness
    flat = velocity + b / a * lean_rate
    return xp.clip(gains.velocity_p * (desired - flat), -gains.lean_limit, gains.lean_limit)


def _towards(
    xp: Any, value: Scalar | Float[Array, "..."], target: Scalar | Float[Array, "..."], step: float
) -> Scalar | Float[Array, "..."]:
    return value + xp.clip(target - value, -step, step)


def _references(gains: Gains, state: LowLevelState, command: Command, dt: float) -> LowLevelState:
    xp = se2.array_module(state.gamma, command.u)
    wanted = xp.clip(command.u[..., :2], -gains.lean_limit, gains.lean_limit)
    w = gains.lean_bandwidth
    rate = state.lean_ref_rate + dt * (w * w * (wanted - state.lean_ref) - 2 * w * state.lean_ref_rate)
    return state._replace(
        lean_ref=state.lean_ref + dt * rate,
        lean_ref_rate=rate,
        reach=_towards(xp, state.reach, command.reach, gains.hand_speed * dt),
        hand_height=_towards(xp, state.hand_height, command.hand_height, gains.hand_speed * dt),
        gamma=_towards(xp, state.gamma, command.u[..., 2], 2.5 * gains.hand_speed * dt),
    )


def _drive_torque(
    robot: Robot,
    gains: Gains,
    state: LowLevelState,
    sensed: RobotState,
    *,
    yaw: Scalar | Float[Array, "..."],
    dt: float,
) -> tuple[LowLevelState, Array]:
    xp = se2.array_module(state.gamma, sensed.lean)
    # The CoM of the extended arms lies ahead of the body axis: lean the axis back by that angle.
    offset = gains.com_feed_forward * robot.com_offset(sensed.arms) / robot.body_com_height
    error = sensed.lean + offset - state.lean_ref
    limit = gains.lean_integral_limit
    integral = xp.clip(state.lean_integral + error * dt, -limit, limit)
    effort = gains.lean_p * error + gains.lean_i * integral + gains.lean_d * (sensed.lean_rate - state.lean_ref_rate)
    heading_error = se2.wrap(yaw - sensed.pose[..., 2])
    rate_error = (
        xp.clip(gains.yaw_p * heading_error, -gains.yaw_rate_limit, gains.yaw_rate_limit) - sensed.twist[..., 2]
    )
    yaw_limit = gains.yaw_torque_limit
    wind_up = gains.yaw_integral_share * yaw_limit / gains.yaw_rate_i
    yaw_integral = xp.clip(state.yaw_integral + rate_error * dt, -wind_up, wind_up)
    turn = xp.clip(gains.yaw_rate_p * rate_error + gains.yaw_rate_i * yaw_integral, -yaw_limit, yaw_limit)
    rate = sensed.drive_rate[..., :2]
    friction = robot.drive_coulomb * xp.tanh(rate / gains.friction_speed) + robot.drive_viscous * rate
    # A lean towards +x turns about +y and one towards +y about -x; the torque acts on the ball, so turning the body
    # left asks for a torque to the right.
    planar = xp.stack([-effort[..., 1], effort[..., 0]], axis=-1) + gains.friction_compensation * friction
    planar = xp.clip(planar, -robot.drive_limit, robot.drive_limit)
    torque = xp.concatenate([planar, -turn[..., None]], axis=-1)
    return state._replace(lean_integral=integral, yaw_integral=yaw_integral), torque


def _arm_torque(robot: Robot, gains: Gains, state: LowLevelState, sensed: RobotState) -> Array:
    """tau = J^T (K (p_des - p) - D v) + gravity compensation, ``[..., 2, 3]``."""
    xp = se2.array_module(state.gamma, sensed.arms)
    target = hand_targets(state.gamma, state.reach)
    height = xp.broadcast_to((state.hand_height - sensed.height)[..., None, None], (*target.shape[:-1], 1))
    target = xp.concatenate([target, height], axis=-1)
    target = xp.einsum("...ji,...hj->...hi", sensed.rotation, target)
    jacobian = robot.arm_jacobian(sensed.arms)
    velocity = xp.einsum("...ij,...j->...i", jacobian, sensed.arm_rates)
    force = gains.hand_stiffness * (target - robot.hand_in_body(sensed.arms)) - gains.hand_damping * velocity
    torque = xp.einsum("...ij,...i->...j", jacobian, force) + arm_gravity(robot, sensed.arms)
    return xp.clip(torque, -gains.arm_torque_limit, gains.arm_torque_limit)


def arm_gravity(
    robot: Robot, arms: Float[Array, "... 2 3"], lean: Scalar | Float[Array, "... 1"] = 0.0
) -> Float[Array, "... 2 3"]:
    """Joint torques [N m] that hold the arms against gravity, on a body that leans forward by ``lean`` [rad]."""
    xp = se2.array_module(arms)
    g, l1, l2 = 9.81, robot.upper_arm, robot.forearm
    pitch, fore = arms[..., 1] + lean, arms[..., 1] + arms[..., 2] + lean
    elbow = -g * l2 * xp.cos(fore) * (robot.forearm_mass / 2 + robot.hand_mass)
    shoulder = elbow - g * l1 * xp.cos(pitch) * (robot.upper_arm_mass / 2 + robot.forearm_mass + robot.hand_mass)
    return se2.stack(xp.zeros_like(elbow), shoulder, elbow)


def control(
    robot: Robot, gains: Gains, state: LowLevelState, sensed: RobotState, *, command: Command, dt: float
) -> tuple[LowLevelState, Float[Array, "... 9"]]:
    """One control period of ``dt`` seconds.

    Returns:
        The new state and the motor torques [N m] in the order of ``ACTUATORS``: drive x, y, z in the body
        frame, then left and right arm (yaw, pitch, elbow).
    """
    xp = se2.array_module(state.gamma, sensed.lean)
    state = _references(gains, state, command, dt)
    state, drive = _drive_torque(robot, gains, state, sensed, yaw=command.yaw, dt=dt)
    arms = _arm_torque(robot, gains, state, sensed)
    return state, xp.concatenate([drive, arms.reshape(*arms.shape[:-2], 6)], axis=-1)
