"""ShmooPush: bring one object of unknown mass and friction to a goal pose and let it rest there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of, stand_off
from shmoo_mjx.gym.task import ACTIONS, BODY, Outcome, Part, Start, body, command, config_of, flat, in_robot, widened
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.types import Command, Observation


@dataclass(frozen=True)
class PushEnvConfig:
    """Choices of the task, SI units."""

    family: str = "box"
    """box, cart or wheelchair, or an object file (*.json)."""
    distance: tuple[float, float] = (0.6, 1.6)
    """Range of the way to the goal [m]."""
    bearing: float = 0.3
    """Largest angle between the face's direction and the goal [rad]. The goal's yaw is turned by twice the angle:
    the end of the arc that starts straight ahead."""
    gap: tuple[float, float] = (0.05, 0.15)
    """Range of the distance between hands and face at the start [m]."""
    lateral: float = 0.05
    """Largest shift along the face at the start [m]."""
    arrived: float = 0.10
    """Distance from the goal that counts as success [m]."""
    arrived_yaw: float = float(np.deg2rad(10.0))
    """Yaw error that counts as success there [rad]."""
    at_rest: float = 0.03
    """Speed below which arriving there counts [m/s]."""
    yaw_weight: float = 0.3
    """Metres that a radian of yaw error counts as."""
    near_weight: float = 0.1
    """Share of the distance between hands and object that counts as distance from the goal: it leads to contact."""
    fall: float = -1.0
    bonus: float = 1.0


class PushGoal(NamedTuple):
    """What differs between worlds."""

    goal: np.ndarray
    """``[W, 3]`` in {W}."""
    half_extents: np.ndarray
    """``[W, 2]`` [m]"""


class PushEnvTask:
    """The robot starts in front of the object's rear face; its arms come out in the first half second."""

    observation: tuple[Part, ...] = (
        *BODY,
        Part("object", 4, -10.0, 10.0, "m, 1", "the object's x, y, and cos and sin of its yaw"),
        Part("object_twist", 3, -10.0, 10.0, "m/s, rad/s", "its velocity (x, y) and yaw rate"),
        Part("wrench", 3, -500.0, 500.0, "N, N m", "of the hands on it about its centre, mean over the last 0.1 s"),
        Part("goal", 4, -10.0, 10.0, "m, 1", "where it should be: x, y, cos and sin of yaw"),
        Part("half_extents", 2, 0.0, 2.0, "m", "half its length and half its width"),
    )
    action: tuple[Part, ...] = ACTIONS
    bump = 0.0
    poses_known = True

    def __init__(self, config: PushEnvConfig | None = None) -> None:
        self.config = config_of(PushEnvConfig, config)
        self._family = str(self.config.family)
        draw_condition(self._family, 0)  # refuses what is no family
        far = 2.0 + self.config.gap[1] + self.config.distance[1]
        self.observation = widened(type(self).observation, ("object", "goal"), far)
        self.fall, self.bonus = self.config.fall, self.config.bonus

    def draw(self, rng: np.random.Generator, same_world: Start | None = None) -> Start:
        """An object (unless given) at the origin, the robot behind it, and a goal ahead."""
        cfg = self.config
        thing = same_world.conditions[0] if same_world else draw_condition(self._family, int(rng.integers(2**31)))
        face = faces_of(thing.half_extents)[0]
        robot = stand_off(np.zeros(3), face, rng.uniform(*cfg.gap), rng.uniform(-cfg.lateral, cfg.lateral))
        bearing, far = rng.uniform(-cfg.bearing, cfg.bearing), rng.uniform(*cfg.distance)
        goal = np.array([far * np.cos(bearing), far * np.sin(bearing), 2 * bearing])
        return Start((thing,), np.zeros((1, 3)), robot, goal)

    def gather(self, starts: Sequence[Start]) -> PushGoal:
        """Goals and footprints."""
        return PushGoal(
            np.stack([s.goal for s in starts]), np.array([s.conditions[0].half_extents for s in starts], dtype=float)
        )

    def command(self, actions: np.ndarray, observed: Observation) -> Command:
        """Arms extended."""
        return command(actions, observed)

    def observe(self, context: PushGoal, observed: Observation) -> np.ndarray:
        """See ``observation``."""
        yaw = observed.robot_pose[:, 2]
        return flat(
            self.observation,
            body(observed)
            | {
                "object": in_robot(observed, observed.object_pose[:, 0]),
                "object_twist": se2.rotate(observed.object_twist[:, 0], -yaw),
                "wrench": se2.rotate(observed.wrench[:, 0], -yaw),
                "goal": in_robot(observed, context.goal),
                "half_extents": context.half_extents,
            },
        )

    def judge(self, context: PushGoal, true: Observation) -> Outcome:
        """The potential is minus the distance from the goal, yaw error and distance of the hands included."""
        cfg, pose = self.config, true.object_pose[:, 0]
        distance = np.linalg.norm(pose[:, :2] - context.goal[:, :2], axis=-1)
        turned = np.abs(se2.wrap(pose[:, 2] - context.goal[:, 2]))
        thing = se2.inverse_transform_point(true.robot_pose, pose[:, :2])
        near = np.linalg.norm(true.hands[..., :2].mean(axis=1) - thing, axis=-1)
        speed = np.linalg.norm(true.object_twist[:, 0, :2], axis=-1)
        success = (distance < cfg.arrived) & (turned < cfg.arrived_yaw) & (speed < cfg.at_rest)
        return Outcome(-distance - cfg.yaw_weight * turned - cfg.near_weight * near, distance, success)
