"""ShmooPush: push one object of unknown mass and friction to a goal pose and leave it there at rest."""

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
    """Configuration of the pushing task, SI units."""

    family: str = "box"
    """Object family: box, cart or wheelchair, or an object file (*.json)."""
    distance: tuple[float, float] = (0.6, 1.6)
    """Range of the distance to the goal [m]."""
    bearing: float = 0.3
    """Largest angle between the push direction and the goal [rad]. The goal's yaw is twice the drawn angle, as at the
    end of an arc that starts straight ahead."""
    gap: tuple[float, float] = (0.05, 0.15)
    """Range of the distance between hands and face at the start [m]."""
    lateral: float = 0.05
    """Largest lateral shift of the robot along the face at the start [m]."""
    arrived: float = 0.10
    """Largest distance from the goal for success [m]."""
    arrived_yaw: float = float(np.deg2rad(10.0))
    """Largest yaw error for success [rad]."""
    at_rest: float = 0.03
    """Largest speed of the object for success [m/s]."""
    yaw_weight: float = 0.3
    """Weight of the yaw error in the potential [m/rad]."""
    near_weight: float = 0.1
    """Weight of the distance between hands and object in the potential. It rewards making contact."""
    fall: float = -1.0
    """Reward of a fall."""
    bonus: float = 1.0
    """Reward of success."""


class PushGoal(NamedTuple):
    """Goals and objects of W worlds."""

    goal: np.ndarray
    """Goal poses of the objects in {W} [m, rad], ``[W, 3]``."""
    half_extents: np.ndarray
    """Half extents of the objects' footprints [m], ``[W, 2]``."""


class PushEnvTask:
    """Pushing task. The robot starts at the object's rear face and extends its arms in the first half second."""

    observation: tuple[Part, ...] = (
        *BODY,
        Part("object", 4, -10.0, 10.0, "m, 1", "the object's x, y, and cos and sin of its yaw"),
        Part("object_twist", 3, -10.0, 10.0, "m/s, rad/s", "its velocity (x, y) and yaw rate"),
        Part(
            "wrench",
            3,
            -500.0,
            500.0,
            "N, N m",
            "wrench of the hands on the object about its centre, mean over the last 0.1 s",
        ),
        Part("goal", 4, -10.0, 10.0, "m, 1", "goal pose of the object: x, y, cos and sin of yaw"),
        Part("half_extents", 2, 0.0, 2.0, "m", "half its length and half its width"),
    )
    action: tuple[Part, ...] = ACTIONS
    bump = 0.0
    poses_known = True

    def __init__(self, config: PushEnvConfig | None = None) -> None:
        self.config = config_of(PushEnvConfig, config)
        self._family = str(self.config.family)
        draw_condition(self._family, 0)  # raises an error for an unknown family
        far = 2.0 + self.config.gap[1] + self.config.distance[1]
        self.observation = widened(type(self).observation, ("object", "goal"), far)
        self.fall, self.bonus = self.config.fall, self.config.bonus

    def draw(self, rng: np.random.Generator, same_world: Start | None = None) -> Start:
        """Draw an object (unless given) at the origin, the robot behind it, and a goal ahead."""
        cfg = self.config
        thing = same_world.conditions[0] if same_world else draw_condition(self._family, int(rng.integers(2**31)))
        face = faces_of(thing.half_extents)[0]
        robot = stand_off(np.zeros(3), face, rng.uniform(*cfg.gap), rng.uniform(-cfg.lateral, cfg.lateral))
        bearing, far = rng.uniform(-cfg.bearing, cfg.bearing), rng.uniform(*cfg.distance)
        goal = np.array([far * np.cos(bearing), far * np.sin(bearing), 2 * bearing])
        return Start((thing,), np.zeros((1, 3)), robot, goal)

    def gather(self, starts: Sequence[Start]) -> PushGoal:
        """Batch the goals and footprints."""
        return PushGoal(
            np.stack([s.goal for s in starts]), np.array([s.conditions[0].half_extents for s in starts], dtype=float)
        )

    def command(self, actions: np.ndarray, observed: Observation) -> Command:
        """Low-level command with extended arms."""
        return command(actions, observed)

    def observe(self, context: PushGoal, observed: Observation) -> np.ndarray:
        """Observations ``[W, n]``; ``observation`` lists the parts."""
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
        """Outcome. The potential is minus the weighted sum of goal distance, yaw error and distance of the hands."""
        cfg, pose = self.config, true.object_pose[:, 0]
        distance = np.linalg.norm(pose[:, :2] - context.goal[:, :2], axis=-1)
        turned = np.abs(se2.wrap(pose[:, 2] - context.goal[:, 2]))
        thing = se2.inverse_transform_point(true.robot_pose, pose[:, :2])
        near = np.linalg.norm(true.hands[..., :2].mean(axis=1) - thing, axis=-1)
        speed = np.linalg.norm(true.object_twist[:, 0, :2], axis=-1)
        success = (distance < cfg.arrived) & (turned < cfg.arrived_yaw) & (speed < cfg.at_rest)
        return Outcome(-distance - cfg.yaw_weight * turned - cfg.near_weight * near, distance, success)
