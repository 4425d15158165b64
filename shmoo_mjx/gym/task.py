"""Code shared by both environments and both engines: parts of observations and actions, and the interface of a task.

All functions work on W worlds with NumPy; a single environment is a batch of one. Vectors are in the robot's frame {R}
(origin at the contact point with the floor, x forward, yaw only), so that a policy need not learn the invariance to
position and heading.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, Protocol

import mujoco
import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.types import Command, Observation

Adjust = Callable[[mujoco.MjSpec], None]
_SIGNED = ("fall", "bonus", "bump")
"""Config fields that are rewards and may be negative. All others are lengths, angles, speeds or weights."""


class Part(NamedTuple):
    """A named, contiguous part of an observation or action vector."""

    name: str
    """Name of the part."""
    size: int
    """Number of entries."""
    low: float
    """Smallest value."""
    high: float
    """Largest value."""
    unit: str
    """Unit of the entries."""
    meaning: str
    """Description for users."""


ACTIONS = (
    Part(
        "lean",
        2,
        -0.14,
        0.14,
        "rad",
        "lean angles towards +x and +y of {R}; a lean accelerates the robot, or pushes the object",
    ),
    Part("gamma", 1, -0.45, 0.45, "rad", "steering angle of the hands; positive turns the object to the right"),
    Part(
        "turn",
        1,
        -0.4,
        0.4,
        "rad",
        "desired heading relative to the present one; the robot turns at twice this angle per second",
    ),
)
"""Parts of the action, which is held for 0.1 s. All ranges are within Gymnasium's recommended range of -1 to 1."""

BODY = (
    Part("lean", 2, -1.6, 1.6, "rad", "lean towards +x and +y"),
    Part("lean_rate", 2, -20.0, 20.0, "rad/s", "its rate"),
    Part("twist", 3, -10.0, 10.0, "m/s, rad/s", "velocity of the robot (x, y) and yaw rate"),
    Part("hands", 4, -2.0, 2.0, "m", "centres of the left and the right hand (x, y)"),
)
"""First parts of every observation."""


class Start(NamedTuple):
    """Start of an episode in one world with N objects. Poses are in {W}."""

    conditions: tuple[Condition, ...]
    """Condition of each object."""
    object_poses: np.ndarray
    """Initial poses of the objects [m, rad], ``[N, 3]``."""
    robot_pose: np.ndarray
    """Initial pose of the robot [m, rad], ``[3]``."""
    goal: np.ndarray
    """Goal pose of the object ``[3]`` (push) or goal position of the robot ``[2]`` (navigate) [m, rad]."""
    walls: np.ndarray = np.zeros((0, 4))
    """Boxes along the axes of {W}: centre x, y, half lengths [m], ``[K, 4]``."""
    way: np.ndarray = np.zeros((0, 0))
    """Path length from each cell of the map to the goal [m], ``[H, W]``."""

    def scene(self, engine: Literal["mujoco", "mjx"], adjust: Adjust = lambda spec: None) -> Scene:
        """Build the MuJoCo scene; ``adjust`` changes the robot's body as in build_scene."""
        placed = list(zip(self.conditions, self.object_poses, strict=True))
        walls = [tuple(w) for w in self.walls]
        return build_scene(placed, self.robot_pose.tolist(), walls, engine=engine, adjust=adjust)


class Outcome(NamedTuple):
    """Outcome of W worlds in a task, ``[W]`` each."""

    progress: np.ndarray
    """Potential [m]; the reward of a step is its increase."""
    distance: np.ndarray
    """Distance from the goal [m]."""
    success: np.ndarray
    """Whether the task is solved."""


class Judged(NamedTuple):
    """Result of a step for W worlds, ``[W]`` each."""

    outcome: Outcome
    """Outcome after the step; a diverged world keeps the one before the step."""
    reward: np.ndarray
    """Reward of the step."""
    success: np.ndarray
    """Whether the task is solved and the robot stands."""
    fallen: np.ndarray
    """Whether the robot has fallen; False for diverged worlds."""
    terminated: np.ndarray
    """Whether the episode has ended."""
    reason: np.ndarray
    """Reason of the end: "success", "fallen" or "diverged"; empty if the episode continues."""


class Task(Protocol):
    """Interface of a task. ``context`` is the result of :meth:`gather`."""

    observation: tuple[Part, ...]
    """Parts of the observation."""
    action: tuple[Part, ...]
    """Parts of the action."""
    fall: float
    """Reward of a fall, which ends the episode."""
    bonus: float
    """Reward of success, which ends the episode."""
    bump: float
    """Reward of 0.1 s in contact with a wall."""
    poses_known: bool
    """Whether the robot knows all object poses at the start, even those out of sight."""

    def draw(self, rng: np.random.Generator, same_world: Start | None = None) -> Start:
        """Draw an episode; with ``same_world``, one with the same objects and walls."""

    def gather(self, starts: Sequence[Start]) -> Any:
        """Batch the data of the starts that the other methods need."""

    def command(self, actions: np.ndarray, observed: Observation) -> Command:
        """Low-level command for actions ``[W, m]``."""

    def observe(self, context: Any, observed: Observation) -> np.ndarray:
        """Observations ``[W, n]``, float32, from the sensed observation."""

    def judge(self, context: Any, true: Observation) -> Outcome:
        """Outcome from the ground truth."""


def judged(
    task: Task, before: Outcome, after: Outcome, *, fallen: np.ndarray, diverged: np.ndarray, touching: np.ndarray
) -> Judged:
    """Rewards and terminations of one step.

    Args:
        task: task that defines the rewards.
        before: outcome before the step.
        after: outcome after the step.
        fallen: which robots have fallen, ``[W]``.
        diverged: which worlds have diverged, ``[W]``. They end with the reward of a fall.
        touching: which robots touched a wall, ``[W]``.
    """
    after = Outcome(*(np.where(diverged, old, new) for old, new in zip(before, after, strict=True)))
    lost = fallen | diverged
    success = after.success & ~lost
    reward = after.progress - before.progress + (success * task.bonus + lost * task.fall + touching * task.bump)
    reason = np.select([diverged, fallen, success], ["diverged", "fallen", "success"], "").astype(object)
    return Judged(after, reward, success, fallen & ~diverged, success | lost, reason)


def begun(outcome: Outcome) -> Judged:
    """Result to report at the start of an episode."""
    no = np.zeros(outcome.success.shape, dtype=bool)
    return Judged(outcome, np.zeros(no.shape), outcome.success, no, no, np.full(no.shape, "", dtype=object))


def info_of(step: Judged, touching: np.ndarray) -> dict[str, np.ndarray]:
    """The ``info`` of the environments, ``[W]`` each."""
    return {
        "success": step.success,
        "distance": step.outcome.distance,
        "fallen": step.fallen,
        "wall_contact": touching,
        "reason": step.reason,
    }


def seed_of(seed: Any, options: Mapping[str, Any] | None) -> int | None:
    """Check the arguments of ``reset`` and return the seed as an int. Any integer type is accepted.

    Raises:
        ShmooError: there are options (no environment has any), or the seed is not a whole number.
    """
    if options:
        raise ShmooError(f"reset knows no options, and was given {', '.join(map(repr, options))}; leave them out.")
    try:
        return None if seed is None else operator.index(seed)
    except TypeError:
        raise ShmooError(f"the seed must be a whole number, not {seed!r}.") from None


def config_of[Config](kind: type[Config], config: Config | None) -> Config:
    """Check a config and return it, or the default config for None.

    Raises:
        ShmooError: the config has the wrong type, or a field is not a valid number or pair of numbers.
    """
    usual = kind()
    config = usual if config is None else config
    if not isinstance(config, kind):
        raise ShmooError(f"the config must be a {kind.__name__}, not {config!r}.")
    for name, default in vars(usual).items():
        low, value, shape = -np.inf if name in _SIGNED else 0.0, getattr(config, name), np.shape(default)
        if isinstance(default, str) or _numbers_from(low, value, shape):
            continue
        wanted = "two finite numbers, the smaller one first" if shape else "a finite number"
        raise ShmooError(f"{kind.__name__}: {name} is {value!r}; give {wanted}{', not below 0' if low == 0 else ''}.")
    return config


def _numbers_from(low: float, value: Any, shape: tuple[int, ...]) -> bool:
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return False
    ordered = numbers.ndim == 0 or bool((np.diff(numbers) >= 0).all())
    return numbers.shape == shape and bool((np.isfinite(numbers) & (numbers >= low)).all()) and ordered


def widened(parts: Sequence[Part], names: Sequence[str], reach: float) -> tuple[Part, ...]:
    """Copy of ``parts`` in which the ranges of ``names`` are widened to at least -``reach`` (or 0) to ``reach``."""
    return tuple(
        p._replace(low=min(p.low, -reach) if p.low < 0 else p.low, high=max(p.high, reach)) if p.name in names else p
        for p in parts
    )


def command(actions: np.ndarray, observed: Observation, arms: np.ndarray | float = 1.0) -> Command:
    """Convert ACTIONS ``[W, 4+]`` to a command; ``arms [W]`` is 0 for folded and 1 for extended arms."""
    extended = np.broadcast_to(arms, len(actions))
    return Command(
        u=np.asarray(actions[:, :3], dtype=float),
        yaw=se2.wrap(np.asarray(observed.robot_pose, dtype=float)[:, 2] + actions[:, 3]),
        reach=TUCKED_REACH + extended * (REACH - TUCKED_REACH),
        hand_height=TUCKED_HEIGHT + extended * (HAND_HEIGHT - TUCKED_HEIGHT),
    )


def flat(parts: Sequence[Part], values: Mapping[str, Array]) -> np.ndarray:
    """Concatenate the values ``[W, ...]`` of all parts, clipped to their ranges, to observations ``[W, n]``."""
    columns = [np.clip(values[p.name].reshape(len(values[p.name]), p.size), p.low, p.high) for p in parts]
    return np.concatenate(columns, axis=1).astype(np.float32)


def body(observed: Observation) -> dict[str, Array]:
    """Values of the parts BODY."""
    return {
        "lean": observed.lean,
        "lean_rate": observed.lean_rate,
        "twist": se2.rotate(observed.robot_twist, -observed.robot_pose[:, 2]),
        "hands": observed.hands[..., :2],
    }


def in_robot(observed: Observation, poses: Array) -> np.ndarray:
    """Transform poses ``[W, ..., 3]`` in {W} to (x, y, cos yaw, sin yaw) in {R}, ``[W, ..., 4]``."""
    robot = observed.robot_pose.reshape(len(observed.robot_pose), *(1,) * (poses.ndim - 2), 3)
    local = se2.relative(robot, poses)
    return np.concatenate([local[..., :2], np.cos(local[..., 2:]), np.sin(local[..., 2:])], axis=-1)
