"""Bench trials of the robot and of single objects, shared by tests, figures and the settling survey.

Runs do not use this module. Objects are pushed by external wrenches instead of the hands.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import mujoco
import numpy as np

from shmoo_mjx.arrays import Array, Bool, Float
from shmoo_mjx.base.assets import asset
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean
from shmoo_mjx.plant.objects import object_spec
from shmoo_mjx.types import DT, Command, Observation


class ObjectMotion(NamedTuple):
    """Planar motion of an object, sampled at every physics step."""

    time: Float[np.ndarray, "T"]
    """Time since the start [s]."""
    pose: Float[np.ndarray, "T 3"]
    """Pose (x, y, yaw) of {O} in {W} [m, rad]; yaw is unwrapped."""
    twist: Float[np.ndarray, "T 3"]
    """Twist in {W} [m/s, rad/s]."""


def object_alone(condition: Condition) -> mujoco.MjModel:
    """Model of a single object on the floor of models_xml/scene.xml."""
    spec = mujoco.MjSpec.from_file(str(asset("models_xml/scene.xml")))
    spec.attach(object_spec(condition), prefix="object0/", frame=spec.worldbody.add_frame())
    return spec.compile()


def settled(model: mujoco.MjModel, seconds: float = 0.5) -> mujoco.MjData:
    """State of the object after it has settled on the floor for ``seconds`` [s]."""
    data = mujoco.MjData(model)
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return data


def release(data: mujoco.MjData, twist: Float[np.ndarray, "3"]) -> None:
    """Set the object's planar twist in {W} [m/s, rad/s]; the wheels' velocities stay as they are."""
    data.qvel[:2], data.qvel[5] = twist[:2], twist[2]


def pushed(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    wrench: Float[np.ndarray, "3"] | Float[np.ndarray, "T 3"],
    seconds: float,
    *,
    height: float = 0.1,
    follow: bool = False,
) -> ObjectMotion:
    """Apply a planar wrench at the centre of {O} and record the motion.

    Args:
        model: model from :func:`object_alone`.
        data: initial state, advanced in place.
        wrench: wrench (fx, fy, tz) [N, N m], constant or per physics step.
        seconds: duration [s].
        height: height of the point of application above the floor [m].
        follow: if True, the wrench is given in {O} and rotates with the object; otherwise it is given in {W}.
    """
    steps = round(seconds / model.opt.timestep)
    wrenches = np.broadcast_to(wrench, (steps, 3))
    body = model.body("object0/object").id
    poses, twists = np.empty((steps, 3)), np.empty((steps, 3))
    for i in range(steps):
        yaw = _yaw(data.qpos)
        force, torque, point = np.zeros(3), np.zeros(3), np.array([data.qpos[0], data.qpos[1], height])
        force[:2] = se2.rotate(wrenches[i, :2], np.float64(yaw if follow else 0.0))
        torque[2] = wrenches[i, 2]
        data.qfrc_applied[:] = 0.0
        mujoco.mj_applyFT(model, data, force, torque, point, body, data.qfrc_applied)
        mujoco.mj_step(model, data)
        poses[i] = data.qpos[0], data.qpos[1], _yaw(data.qpos)
        twists[i] = data.qvel[0], data.qvel[1], data.qvel[5]
    data.qfrc_applied[:] = 0.0
    poses[:, 2] = np.unwrap(poses[:, 2])
    return ObjectMotion(model.opt.timestep * np.arange(1, steps + 1), poses, twists)


def _yaw(qpos: np.ndarray) -> float:
    w, x, y, z = qpos[3:7]
    return float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def command(
    worlds: int,
    lean: Float[Array, "2"] | Float[Array, "W 2"] | tuple[float, float] = (0.0, 0.0),
    *,
    gamma: float = 0.0,
    yaw: float | Float[np.ndarray, "W"] = 0.0,
    reach: float = TUCKED_REACH,
    hand_height: float = TUCKED_HEIGHT,
) -> Command:
    """Command for W worlds; lean and yaw can differ between worlds.

    Args:
        worlds: number of worlds W.
        lean: lean towards +x, +y of {R} [rad].
        gamma: steering angle [rad].
        yaw: heading to hold [rad].
        reach: reach of the hands [m].
        hand_height: height of the hands above the floor [m].
    """
    u = np.zeros((worlds, 3))
    u[:, :2], u[:, 2] = lean, gamma
    return Command(u, np.broadcast_to(yaw, worlds).astype(float), np.full(worlds, reach), np.full(worlds, hand_height))


def drive(
    engine: Any,
    seconds: float,
    velocity: Callable[[float], tuple[float, float]] = lambda time: (0.0, 0.0),
    station: float = 0.0,
    *,
    push: Callable[[float], Float[np.ndarray, "W 6"] | None] = lambda time: None,
    yaw: float = 0.0,
    arms: Callable[[float], tuple[float, float]] = lambda time: (TUCKED_REACH, TUCKED_HEIGHT),
    sensor_noise: tuple[np.random.Generator, float, float] | None = None,
) -> tuple[Observation, Bool[np.ndarray, "W"]]:
    """Run the outer velocity loop on every world of ``engine``.

    Args:
        engine: either engine, with or without simulated sensing.
        seconds: duration [s].
        velocity: function of time [s] that gives the desired velocity in {R} [m/s].
        station: gain of station keeping at the origin [1/s]; 0 switches it off.
        push: function of time [s] that gives force and torque on the torso in {W} [N, N m], or None.
        yaw: heading to hold [rad].
        arms: function of time [s] that gives reach and hand height [m].
        sensor_noise: random generator, and the outer loop's noise as standard deviations of velocity [m/s] and lean
            rate [rad/s].

    Returns:
        Observations stacked over time ``[T, W, ...]``, and whether each world's robot has fallen at the end.
    """
    world = engine.init()
    observed = _numpy(engine.observe(world))
    rows = []
    gains = Gains()
    for i in range(round(seconds / DT)):
        time = i * DT
        heading = observed.robot_pose[:, 2]
        moving, rate = se2.rotate(observed.robot_twist[:, :2], -heading), observed.lean_rate
        if sensor_noise is not None:
            rng, speed_noise, rate_noise = sensor_noise
            moving = moving + speed_noise * rng.normal(size=moving.shape)
            rate = rate + rate_noise * rng.normal(size=rate.shape)
        wish = np.array(velocity(time)) - station * se2.rotate(observed.robot_pose[:, :2], -heading)
        lean = velocity_to_lean(gains, moving, rate, wish)
        reach, height = arms(time)
        world, observed = engine.step(
            world, command(len(lean), lean, gamma=0.0, yaw=yaw, reach=reach, hand_height=height), push=push(time)
        )
        observed = _numpy(observed)
        rows.append(observed)
    track = Observation(*(np.stack(fields) for fields in zip(*rows, strict=True)))
    return track, np.asarray(engine.fallen(world))


def _numpy(observed: Observation) -> Observation:
    return Observation(*(np.asarray(field, dtype=np.float64) for field in observed))
