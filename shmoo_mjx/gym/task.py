"""What both environments and both engines share: the parts of an observation or action, and what a task is.

Everything here works on W worlds at once, with NumPy; a single environment is a batch of one. Vectors are given in {R},
the robot's frame (origin at the wheel's contact point, x forward, yaw only), so that a policy need not learn that
rooms look alike from all sides.
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
"""Fields of a config that are rewards; all other numbers are lengths, angles, speeds or weights."""


class Part(NamedTuple):
    """Some neighbouring numbers of an observation or an action."""

    name: str
    size: int
    low: float
    high: float
    unit: str
    meaning: str


ACTIONS = (
    Part("lean", 2, -0.14, 0.14, "rad", "lean angles towards +x and +y of {R}: how the robot accelerates and pushes"),
    Part("gamma", 1, -0.45, 0.45, "rad", "steering angle of the hands; positive turns the object to the right"),
    Part("turn", 1, -0.4, 0.4, "rad", "heading to turn to, from the present one; the robot turns at twice that per s"),
)
"""Held for 0.1 s. Every one is small enough for Gymnasium's recommended range of -1 to 1."""

BODY = (
    Part("lean", 2, -1.6, 1.6, "rad", "lean towards +x and +y"),
    Part("lean_rate", 2, -20.0, 20.0, "rad/s", "its rate"),
    Part("twist", 3, -10.0, 10.0, "m/s, rad/s", "velocity of the robot (x, y) and yaw rate"),
    Part("hands", 4, -2.0, 2.0, "m", "centres of the left and the right hand (x, y)"),
)
"""What every observation begins with."""


class Start(NamedTuple):
    """One episode of one world before it begins. N objects; poses in {W}, SI units."""

    conditions: tuple[Condition, ...]
    object_poses: np.ndarray
    """``[N, 3]``"""
    robot_pose: np.ndarray
    """``[3]``"""
    goal: np.ndarray
    """``[3]`` pose of the object (push) or ``[2]`` place of the robot (navigate)."""
    walls: np.ndarray = np.zeros((0, 4))
    """``[K, 4]`` boxes along the axes of {W}: centre x, y, half lengths [m]."""
    way: np.ndarray = np.zeros((0, 0))
    """``[H, W]`` length of the way to the goal from each cell of the map [m]."""

    def scene(self, engine: Literal["mujoco", "mjx"], adjust: Adjust = lambda spec: None) -> Scene:
        """The world in MuJoCo; ``adjust``, as build_scene takes it, makes the robot's body."""
        placed = list(zip(self.conditions, self.object_poses, strict=True))
        walls = [tuple(w) for w in self.walls]
        return build_scene(placed, self.robot_pose.tolist(), walls, engine=engine, adjust=adjust)


class Outcome(NamedTuple):
    """What a task makes of W worlds, ``[W]`` each."""

    progress: np.ndarray
    """A potential [m]: the reward of a step is what it has gained."""
    distance: np.ndarray
    """From the goal [m]."""
    success: np.ndarray


class Judged(NamedTuple):
    """What a step brought W worlds, ``[W]`` each."""

    outcome: Outcome
    """After the step; a world that has diverged keeps the one before."""
    reward: np.ndarray
    success: np.ndarray
    fallen: np.ndarray
    terminated: np.ndarray
    reason: np.ndarray
    """Why the episode is over: "success", "fallen", "diverged", or "" while it goes on."""


class Task(Protocol):
    """What to do, and how it is seen and judged. ``context`` is what :meth:`gather` made of the worlds' starts."""

    observation: tuple[Part, ...]
    action: tuple[Part, ...]
    fall: float
    """Reward of a fall, which ends the episode."""
    bonus: float
    """Reward of success, which ends the episode."""
    bump: float
    """Reward of 0.1 s in contact with a wall."""
    poses_known: bool
    """Whether the robot knows from the start where the objects stand, in sight or not."""

    def draw(self, rng: np.random.Generator, same_world: Start | None = None) -> Start:
        """An episode; with ``same_world``, another one with the objects and walls of that one."""

    def gather(self, starts: Sequence[Start]) -> Any:
        """The batched arrays that the methods below need."""

    def command(self, actions: np.ndarray, observed: Observation) -> Command:
        """The low-level command for actions ``[W, m]``."""

    def observe(self, context: Any, observed: Observation) -> np.ndarray:
        """Observations ``[W, n]``, float32."""

    def judge(self, context: Any, true: Observation) -> Outcome:
        """How far the worlds are, by the truth, whatever the robot perceives."""


def judged(
    task: Task, before: Outcome, after: Outcome, *, fallen: np.ndarray, diverged: np.ndarray, touching: np.ndarray
) -> Judged:
    """Rewards and ends of one step.

    Args:
        task: gives the rewards.
        before: outcome before the step.
        after: outcome after it.
        fallen: which robots lie on the floor ``[W]``.
        diverged: which worlds the physics has lost ``[W]``; this ends an episode as a fall does.
        touching: which robots touched a wall ``[W]``.
    """
    after = Outcome(*(np.where(diverged, old, new) for old, new in zip(before, after, strict=True)))
    lost = fallen | diverged
    success = after.success & ~lost
    reward = after.progress - before.progress + (success * task.bonus + lost * task.fall + touching * task.bump)
    reason = np.select([diverged, fallen, success], ["diverged", "fallen", "success"], "").astype(object)
    return Judged(after, reward, success, fallen & ~diverged, success | lost, reason)


def begun(outcome: Outcome) -> Judged:
    """What is reported of an episode that begins."""
    no = np.zeros(outcome.success.shape, dtype=bool)
    return Judged(outcome, np.zeros(no.shape), outcome.success, no, no, np.full(no.shape, "", dtype=object))


def info_of(step: Judged, touching: np.ndarray) -> dict[str, np.ndarray]:
    """What the environments report as ``info``, ``[W]`` each."""
    return {
        "success": step.success,
        "distance": step.outcome.distance,
        "fallen": step.fallen,
        "wall_contact": touching,
        "reason": step.reason,
    }


def seed_of(seed: Any, options: Mapping[str, Any] | None) -> int | None:
    """The seed given to ``reset``; any kind of whole number will do.

    Raises:
        ShmooError: there are options, of which no environment knows any, or the seed is no whole number.
    """
    if options:
        raise ShmooError(f"reset knows no options, and was given {', '.join(map(repr, options))}; leave them out.")
    try:
        return None if seed is None else operator.index(seed)
    except TypeError:
        raise ShmooError(f"the seed must be a whole number, not {seed!r}.") from None


def config_of[Config](kind: type[Config], config: Config | None) -> Config:
    """The config itself, or the default one for None.

    Raises:
        ShmooError: it is of another kind, or a field of it is not the number or pair of numbers that it should be.
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
    """The parts, with the ranges of those that are named at least from -``reach`` (or 0) to ``reach``."""
    return tuple(
        p._replace(low=min(p.low, -reach) if p.low < 0 else p.low, high=max(p.high, reach)) if p.name in names else p
        for p in parts
    )


def command(actions: np.ndarray, observed: Observation, arms: np.ndarray | float = 1.0) -> Command:
    """ACTIONS ``[W, 4+]`` as a command; ``arms [W]`` goes from folded (0) to extended (1)."""
    extended = np.broadcast_to(arms, len(actions))
    return Command(
        u=np.asarray(actions[:, :3], dtype=float),
        yaw=se2.wrap(np.asarray(observed.robot_pose, dtype=float)[:, 2] + actions[:, 3]),
        reach=TUCKED_REACH + extended * (REACH - TUCKED_REACH),
        hand_height=TUCKED_HEIGHT + extended * (HAND_HEIGHT - TUCKED_HEIGHT),
    )


def flat(parts: Sequence[Part], values: Mapping[str, Array]) -> np.ndarray:
    """The observation ``[W, n]``: each part's values ``[W, ...]`` in turn, cut to its range."""
    columns = [np.clip(values[p.name].reshape(len(values[p.name]), p.size), p.low, p.high) for p in parts]
    return np.concatenate(columns, axis=1).astype(np.float32)


def body(observed: Observation) -> dict[str, Array]:
    """Values of BODY."""
    return {
        "lean": observed.lean,
        "lean_rate": observed.lean_rate,
        "twist": se2.rotate(observed.robot_twist, -observed.robot_pose[:, 2]),
        "hands": observed.hands[..., :2],
    }


def in_robot(observed: Observation, poses: Array) -> np.ndarray:
    """Poses ``[W, ..., 3]`` of {W} as (x, y, cos yaw, sin yaw) in {R} ``[W, ..., 4]``."""
    robot = observed.robot_pose.reshape(len(observed.robot_pose), *(1,) * (poses.ndim - 2), 3)
    local = se2.relative(robot, poses)
    return np.concatenate([local[..., :2], np.cos(local[..., 2:]), np.sin(local[..., 2:])], axis=-1)
