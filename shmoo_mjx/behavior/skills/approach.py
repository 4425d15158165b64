"""Approach: drive to the stand-off pose at a face, stop there, and extend the arms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.behavior.skills.settings import Move
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import stand_off
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.types import Command

CONTACT_GAP = 0.12
"""Distance between hands and face at the stand-off pose [m]. Larger values keep clear of an object with an uncertain
pose, but make it easier to miss the contact."""
_UNFOLDING = 1.0
"""Time for the arms to extend [s]."""
_LOOKING = 2.0
"""Distance from the object within which the robot turns to it to keep it in the camera's view [m]."""
_LIMIT = 30.0
"""Maximum duration of an approach [s]."""


@dataclass(frozen=True)
class ApproachState:
    """State of one approach."""

    started: float
    """Start time [s]."""
    gap: float
    """Distance between hands and face at the stand-off pose [m]."""
    lateral: float = 0.0
    """Offset of the stand-off pose along the face, to the robot's left of its middle [m]."""
    extended_at: float | None = None
    """Time at which the arms were commanded to extend [s]."""


def init(time: float, gap: float, lateral: float = 0.0) -> ApproachState:
    """An approach that starts at ``time`` [s]."""
    return ApproachState(time, gap, lateral)


def step(
    state: ApproachState,
    time: float,
    obs: ObjectObservation,
    face: Float[Array, "4"],
    *,
    lean: Float[Array, "2"],
    yaw: float,
    remaining: float,
    room: bool = True,
) -> tuple[ApproachState, Move]:
    """One sample.

    Args:
        state: from :func:`init` or the last step.
        time: current time [s].
        obs: robot and object.
        face: as in :func:`~shmoo_mjx.geometry.faces.faces_of`.
        lean: lean command that follows the path to the stand-off pose [rad].
        yaw: heading along that path, in {W} [rad].
        remaining: remaining length of the path [m].
        room: whether the arms have room to extend here.
    """
    object_pose, pose = np.asarray(obs.object_pose), obs.robot_pose
    wanted = stand_off(object_pose, np.asarray(face), state.gap, state.lateral)
    near = np.linalg.norm(pose[:2] - wanted[:2]) < 0.10
    slow = np.linalg.norm(obs.robot_twist[:2]) < 0.08
    extended_at = state.extended_at
    room = room or time - state.started > _LIMIT / 2
    if extended_at is None and near and slow and room and abs(se2.wrap(pose[2] - wanted[2])) < 0.12:
        extended_at = time
    over = extended_at is not None and time - extended_at > _UNFOLDING
    reach, height = (TUCKED_REACH, TUCKED_HEIGHT) if extended_at is None else (REACH, HAND_HEIGHT)
    if remaining < 0.8:
        yaw = float(wanted[2])
    else:
        offset = obs.object_pose[:2] - pose[:2]
        yaw = float(np.arctan2(offset[1], offset[0])) if np.hypot(*offset) < _LOOKING else yaw
    command = Command(np.append(lean, 0.0), yaw, reach, height)
    late = not over and time - state.started > _LIMIT
    return replace(state, extended_at=extended_at), Move(command, over, late)
