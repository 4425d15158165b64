"""Low-level control of Shmoobot (Sec. III): one pure function for all engines and batch shapes.

The cascade has four parts. A reference filter smooths the lean command. One PID per plane turns the lean error into
drive torque, with friction compensation and a feed-forward of the arms' CoM offset. A P controller on heading with an
inner PI controller on yaw rate turns the robot. A Cartesian impedance holds each hand at the target that the steering
rule gives. The functions accept NumPy arrays (C MuJoCo) and JAX arrays (MJX).
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
    """Gains and limits of the low-level control, SI units."""

    lean_p: float = 600.0
    """Drive torque per lean error [N m/rad]."""
    lean_i: float = 300.0
    """Drive torque per integral of the lean error [N m/(rad s)]."""
    lean_d: float = 120.0
    """Drive torque per lean rate error [N m s/rad]."""
    friction_compensation: float = 0.8
    """Fraction of the nominal drive friction that is compensated by feed-forward."""
    friction_speed: float = 0.2
    """Drive rate scale of the Coulomb compensation's tanh [rad/s]; larger values give a smoother sign change."""
    lean_limit: float = 0.2
    """Largest commanded lean [rad]."""
    lean_bandwidth: float = 8.0
    """Natural frequency of the critically damped filter of the lean command [rad/s]; larger values respond faster."""
    lean_integral_limit: float = 0.08
    """Bound of the integral of the lean error [rad s]."""
    com_feed_forward: float = 1.0
    """Fraction of the arms' CoM offset that is subtracted from the lean command; 0 switches the feed-forward off."""
    yaw_p: float = 2.0
    """Yaw rate per heading error [1/s]."""
    yaw_rate_p: float = 8.0
    """Yaw torque per yaw rate error [N m s/rad]."""
    yaw_rate_i: float = 8.0
    """Yaw torque per integral of the yaw rate error [N m/rad]."""
    yaw_integral_share: float = 0.5
    """Largest fraction of the yaw torque limit that the integral term may use."""
    yaw_rate_limit: float = 0.8
    """Largest yaw rate that the heading loop commands [rad/s]."""
    yaw_torque_limit: float = 3.0
    """Largest yaw torque [N m]. The ball slips on the floor above about 3.7 N m (torsional friction)."""
    hand_stiffness: float = 600.0
    """Stiffness of the hands' Cartesian impedance [N/m]."""
    hand_damping: float = 40.0
    """Damping of the hands' Cartesian impedance [N s/m]."""
    hand_speed: float = 0.6
    """Rate limit of the hands' reach and height [m/s]. The steering angle's limit is 2.5 times this value [rad/s]."""
    arm_torque_limit: float = 60.0
    """Largest torque of each arm joint [N m]."""
    velocity_p: float = 0.16
    """Lean command per velocity error in the outer loop [rad s/m]."""


class LowLevelState(NamedTuple):
    """State of the low-level control."""

    lean_ref: Float[Array, "... 2"]
    """Filtered lean command [rad]."""
    lean_ref_rate: Float[Array, "... 2"]
    """Rate of the filtered lean command [rad/s]."""
    lean_integral: Float[Array, "... 2"]
    """Integral of the lean error [rad s]."""
    yaw_integral: Scalar | Float[Array, "..."]
    """Integral of the yaw rate error [rad]."""
    reach: Scalar | Float[Array, "..."]
    """Rate-limited reach of the hands [m]."""
    hand_height: Scalar | Float[Array, "..."]
    """Rate-limited height of the hands above the floor [m]."""
    gamma: Scalar | Float[Array, "..."]
    """Rate-limited steering angle [rad]."""


def init(xp: Any, batch: tuple[int, ...], reach: float, hand_height: float) -> LowLevelState:
    """Control state of a robot at rest.

    Args:
        xp: numpy or jax.numpy.
        batch: batch shape.
        reach: reach of the hands [m].
        hand_height: height of the hands above the floor [m].
    """
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
    """Lean command of the outer velocity loop.

    The loop regulates the velocity of the flat output S = x + (b/a) phi. The base velocity itself is not used, because
    the base first moves the wrong way when the lean changes (non-minimum phase).

    Args:
        gains: gains of the low-level control.
        velocity: velocity of the base in {R} [m/s].
        lean_rate: lean rate [rad/s].
        desired: desired velocity in {R} [m/s].
        robot: robot whose flat output is used, by default Shmoobot.

    Returns:
        Lean command [rad].
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
    # The CoM of the extended arms is ahead of the body axis, so the axis must lean back by that angle.
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
    # A lean towards +x is a rotation about +y, a lean towards +y one about -x. The torque acts on the ball, so a body
    # rotation to the left needs a torque to the right.
    planar = xp.stack([-effort[..., 1], effort[..., 0]], axis=-1) + gains.friction_compensation * friction
    planar = xp.clip(planar, -robot.drive_limit, robot.drive_limit)
    torque = xp.concatenate([planar, -turn[..., None]], axis=-1)
    return state._replace(lean_integral=integral, yaw_integral=yaw_integral), torque


def _arm_torque(robot: Robot, gains: Gains, state: LowLevelState, sensed: RobotState) -> Array:
    """Joint torques tau = J^T (K (p_des - p) - D v) + gravity compensation [N m], ``[..., 2, 3]``."""
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
    """Joint torques that hold the arms against gravity [N m], for a body that leans forward by ``lean`` [rad]."""
    xp = se2.array_module(arms)
    g, l1, l2 = 9.81, robot.upper_arm, robot.forearm
    pitch, fore = arms[..., 1] + lean, arms[..., 1] + arms[..., 2] + lean
    elbow = -g * l2 * xp.cos(fore) * (robot.forearm_mass / 2 + robot.hand_mass)
    shoulder = elbow - g * l1 * xp.cos(pitch) * (robot.upper_arm_mass / 2 + robot.forearm_mass + robot.hand_mass)
    return se2.stack(xp.zeros_like(elbow), shoulder, elbow)


def control(
    robot: Robot, gains: Gains, state: LowLevelState, sensed: RobotState, *, command: Command, dt: float
) -> tuple[LowLevelState, Float[Array, "... 9"]]:
    """One period of the low-level control.

    Args:
        robot: nominal robot parameters.
        gains: gains of the control.
        state: control state.
        sensed: robot state.
        command: command to follow.
        dt: control period [s].

    Returns:
        The new state, and the motor torques [N m] in the order of ``ACTUATORS``: drive x, y, z in the body frame, then
            left and right arm (yaw, pitch, elbow).
    """
    xp = se2.array_module(state.gamma, sensed.lean)
    state = _references(gains, state, command, dt)
    state, drive = _drive_torque(robot, gains, state, sensed, yaw=command.yaw, dt=dt)
    arms = _arm_torque(robot, gains, state, sensed)
    return state, xp.concatenate([drive, arms.reshape(*arms.shape[:-2], 6)], axis=-1)
