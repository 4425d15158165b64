"""The moves that dealing with an object is made of: approach a face, make contact, back away, stand still.

Each takes what is perceived and gives the command for the next sample and whether the move is over. The navigator and
the pushing task string them together.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.control.pushing import Sighting
from shmoo_mjx.faces import heading, stand_off
from shmoo_mjx.hands import HAND_HEIGHT, HAND_RADIUS, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.navigation import drive, flat_trajectory
from shmoo_mjx.navigation.flat_trajectory import FlatModel
from shmoo_mjx.navigation.paths import Path, project
from shmoo_mjx.navigation.records import Approach, NavigatorConfig
from shmoo_mjx.navigation.routes import Routes
from shmoo_mjx.plant.robot import ROBOT
from shmoo_mjx.types import Command, Observation

__all__ = ["Move", "Moves", "command"]

Array = Any


class Move(NamedTuple):
    """One control step of a move."""

    command: Command
    over: bool = False
    """The move has reached its end."""
    failed: str = ""
    """Why the move can't be ended, if so."""


def command(lean: Array, gamma: float, yaw: float, reach: float, height: float) -> Command:
    """A command for one world."""
    u = np.array([[lean[0], lean[1], gamma]], dtype=float)
    return Command(u, np.array([float(yaw)]), np.array([reach]), np.array([height]))


class Moves:
    """The moves for one robot on one map."""

    def __init__(self, routes: Routes, config: NavigatorConfig) -> None:
        self.config = config
        self._routes = routes
        self._planner = flat_trajectory.init(FlatModel(*ROBOT.flatness), config.trajectory)

    def follow(self, seen: Observation, state: drive.DriveState, path: Path) -> tuple[drive.DriveState, np.ndarray]:
        """Lean command ``[2]`` along ``path`` round everything that is known."""
        return drive.follow(self.config.drive, self._planner, state, seen, path, self._routes.belief.clearance())

    def approach(self, seen: Observation, pose: np.ndarray, face: np.ndarray, memory: Approach) -> Move:
        """Drive to the stand-off pose at ``face [4]`` of an object at ``pose [3]``, stop there and extend the arms."""
        wanted = stand_off(pose, face, self.config.contact_gap)
        position, now = seen.robot_pose[0], float(seen.time[0])
        memory.drive, lean = self.follow(seen, memory.drive, memory.path)
        near = np.linalg.norm(position[:2] - wanted[:2]) < 0.10
        slow = np.linalg.norm(seen.robot_twist[0, :2]) < 0.08
        remaining = memory.path.length - project(memory.path, position[:2])
        yaw = wanted[2] if remaining < 0.8 else drive.yaw_ahead(self.config.drive, seen, memory.path)
        if memory.extended_at is None and near and slow and abs(se2.wrap(position[2] - wanted[2])) < 0.12:
            memory.extended_at = now
        over = memory.extended_at is not None and now - memory.extended_at > 1.0
        late = not over and now - memory.started > 30.0
        reach, height = (TUCKED_REACH, TUCKED_HEIGHT) if memory.extended_at is None else (REACH, HAND_HEIGHT)
        failed = "the stand-off pose was not reached within 30 s" if late else ""
        return Move(command(lean, 0.0, yaw, reach, height), over, failed)

    def contact(self, seen: Observation, index: int, pose: np.ndarray, face: np.ndarray, memory: Approach) -> Move:
        """Creep forward until the hands feel object ``index``, or until it gives way without being felt."""
        if memory.touched_from is None:
            memory.touched_from = pose
        in_face = se2.relative(se2.compose(pose, face[:3]), seen.robot_pose[0])
        # Within 5 cm of the hands, so that what somebody else moves meanwhile does not count.
        near = in_face[0] > -(REACH + HAND_RADIUS + 0.05)
        gives_way = near and np.linalg.norm(pose[:2] - memory.touched_from[:2]) > self.config.contact_shift
        if gives_way or np.hypot(*Sighting.of(seen, index).wrench[:2]) > self.config.contact_force:
            return Move(self.rest(seen, extended=True), over=True)
        off = in_face[0] < -(REACH + HAND_RADIUS + 0.5) or abs(in_face[1]) > 0.3
        wish = np.array([self.config.contact_speed, np.clip(-0.8 * in_face[1], -0.1, 0.1)])
        lean = drive.velocity_command(seen, se2.rotate(wish, -in_face[2]))
        failed = "drifted off the face while making contact" if off else ""
        return Move(command(lean, 0.0, heading(pose, face), REACH, HAND_HEIGHT), failed=failed)

    def retreat(self, seen: Observation, pose: np.ndarray, face: np.ndarray, since: float) -> Move:
        """Back away from the face and fold the arms; ``since`` is when this began [s]."""
        in_face = se2.relative(se2.compose(pose, face[:3]), seen.robot_pose[0])
        away = -in_face[0] - REACH - HAND_RADIUS
        position, yaw = seen.robot_pose[0, :2], float(seen.robot_pose[0, 2])
        # The arms fold at rest: their CoM moves, and a robot under way would be carried along by it.
        folding = away > self.config.retreat
        folded = bool(np.all(seen.hands[0, :, 0] < TUCKED_REACH + 0.06))
        slow = float(np.linalg.norm(seen.robot_twist[0, :2])) < 0.08
        if (folded and slow) or float(seen.time[0]) - since > 5.0:
            return Move(self.rest(seen), over=True)
        back = (0.0 if folding else -0.2) * np.array([np.cos(yaw), np.sin(yaw)]) + self._routes.off_walls(position)
        lean = drive.velocity_command(seen, se2.rotate(back, -yaw))
        # A ball-balancing robot first rolls forwards when it is to go back: hands left out would push once more.
        reach = TUCKED_REACH if folding else REACH - self.config.withdraw
        return Move(command(lean, 0.0, yaw, reach, HAND_HEIGHT))

    def rest(self, seen: Observation, extended: bool = False) -> Command:
        """Stand still, with folded or extended arms."""
        lean = drive.velocity_command(seen, np.zeros(2))
        reach, height = (REACH, HAND_HEIGHT) if extended else (TUCKED_REACH, TUCKED_HEIGHT)
        return command(lean, 0.0, float(seen.robot_pose[0, 2]), reach, height)
