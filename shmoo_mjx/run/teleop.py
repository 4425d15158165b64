"""Keyboard teleoperation of the robot, recorded in the format of ``collect``.

A viewer reports key presses but no releases, so each press changes a set point by one step. A velocity loop turns the
set points into leans.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.data.collect import sample
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean
from shmoo_mjx.types import DT, Command, Observation

_SPEED, _TURN, _STEER = 0.05, np.deg2rad(7.5), 0.05
"""Change per key press: speed [m/s], heading [rad], steering angle [rad]."""
_FASTEST, _SHARPEST = 0.5, 0.5
"""Limits of the set points: speed [m/s] and steering angle [rad]."""
_FRAMES = 5
"""Frames per sample time."""

KEYS = {
    265: "up: faster forwards",
    264: "down: slower, backwards",
    263: "left: turn left",
    262: "right: turn right",
    266: "page up: sideways to the left",
    267: "page down: sideways to the right",
    44: "comma: steer left (right hand forward)",
    46: "full stop: steer right (left hand forward)",
    259: "backspace: stop",
    257: "enter: arms out or in (always out while recording)",
}
"""GLFW key codes that MuJoCo's viewer does not use itself."""


class Driver(NamedTuple):
    """Set points of the teleoperation."""

    forward: float = 0.0
    left: float = 0.0
    """Speeds in {R} [m/s]."""
    yaw: float = 0.0
    """Heading in {W} [rad]."""
    gamma: float = 0.0
    """Steering angle [rad]."""
    arms_out: bool = False
    """Whether the arms are extended."""


def press(driver: Driver, key: int, arms_fixed: bool = False) -> Driver:
    """The set points after one key press. Other keys change nothing."""

    def moved(value: float, step: float, limit: float) -> float:
        return float(np.clip(value + step, -limit, limit))

    match key:
        case 265 | 264:
            return driver._replace(forward=moved(driver.forward, _SPEED if key == 265 else -_SPEED, _FASTEST))
        case 263 | 262:
            return driver._replace(yaw=float(se2.wrap(driver.yaw + (_TURN if key == 263 else -_TURN))))
        case 266 | 267:
            return driver._replace(left=moved(driver.left, _SPEED if key == 266 else -_SPEED, _FASTEST))
        case 44 | 46:
            return driver._replace(gamma=moved(driver.gamma, _STEER if key == 46 else -_STEER, _SHARPEST))
        case 259:
            return driver._replace(forward=0.0, left=0.0, gamma=0.0)
        case 257 if not arms_fixed:
            return driver._replace(arms_out=not driver.arms_out)
        case _:
            return driver


def command(driver: Driver, obs: Observation) -> Command:
    """The robot's command for one sample time, for a batch of one world."""
    moving = se2.rotate(obs.robot_twist[:, :2], -obs.robot_pose[:, 2])
    # The gain is higher than for driving alone. If an object slows the robot, the operator asks for more speed.
    lean = velocity_to_lean(Gains(velocity_p=0.3), moving, obs.lean_rate, np.array([[driver.forward, driver.left]]))
    u = np.concatenate([lean, [[driver.gamma]]], axis=-1)
    reach, height = (REACH, HAND_HEIGHT) if driver.arms_out else (TUCKED_REACH, TUCKED_HEIGHT)
    return Command(u, np.array([driver.yaw]), np.array([reach]), np.array([height]))


class TeleopSession(NamedTuple):
    """A teleoperated drive so far."""

    world: Any
    """State of the engine."""
    obs: Observation
    """Last observation."""
    driver: Driver
    """Current set points."""
    rows: tuple[dict[str, np.ndarray], ...] = ()
    """Recorded samples, each field ``[1, ...]``; empty if nothing is recorded."""


def begin(engine: Any, record: bool = False) -> TeleopSession:
    """Starts a drive at rest. If it is recorded, the arms are extended."""
    world = engine.init()
    obs = engine.observe(world)
    driver = Driver(yaw=float(obs.robot_pose[0, 2]), arms_out=record)
    if record:
        world, obs = engine.step(world, command(driver, obs), 1.0)
    return TeleopSession(world, obs, driver)


def tick(
    engine: Any, session: TeleopSession, keys: list[int], *, record: bool = False, show: Any = lambda world: None
) -> TeleopSession:
    """Runs one sample time. ``show`` is called with the engine's world for each frame."""
    driver = session.driver
    for key in keys:
        driver = press(driver, key, arms_fixed=record)
    wanted = command(driver, session.obs)
    world, wrenches, obs = session.world, [], session.obs
    for _ in range(_FRAMES):
        world, obs = engine.step(world, wanted, DT / _FRAMES)
        wrenches.append(obs.wrench)
        show(world)
    obs = obs._replace(wrench=np.mean(wrenches, axis=0))
    rows: tuple[Any, ...] = (*session.rows, sample(session.obs, obs, wanted.u)) if record else ()
    return TeleopSession(world, obs, driver, rows)


def save(directory: Path, condition: Condition, rows: tuple[dict[str, np.ndarray], ...]) -> str:
    """Adds a drive to a data set as one condition with one episode.

    Returns:
        The condition's name.

    Raises:
        ShmooError: the directory contains a data set of another kind.
    """
    from shmoo_mjx.data import store

    opened = store.create_or_open(directory, {"operator": "keyboard", "dt": DT})
    arrays = {k: np.stack([r[k] for r in rows], axis=1).astype(np.float32) for k in rows[0]}
    touching = np.flatnonzero(arrays["contact"][0])
    arrays["face"] = _face(condition, arrays, int(touching[0]) if len(touching) else 0)[None].astype(np.float32)
    arrays["size"] = np.array([np.hypot(*condition.half_extents)], dtype=np.float32)
    kind = Path(condition.family).stem
    number = sum(name.startswith(f"drive-{kind}-{condition.seed}-") for name in opened.manifest["conditions"])
    name = f"drive-{kind}-{condition.seed}-{number}"
    store.write_condition(opened, name, arrays, condition.to_dict() | {"split": "train"})
    return name


def _face(condition: Condition, arrays: dict[str, np.ndarray], when: int) -> np.ndarray:
    """The face ``[4]`` nearest to the robot at sample ``when``."""
    faces = faces_of(condition.half_extents)
    robot = se2.relative(arrays["object_pose"][0, when], arrays["robot_pose"][0, when])
    return np.asarray(faces[np.argmin(np.hypot(*(faces[:, :2] - robot[:2]).T))])
