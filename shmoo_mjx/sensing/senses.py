"""Sensing settings of a robot, and the sensor state with its update functions.

Functions take NumPy or JAX arrays of W worlds. Random numbers are arguments.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float, Int, Scalar
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.plant.perturbation import Perturbation, PerturbedBody, adjustment, draw_body
from shmoo_mjx.plant.robot import NQ, Robot, readout
from shmoo_mjx.sensing import odometry, touch, tracker
from shmoo_mjx.sensing.camera import Camera, Scenery, deviation, in_sight
from shmoo_mjx.sensing.odometry import TICK, Odometry, OdometryConfig, OdometryDraw
from shmoo_mjx.sensing.touch import ArmReading, ArmScale, TouchConfig
from shmoo_mjx.sensing.tracker import TrackerConfig, Tracks

_TOUCH_EVERY = 2
"""Ticks between two readings of the joint torques (50 Hz)."""


@dataclass(frozen=True)
class Senses:
    """Sensing settings, and the perturbation of the robot's body."""

    name: str = "real"
    """Name that runs record."""
    perfect: bool = False
    """If True, the robot gets true poses, twists and forces without delay for objects in the camera's sight, and most
    settings below have no effect."""
    camera: Camera = Camera()
    """Object detection."""
    odometry: OdometryConfig = OdometryConfig()
    """Odometry and localisation of the robot."""
    tracker: TrackerConfig = TrackerConfig()
    """Filter of the objects' poses and twists."""
    touch: TouchConfig = TouchConfig()
    """Estimate of contact forces."""
    lean_noise: float = float(np.deg2rad(0.1))
    """Standard deviation of the measured lean [rad], as of a MEMS inertial unit. That of the lean rate [rad/s] is five
    times this value."""
    computing: float = 0.03
    """Computing time of the controller [s], by which its commands are delayed. The fixed value keeps runs repeatable;
    the shipped controller takes 20 to 30 ms on two cores."""
    planning: float = 0.2
    """Computing time of a global path or a planning stage [s]. Meanwhile the robot continues what it was doing."""
    body: Perturbation = Perturbation()
    """Differences between the real and the nominal robot body, and the command delay."""

    def __post_init__(self) -> None:
        for name in ("lean_noise", "computing", "planning"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ShmooError(f"Senses: {name} is {getattr(self, name)}; give a number of 0 or more.")

    @property
    def latency(self) -> float:
        """Nominal latency from sensing to actuation [s], with the means of the drawn delays; 0 for perfect sensing."""
        if self.perfect:
            return 0.0
        sensed = float(np.mean(self.odometry.delay)) + self.odometry.smoothing
        return sensed + self.computing + float(np.mean(self.body.delay))

    def robot(self, seed: int) -> PerturbedBody:
        """Body of the robot with this seed."""
        return draw_body(self.body, seed)

    def adjust(self, seed: int) -> Callable[[mujoco.MjSpec], None]:
        """The argument ``adjust`` of :func:`~shmoo_mjx.plant.scene.build_scene` that applies that body."""
        return adjustment(self.robot(seed))


REAL = Senses()
"""Realistic sensing, the default of every run."""

PERFECT = Senses(
    name="perfect",
    perfect=True,
    camera=Camera(field_of_view=2 * float(np.pi), near=0.0, far=3.5, objects_hide=False),
    computing=0.0,
    planning=0.0,
    body=Perturbation.none(),
)
"""Perfect sensing with the nominal body: true poses of objects within 3.5 m in all directions and not behind a wall."""


def senses_named(name: str | Senses) -> Senses:
    """The shipped sensing settings with this name: "real" or "perfect". Custom settings are returned unchanged.

    Raises:
        ShmooError: the name is unknown.
    """
    if isinstance(name, Senses):
        return name
    named = {s.name: s for s in (REAL, PERFECT)}
    if name not in named:
        raise ShmooError(f"senses {name!r} are unknown; choose real or perfect.")
    return named[name]


class SensorDraw(NamedTuple):
    """Sensor parameters of W robots, drawn from their seeds."""

    odometry: OdometryDraw
    """Drawn parameters of odometry and localiser."""
    frame_delay: Int[Array, "W"]
    """Age of a camera frame when it is processed [ticks]. It is at least the odometry's delay, because processing needs
    the robot's pose at the frame's time."""
    command_delay: Int[Array, "W"]
    """Delay of commands to the motors [ticks]."""


class Noise(NamedTuple):
    """Random numbers of one tick."""

    odometry: Float[Array, "W 6"]
    """Standard normal numbers of odometry and localiser."""
    camera: Float[Array, "W N 3"]
    """Standard normal numbers of the detected poses."""
    lost: Float[Array, "W N 2"]
    """Uniform numbers from 0 to 1 for drop-out and burst."""


class SensorState(NamedTuple):
    """Sensor state of W robots."""

    odometry: Odometry
    """State of odometry and localiser."""
    objects: Float[Array, "W L N 3"]
    """True object poses of the last L ticks in {W}, the newest last; delayed camera frames use them."""
    lost_until: Float[Array, "W N"]
    """Tick at which the current loss (burst) of each object ends."""
    tracks: Tracks
    """State of the object tracker."""
    arms: ArmScale
    """State of the motor calibration."""


class Estimates(NamedTuple):
    """Current estimates of poses and twists in {W}; fields as in :class:`~shmoo_mjx.types.Observation`."""

    robot_pose: Float[Array, "W 3"]
    robot_twist: Float[Array, "W 3"]
    object_pose: Float[Array, "W N 3"]
    object_twist: Float[Array, "W N 3"]
    robot_age: Float[Array, "W"]
    object_age: Float[Array, "W N"]
    detected: Bool[Array, "W N"]


def draw(senses: Senses, seeds: list[int]) -> SensorDraw:
    """Draw the sensor parameters of robots from their seeds."""
    robots = []
    for seed in seeds:
        rng = np.random.default_rng([13, seed])
        moved = odometry.draw(senses.odometry, rng)
        low, high = senses.camera.delay
        frame = max(round((low + (high - low) * rng.random()) / TICK), int(moved.delay))
        robots.append(SensorDraw(moved, np.array(frame), np.array(round(senses.robot(seed).delay / TICK))))
    drawn: SensorDraw = jax.tree.map(lambda *each: np.stack(each), *robots)
    return drawn


def first_state(
    senses: Senses,
    drawn: SensorDraw,
    scenery: Scenery,
    *,
    robot_pose: Float[Array, "W 3"],
    object_pose: Float[Array, "W N 3"],
    noise: Float[Array, "W N 3"],
    poses_known: bool = False,
    now: int = 0,
    remembers: float = 0.0,
) -> SensorState:
    """Initial sensor state of standing robots, after one camera frame.

    Args:
        senses: sensing settings.
        drawn: drawn sensor parameters.
        scenery: geometry of objects and walls.
        robot_pose: true robot poses in {W} [m, rad]; the robot knows its initial pose.
        object_pose: true object poses in {W} [m, rad].
        noise: standard normal numbers of the detected poses.
        poses_known: whether the frame detects all objects, even those out of sight.
        now: number of the tick.
        remembers: minimum length of the pose histories [s], for callers whose frames are older than those of
            ``senses``.
    """
    xp = se2.array_module(robot_pose, object_pose, noise)
    worlds, objects = object_pose.shape[:2]
    latest = max(senses.camera.delay[1], senses.odometry.delay[1], senses.odometry.fix_delay, remembers)
    length = round(latest / TICK) + 2
    sensor_state = SensorState(
        odometry.init(robot_pose, length),
        xp.repeat(object_pose[:, None], length, axis=1),
        xp.zeros((worlds, objects)),
        tracker.init(worlds, objects),
        touch.init(worlds),
    )
    detected = (
        xp.ones((worlds, objects), bool) if poses_known else in_sight(senses.camera, scenery, robot_pose, object_pose)
    )
    start = xp.full(worlds, float(now))
    sensor_state = sensor_state._replace(tracks=sensor_state.tracks._replace(at=start))
    frame = _Frame(robot_pose, sensor_state.odometry.pose[:, -1], object_pose, detected, noise)
    return _tracked(senses, sensor_state, frame, seconds=xp.zeros(worlds), time=(start, start))


def tick(
    senses: Senses,
    drawn: SensorDraw,
    scenery: Scenery,
    sensor_state: SensorState,
    *,
    robot_pose: Float[Array, "W 3"],
    object_pose: Float[Array, "W N 3"],
    noise: Noise,
    now: Scalar,
) -> SensorState:
    """Advance the odometry by one tick, and process a camera frame in worlds where one arrives.

    Args:
        senses: sensing settings.
        drawn: drawn sensor parameters.
        scenery: geometry of objects and walls.
        sensor_state: state before the tick.
        robot_pose: true robot poses in {W} after the tick [m, rad].
        object_pose: true object poses in {W} after the tick [m, rad].
        noise: random numbers of this tick.
        now: number of the tick.
    """
    moved = odometry.step(
        senses.odometry, drawn.odometry, sensor_state.odometry, robot_pose, noise=noise.odometry, now=now
    )
    objects = jnp.concatenate([sensor_state.objects[:, 1:], object_pose[:, None]], axis=1)
    sensor_state = sensor_state._replace(odometry=moved, objects=objects)
    taken = now - drawn.frame_delay
    frames = TICK * senses.camera.rate
    due = jnp.floor(taken * frames + 1e-3) > jnp.floor((taken - 1) * frames + 1e-3)
    due &= taken > sensor_state.tracks.at

    def with_frame(sensor_state: SensorState) -> SensorState:
        robot_then = odometry.ago(moved.true, drawn.frame_delay)
        objects_then = odometry.ago(sensor_state.objects, drawn.frame_delay)
        burst = due[:, None] & (noise.lost[..., 1] < senses.camera.burst)
        lost_until = jnp.where(burst, taken[:, None] + senses.camera.burst_time / TICK, sensor_state.lost_until)
        detected = due[:, None] & in_sight(senses.camera, scenery, robot_then, objects_then)
        detected &= (lost_until <= taken[:, None]) & (noise.lost[..., 0] >= senses.camera.drop_out)
        seconds = jnp.where(due, TICK * (taken - sensor_state.tracks.at), 0.0)
        believed = odometry.ago(moved.pose, drawn.frame_delay)
        frame = _Frame(robot_then, believed, objects_then, detected, noise.camera)
        before = sensor_state._replace(lost_until=lost_until)
        after = _tracked(senses, before, frame, seconds=seconds, time=(taken, now + 0 * taken))
        return jax.tree.map(lambda new, old: new.astype(old.dtype), after, sensor_state)

    return jax.lax.cond(jnp.any(due), with_frame, lambda state: state, sensor_state)


class Motion(NamedTuple):
    """True motion of W robots and their objects during T ticks."""

    robot_pose: Float[Array, "T W 3"]
    """True robot pose in {W} after each tick [m, rad]."""
    object_pose: Float[Array, "T W N 3"]
    """True object poses in {W} after each tick [m, rad]."""
    coordinates: Float[Array, "T W q"]
    """The robot's qpos and qvel after each tick."""
    torque: Float[Array, "T W 6"]
    """Torques of the arm motors [N m]."""
    reach: Float[Array, "W"]
    """Reach of the hands [m]."""


def watch(
    senses: Senses,
    robot: Robot,
    drawn: SensorDraw,
    scenery: Scenery,
    *,
    sensor_state: SensorState,
    motion: Motion,
    noise: Noise,
    before: Scalar,
) -> tuple[SensorState, Float[Array, "W N 3"]]:
    """Advance all sensors by T ticks.

    Call this function inside jit: without compilation, its thousands of small operations take longer than the physics.

    Args:
        senses: sensing settings.
        robot: nominal robot parameters.
        drawn: drawn sensor parameters.
        scenery: geometry of objects and walls.
        sensor_state: state before the ticks.
        motion: true motion during the ticks.
        noise: random numbers of all ticks, fields ``[T, ...]``.
        before: number of the tick before the first one.

    Returns:
        The new sensor state, and the mean of the wrench estimates in {W} [N, N m], which are made in every second tick.
    """
    ticks = len(motion.robot_pose)
    read = (ticks - 1 - np.arange(ticks)) % _TOUCH_EVERY == 0

    def feel(readings: tuple[SensorState, Array, Array, Scalar]) -> tuple[ArmScale, Array]:
        state, coordinates, torque, now = readings
        estimated = estimates(senses, drawn, state, now, sample=TICK)
        sensed = readout(coordinates[:, :NQ], coordinates[:, NQ:])._replace(pose=estimated.robot_pose)
        reading = ArmReading(sensed, torque, motion.reach)
        arms = touch.calibrate(state.arms, robot, reading, estimated.object_pose, half_extents=scenery.half_extents)
        return arms, touch.wrench(senses.touch, arms, robot, reading, object_pose=estimated.object_pose)

    def look(state: SensorState, inputs: Any) -> tuple[SensorState, Array]:
        robot_pose, object_pose, coordinates, torque, drawn_noise, reads, now = inputs
        after = tick(
            senses, drawn, scenery, state, robot_pose=robot_pose, object_pose=object_pose, noise=drawn_noise, now=now
        )
        none = after.arms, jnp.zeros_like(object_pose)
        arms, wrench = jax.lax.cond(reads, feel, lambda _: none, (after, coordinates, torque, now))
        return jax.tree.map(lambda new, old: new.astype(old.dtype), after._replace(arms=arms), state), wrench

    inputs = (motion.robot_pose, motion.object_pose, motion.coordinates, motion.torque, noise, read)
    state, wrenches = jax.lax.scan(look, sensor_state, (*inputs, before + 1 + jnp.arange(ticks)))
    return state, wrenches.sum(axis=0) / read.sum()


class _Frame(NamedTuple):
    """One camera frame of each of W robots. Poses are those at the time when the frame was taken."""

    robot_pose: Array
    """True robot pose in {W}, ``[W, 3]``."""
    believed_pose: Array
    """Robot pose in {D} by odometry, ``[W, 3]``."""
    object_pose: Array
    """True object poses in {W}, ``[W, N, 3]``."""
    detected: Array
    """Which objects are detected, ``[W, N]``."""
    noise: Array
    """Standard normal numbers, ``[W, N, 3]``."""


def _tracked(
    senses: Senses, sensor_state: SensorState, frame: _Frame, *, seconds: Array, time: tuple[Array, Array]
) -> SensorState:
    """Update the tracks with a frame: the camera measures poses relative to the robot, the tracks are in {D}."""
    xp = se2.array_module(frame.robot_pose, frame.object_pose, frame.noise)
    measured = se2.relative(frame.robot_pose[:, None], frame.object_pose)
    spread = deviation(senses.camera, xp.sqrt(xp.sum(measured[..., :2] ** 2, axis=-1)))
    measured = measured + spread * frame.noise
    in_odometry = se2.compose(xp.broadcast_to(frame.believed_pose[:, None], measured.shape), measured)
    tracks = tracker.update(
        senses.tracker, sensor_state.tracks, in_odometry, spread, detected=frame.detected, seconds=seconds, time=time
    )
    return sensor_state._replace(tracks=tracks)


def estimates(senses: Senses, drawn: SensorDraw, sensor_state: SensorState, now: Scalar, *, sample: float) -> Estimates:
    """Estimates at tick ``now``, with poses extrapolated to that time.

    Robot and objects use the same estimate of {D} in {W}. The pose of an object relative to the robot is therefore
    unaffected by the robot's drift.

    Args:
        senses: sensing settings.
        drawn: drawn sensor parameters.
        sensor_state: current sensor state.
        now: number of the tick.
        sample: sample time [s]; ``detected`` covers the frames that arrived within it.
    """
    xp = se2.array_module(sensor_state.tracks.pose, sensor_state.odometry.pose)
    frame, tracks = sensor_state.odometry.frame, sensor_state.tracks
    robot = se2.compose(frame, odometry.estimate(drawn.odometry, sensor_state.odometry))
    poses = tracker.ahead(tracks, TICK * (now - tracks.at))
    poses = se2.compose(xp.broadcast_to(frame[:, None], poses.shape), poses)
    return Estimates(
        robot_pose=_wrapped(xp, robot),
        robot_twist=se2.rotate(sensor_state.odometry.twist, frame[:, 2]),
        object_pose=_wrapped(xp, poses),
        object_twist=se2.rotate(tracks.rate, frame[:, None, 2]),
        robot_age=TICK * drawn.odometry.delay,
        object_age=TICK * (now - tracks.detected_at),
        detected=tracks.arrived_at > now - sample / TICK,
    )


def heading_error(sensor_state: SensorState) -> Float[Array, "W"]:
    """Estimated minus true yaw [rad]. The low-level control holds the estimated heading."""
    moved = sensor_state.odometry
    return se2.wrap(moved.frame[:, 2] + moved.pose[:, -1, 2] - moved.true[:, -1, 2])


def _wrapped(xp: Any, pose: Array) -> Array:
    return xp.concatenate([pose[..., :2], se2.wrap(pose[..., 2:])], axis=-1)


def altered(senses: Senses, **changes: Any) -> Senses:
    """Copy of ``senses`` with fields of its parts replaced, such as ``altered(REAL, camera={"drop_out": 0.0})``."""
    parts = {k: dataclasses.replace(getattr(senses, k), **v) for k, v in changes.items()}
    return dataclasses.replace(senses, **parts)
