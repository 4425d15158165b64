"""A robot's senses as one settings object, and their state: what is remembered between two readings.

Everything here takes NumPy or JAX arrays of W worlds. Random numbers come in as arguments.
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
"""Ticks between two readings of the joint torques: 50 Hz."""


@dataclass(frozen=True)
class Senses:
    """What a robot perceives, and the body that goes with it."""

    name: str = "real"
    """What runs record."""
    perfect: bool = False
    """True poses, twists and forces without delay, of what the camera has in sight; else everything below counts."""
    camera: Camera = Camera()
    odometry: OdometryConfig = OdometryConfig()
    tracker: TrackerConfig = TrackerConfig()
    touch: TouchConfig = TouchConfig()
    lean_noise: float = float(np.deg2rad(0.1))
    """Standard deviation of lean [rad] and, five times larger, of its rate [rad/s]: a MEMS inertial unit's attitude."""
    computing: float = 0.03
    """Time that the controller computes [s], which passes in the world: a command reaches the motors so much later. A
    fixed budget keeps runs repeatable; the shipped controller takes 20 to 30 ms on two cores."""
    planning: float = 0.2
    """Time that a global path or a planning stage takes to compute [s]; the robot goes on as it did meanwhile."""
    body: Perturbation = Perturbation()
    """How the robot's body differs from the one the control knows, and how late commands arrive."""

    def __post_init__(self) -> None:
        for name in ("lean_noise", "computing", "planning"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ShmooError(f"Senses: {name} is {getattr(self, name)}; give a number of 0 or more.")

    @property
    def latency(self) -> float:
        """Time from what a command answers to its effect [s], as the robot knows it: with means of what is drawn."""
        if self.perfect:
            return 0.0
        sensed = float(np.mean(self.odometry.delay)) + self.odometry.smoothing
        return sensed + self.computing + float(np.mean(self.body.delay))

    def robot(self, seed: int) -> PerturbedBody:
        """The body of the robot with this seed."""
        return draw_body(self.body, seed)

    def adjust(self, seed: int) -> Callable[[mujoco.MjSpec], None]:
        """Argument ``adjust`` of :func:`~shmoo_mjx.plant.scene.build_scene` that builds that body."""
        return adjustment(self.robot(seed))


REAL = Senses()
"""The default of every run."""

PERFECT = Senses(
    name="perfect",
    perfect=True,
    camera=Camera(field_of_view=2 * float(np.pi), near=0.0, far=3.5, objects_hide=False),
    computing=0.0,
    planning=0.0,
    body=Perturbation.none(),
)
"""The nominal body; true poses of what is within 3.5 m all round and not behind a wall."""


def senses_named(name: str) -> Senses:
    """REAL or PERFECT.

    Raises:
        ShmooError: another name.
    """
    named = {s.name: s for s in (REAL, PERFECT)}
    if name not in named:
        raise ShmooError(f"senses {name!r} are unknown; choose real or perfect.")
    return named[name]


class SensorDraw(NamedTuple):
    """What the seeds of W robots decide about their senses."""

    odometry: OdometryDraw
    frame_delay: Int[Array, "W"]
    """Age of a camera frame when it is taken in, in ticks; odometry of that time must have arrived too."""
    command_delay: Int[Array, "W"]
    """Of commands on their way to the motors, in ticks."""


class Noise(NamedTuple):
    """Random numbers of one tick."""

    odometry: Float[Array, "W 6"]
    """Standard normal."""
    camera: Float[Array, "W N 3"]
    """Standard normal."""
    lost: Float[Array, "W N 2"]
    """Uniform from 0 to 1: drop-out, burst."""


class SensorState(NamedTuple):
    """State of the senses of W robots."""

    odometry: Odometry
    objects: Float[Array, "W L N 3"]
    """True object poses of the last ticks, the newest last: what the camera still has to report."""
    lost_until: Float[Array, "W N"]
    """Tick up to which each object's tags stay lost."""
    tracks: Tracks
    arms: ArmScale


class Estimates(NamedTuple):
    """Estimated poses and twists in {W}, now."""

    robot_pose: Float[Array, "W 3"]
    robot_twist: Float[Array, "W 3"]
    object_pose: Float[Array, "W N 3"]
    object_twist: Float[Array, "W N 3"]
    robot_age: Float[Array, "W"]
    object_age: Float[Array, "W N"]
    detected: Bool[Array, "W N"]


def draw(senses: Senses, seeds: list[int]) -> SensorDraw:
    """The senses of the robots with these seeds."""
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
    """Before the first step, when the robot has stood there for a while: one frame of what is in sight has been taken.

    Args:
        senses: see there.
        drawn: these robots.
        scenery: sizes and walls.
        robot_pose: true; the robot knows where it starts.
        object_pose: true.
        noise: standard normal.
        poses_known: whether it knows the poses of all objects too, as exactly as its camera would see them from there.
        now: number of the tick.
        remembers: for how long poses are kept at least [s], where frames may be older than the senses' own.
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
    """One tick of odometry and, in the worlds where a frame arrives, of the camera.

    Args:
        senses: see there.
        drawn: these robots.
        scenery: sizes and walls.
        sensor_state: before the tick.
        robot_pose: true, after it.
        object_pose: true.
        noise: of this tick.
        now: its number.
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
    """What W robots and their objects do in T ticks."""

    robot_pose: Float[Array, "T W 3"]
    """True, after each tick."""
    object_pose: Float[Array, "T W N 3"]
    """True."""
    coordinates: Float[Array, "T W q"]
    """The robot's qpos and qvel."""
    torque: Float[Array, "T W 6"]
    """Of the arms' motors [N m]."""
    reach: Float[Array, "W"]
    """Of the hands [m]."""


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
    """The senses after T ticks, and the mean of the force readings, which are taken in every second tick.

    To be compiled: in NumPy its thousands of small operations take longer than the physics.

    Args:
        senses: see there.
        robot: its nominal numbers.
        drawn: these robots.
        scenery: sizes and walls.
        sensor_state: before the ticks.
        motion: what happened in them.
        noise: of all ticks: fields ``[T, ...]``.
        before: number of the tick before the first.
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
    """A camera frame of each of W robots."""

    robot_pose: Array
    """True when it was taken, in {W}."""
    believed_pose: Array
    """Of the robot in {D} by odometry, then."""
    object_pose: Array
    """True, then."""
    detected: Array
    """``[W, N]``"""
    noise: Array
    """``[W, N, 3]`` standard normal."""


def _tracked(
    senses: Senses, sensor_state: SensorState, frame: _Frame, *, seconds: Array, time: tuple[Array, Array]
) -> SensorState:
    """A frame's detections in the tracks: the camera measures from the robot, the tracks stand in {D}."""
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
    """What the robot publishes at tick ``now``, everything carried on to that time; ``sample`` is the sample time [s].

    Robot and objects go through the same estimate of {D} in {W}: seen from the robot, an object is where the camera
    has seen it, however far the robot has drifted.
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
    """Believed minus true yaw [rad]: the low-level control holds headings by what the robot believes."""
    moved = sensor_state.odometry
    return se2.wrap(moved.frame[:, 2] + moved.pose[:, -1, 2] - moved.true[:, -1, 2])


def _wrapped(xp: Any, pose: Array) -> Array:
    return xp.concatenate([pose[..., :2], se2.wrap(pose[..., 2:])], axis=-1)


def altered(senses: Senses, **changes: Any) -> Senses:
    """The senses with some fields of their parts replaced, such as ``altered(REAL, camera={"drop_out": 0.0})``."""
    parts = {k: dataclasses.replace(getattr(senses, k), **v) for k, v in changes.items()}
    return dataclasses.replace(senses, **parts)
