"""Estimate of the robot's pose: odometry that drifts, and a localiser that corrects the drift with the map.

The frames follow ROS REP 105. {D} is the odometry frame, in which the robot's pose is continuous but drifts. The
localiser estimates the pose of {D} in {W}. It changes this estimate slowly, so the robot's pose in {W} does not jump.
Object tracks (sensing/tracker.py) are kept in {D}, so a correction does not look like a motion of an object.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Int, Scalar, Shaped
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2

TICK = 0.01
"""Sensor period [s]. Delays are rounded to multiples of it."""


@dataclass(frozen=True)
class OdometryConfig:
    """Errors of odometry and localiser.

    The odometry is visual-inertial with the ball's encoders (T265 class, whose data sheet gives a drift below 1 % of
    the travelled distance). The localiser is a scan matcher (AMCL class, with an accuracy of a few cm). How the drift
    is divided among its causes is an estimate.
    """

    scale: float = 0.006
    """Standard deviation of the relative length error, drawn per robot. Larger values increase the drift with travelled
    distance."""
    yaw_scale: float = 0.005
    """Standard deviation of the relative turning error, drawn per robot. Larger values increase the drift with turned
    angle."""
    yaw_bias: float = float(np.deg2rad(0.02))
    """Standard deviation of the yaw drift rate, drawn per robot [rad/s]: the remaining gyro bias. Larger values bend
    the estimated path more."""
    walk: float = 0.006
    """Standard deviation of the position's random walk per root of travelled distance [m / sqrt(m)]."""
    yaw_walk: float = float(np.deg2rad(0.06))
    """Standard deviation of the yaw's random walk per root of time [rad / sqrt(s)]."""
    delay: tuple[float, float] = (0.02, 0.04)
    """Range of a pose's age on arrival, drawn per robot [s]. The estimate extrapolates the pose by the twist."""
    smoothing: float = 0.03
    """Time constant of the low-pass filter of pose differences, which gives the twist [s]. Larger values make the twist
    smoother and more delayed."""
    localised: bool = True
    """Whether the localiser corrects the pose. Without it, the drift is unbounded."""
    fix_period: tuple[float, float] = (0.5, 1.0)
    """Range of the time between two fixes of the localiser, drawn per robot [s]. For comparison, AMCL updates every
    0.2 m or 0.5 rad."""
    fix_position: float = 0.025
    """Standard deviation of a fix's position [m]; the default is half a cell of a 5 cm map."""
    fix_yaw: float = float(np.deg2rad(0.5))
    """Standard deviation of a fix's yaw [rad]."""
    fix_delay: float = 0.1
    """Age of a fix on arrival [s], due to the time for scan matching."""
    fix_gain: float = 0.25
    """Fraction of a fix's innovation that is applied. Larger values follow both the drift and the fixes' noise
    faster."""
    blend: float = 0.03
    """Largest rate of position corrections [m/s]; the default gives 3 mm per sample. Larger values cause larger jumps
    of the robot's pose."""
    blend_yaw: float = float(np.deg2rad(1.0))
    """Largest rate of yaw corrections [rad/s]. Larger values cause larger jumps of the robot's pose."""

    def __post_init__(self) -> None:
        for name in ("delay", "fix_period"):
            low, high = getattr(self, name)
            if not (0 if name == "delay" else TICK) <= low <= high:
                raise ShmooError(f"OdometryConfig: {name} is {low:g} to {high:g} s; give the smaller time first.")
        for name in ("scale", "yaw_scale", "yaw_bias", "walk", "yaw_walk", "smoothing", "fix_position", "fix_yaw"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ShmooError(f"OdometryConfig: {name} is {getattr(self, name)}; give a number of 0 or more.")


class OdometryDraw(NamedTuple):
    """Odometry parameters drawn from the seeds, for W robots or one."""

    scale: Float[Array, "..."]
    """Relative length error."""
    yaw_scale: Float[Array, "..."]
    """Relative turning error."""
    yaw_bias: Float[Array, "..."]
    """Yaw drift rate [rad/s]."""
    delay: Int[Array, "..."]
    """Age of a pose on arrival [ticks]."""
    fix_period: Int[Array, "..."]
    """Time between two fixes [ticks]."""


class Odometry(NamedTuple):
    """State of odometry and localiser for W robots. Histories have L ticks, the newest last."""

    true: Float[Array, "W L 3"]
    """True poses of {R} in {W} [m, rad]. The simulated sensors measure them; they are never reported directly."""
    pose: Float[Array, "W L 3"]
    """Odometry poses of {R} in {D} [m, rad]."""
    twist: Float[Array, "W 3"]
    """Filtered twist in {D} at the newest pose that has arrived [m/s, rad/s]."""
    frame: Float[Array, "W 3"]
    """The localiser's estimate of the pose of {D} in {W} [m, rad]."""
    correction: Float[Array, "W 3"]
    """Remaining correction of the robot's pose in {W}, applied gradually [m, rad]."""


def draw(config: OdometryConfig, rng: np.random.Generator) -> OdometryDraw:
    """Draw the odometry parameters of one robot."""
    normal, unit = rng.normal(size=3), rng.random(2)
    late = config.delay[0] + (config.delay[1] - config.delay[0]) * unit[0]
    period = config.fix_period[0] + (config.fix_period[1] - config.fix_period[0]) * unit[1]
    return OdometryDraw(
        np.array(config.scale * normal[0]),
        np.array(config.yaw_scale * normal[1]),
        np.array(config.yaw_bias * normal[2]),
        np.array(round(late / TICK)),
        np.array(max(round(period / TICK), 1)),
    )


def init(robot_pose: Float[Array, "W 3"], length: int) -> Odometry:
    """Initial state of robots at rest at the known poses ``robot_pose`` in {W}, with histories of ``length`` ticks."""
    xp = se2.array_module(robot_pose)
    true = xp.repeat(robot_pose[:, None], length, axis=1)
    zero = xp.zeros_like(robot_pose)
    return Odometry(true, xp.zeros_like(true), zero, robot_pose, zero)


def step(
    config: OdometryConfig,
    drawn: OdometryDraw,
    state: Odometry,
    robot_pose: Float[Array, "W 3"],
    *,
    noise: Float[Array, "W 6"],
    now: Scalar,
) -> Odometry:
    """Advance odometry and localiser by one tick.

    Args:
        config: error parameters.
        drawn: drawn parameters of the robots.
        state: state before the tick.
        robot_pose: true robot poses in {W} after the tick [m, rad].
        noise: standard normal numbers, three for the random walk and three for a fix.
        now: number of the tick.
    """
    xp = se2.array_module(robot_pose, noise, state.pose)
    moved = se2.relative(state.true[:, -1], robot_pose)
    way = xp.sqrt(xp.sum(moved[:, :2] ** 2, axis=-1, keepdims=True))
    planar = moved[:, :2] * (1 + drawn.scale[:, None]) + config.walk * xp.sqrt(way) * noise[:, :2]
    turn = moved[:, 2] * (1 + drawn.yaw_scale) + drawn.yaw_bias * TICK + config.yaw_walk * TICK**0.5 * noise[:, 2]
    pose = se2.compose(state.pose[:, -1], xp.concatenate([planar, turn[:, None]], axis=-1))
    state = state._replace(
        true=xp.concatenate([state.true[:, 1:], robot_pose[:, None]], axis=1),
        pose=xp.concatenate([state.pose[:, 1:], pose[:, None]], axis=1),
    )
    arrived, before = ago(state.pose, drawn.delay), ago(state.pose, drawn.delay + 1)
    keep = np.exp(-TICK / config.smoothing) if config.smoothing > 0 else 0.0
    state = state._replace(twist=keep * state.twist + (1 - keep) * (arrived - before) / TICK)
    return _localise(config, drawn, state, noise=noise[:, 3:], now=now) if config.localised else state


def _localise(config: OdometryConfig, drawn: OdometryDraw, state: Odometry, *, noise: Array, now: Scalar) -> Odometry:
    """Take in a fix where one is due, and apply a part of the remaining correction."""
    xp = se2.array_module(noise, state.pose)
    late = round(config.fix_delay / TICK)
    deviation = np.array([config.fix_position, config.fix_position, config.fix_yaw])
    fix = state.true[:, -1 - late] + deviation * noise
    error = fix - se2.compose(state.frame, state.pose[:, -1 - late]) - state.correction
    error = xp.concatenate([error[:, :2], se2.wrap(error[:, 2:])], axis=-1)
    due = (now % drawn.fix_period == 0) & (now > 0)
    correction = state.correction + xp.where(due[:, None], config.fix_gain * error, 0.0)
    most = TICK * np.array([config.blend, config.blend, config.blend_yaw])
    share = xp.clip(correction, -most, most)
    # Correct the robot's pose and derive {D} from it. Turning {D} about its own origin would displace a distant robot.
    pose = state.pose[:, -1]
    here = se2.compose(state.frame, pose) + share
    frame = se2.compose(here, se2.relative(pose, xp.zeros_like(pose)))
    return state._replace(frame=frame, correction=correction - share)


def estimate(drawn: OdometryDraw, state: Odometry) -> Float[Array, "W 3"]:
    """Current pose of {R} in {D} [m, rad]: the newest pose that has arrived, extrapolated by the twist."""
    return ago(state.pose, drawn.delay) + state.twist * TICK * drawn.delay[:, None]


def ago(history: Shaped[Array, "W L ..."], ticks: Int[Array, "W"]) -> Shaped[Array, "W ..."]:
    """Entry of a history that is ``ticks`` older than the newest one."""
    xp = se2.array_module(history, ticks)
    return history[xp.arange(history.shape[0]), history.shape[1] - 1 - ticks]
