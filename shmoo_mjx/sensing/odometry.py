"""Estimate of the robot's own pose: odometry that drifts, and a localiser that corrects it by the map.

Frames as in ROS REP 105. {D} is the odometry frame: the robot's pose in it is continuous, without jumps, and drifts.
The localiser keeps the pose of {D} in {W}; it changes that slowly, so that the robot's pose in {W} does not jump. What
is tracked (sensing/tracker.py) lives in {D}: a correction is then no motion of an object.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Int, Scalar, Shaped
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2

TICK = 0.01
"""Time between two readings of the senses, and what delays are rounded to [s]."""


@dataclass(frozen=True)
class OdometryConfig:
    """Visual-inertial odometry with the ball's encoders (T265 class: its data sheet says under 1 % of the way), and a
    scan matcher as localiser (AMCL class: some cm). The split among the causes of drift is a judgement."""

    scale: float = 0.006
    """Standard deviation of the drawn error of length over length [1]. More: drifts along the way."""
    yaw_scale: float = 0.005
    """Standard deviation of the drawn error of turned angle over angle [1]. More: drifts where the robot turns."""
    yaw_bias: float = float(np.deg2rad(0.02))
    """Standard deviation of the drawn drift of the yaw [rad/s]: what is left of a gyro's bias. More: the way bends."""
    walk: float = 0.006
    """Standard deviation of the position's random walk over the root of the way [m / sqrt(m)]."""
    yaw_walk: float = float(np.deg2rad(0.06))
    """Standard deviation of the yaw's random walk over the root of time [rad / sqrt(s)]."""
    delay: tuple[float, float] = (0.02, 0.04)
    """Range from which the age of a pose on arrival is drawn [s]; the robot carries it on by its twist meanwhile."""
    smoothing: float = 0.03
    """Time constant of the low-pass on differences of poses that gives the twist [s]. Longer: smoother and later."""
    localised: bool = True
    """Whether the map corrects the pose; without, it drifts off."""
    fix_period: tuple[float, float] = (0.5, 1.0)
    """Range from which the time between two fixes on the map is drawn [s]: AMCL updates every 0.2 m or 0.5 rad."""
    fix_position: float = 0.025
    """Standard deviation of a fix's position [m]: half a cell of a 5 cm map."""
    fix_yaw: float = float(np.deg2rad(0.5))
    """Standard deviation of a fix's yaw [rad]."""
    fix_delay: float = 0.1
    """Age of a fix on arrival [s]: the matching takes that long."""
    fix_gain: float = 0.25
    """Share of a fix's innovation that is taken over. More: follows drift faster and the fixes' noise more."""
    blend: float = 0.03
    """Fastest correction of the position [m/s]: 3 mm in a sample. More: larger jumps of the robot's pose."""
    blend_yaw: float = float(np.deg2rad(1.0))
    """Fastest correction of the yaw [rad/s]. More: larger jumps of the robot's pose."""

    def __post_init__(self) -> None:
        for name in ("delay", "fix_period"):
            low, high = getattr(self, name)
            if not (0 if name == "delay" else TICK) <= low <= high:
                raise ShmooError(f"OdometryConfig: {name} is {low:g} to {high:g} s; give the smaller time first.")
        for name in ("scale", "yaw_scale", "yaw_bias", "walk", "yaw_walk", "smoothing", "fix_position", "fix_yaw"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ShmooError(f"OdometryConfig: {name} is {getattr(self, name)}; give a number of 0 or more.")


class OdometryDraw(NamedTuple):
    """What the seeds of W robots decide, or that of one."""

    scale: Float[Array, "..."]
    yaw_scale: Float[Array, "..."]
    yaw_bias: Float[Array, "..."]
    """[rad/s]"""
    delay: Int[Array, "..."]
    """In ticks."""
    fix_period: Int[Array, "..."]
    """In ticks."""


class Odometry(NamedTuple):
    """State of W robots; L ticks are remembered, the newest last."""

    true: Float[Array, "W L 3"]
    """Of {R} in {W}: what the sensors measure, never reported as it is."""
    pose: Float[Array, "W L 3"]
    """Of {R} in {D}."""
    twist: Float[Array, "W 3"]
    """In {D}, filtered, of the newest pose that has arrived."""
    frame: Float[Array, "W 3"]
    """Of {D} in {W}, as the localiser has it."""
    correction: Float[Array, "W 3"]
    """What it still has to add to the robot's pose in {W}."""


def draw(config: OdometryConfig, rng: np.random.Generator) -> OdometryDraw:
    """One robot."""
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
    """At rest at ``robot_pose``, which the robot knows; remembers ``length`` ticks."""
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
    """One tick.

    Args:
        config: see there.
        drawn: this robot.
        state: before the tick.
        robot_pose: true, after it.
        noise: standard normal: of the walk and of a fix.
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
    """A fix, where one is due, and a little of the correction."""
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
    # The robot's pose is corrected and {D} follows: a turn about {D}'s origin would throw a far robot aside.
    pose = state.pose[:, -1]
    here = se2.compose(state.frame, pose) + share
    frame = se2.compose(here, se2.relative(pose, xp.zeros_like(pose)))
    return state._replace(frame=frame, correction=correction - share)


def estimate(drawn: OdometryDraw, state: Odometry) -> Float[Array, "W 3"]:
    """The robot's pose in {D} now: the newest that has arrived, carried on by the twist."""
    return ago(state.pose, drawn.delay) + state.twist * TICK * drawn.delay[:, None]


def ago(history: Shaped[Array, "W L ..."], ticks: Int[Array, "W"]) -> Shaped[Array, "W ..."]:
    """Of a history, the entry ``ticks`` before the newest one."""
    xp = se2.array_module(history, ticks)
    return history[xp.arange(history.shape[0]), history.shape[1] - 1 - ticks]
