"""Make contact: move slowly forward until the hands feel the object, or until the object moves."""

from __future__ import annotations

from typing import NamedTuple

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.behavior.skills.settings import Move, hands_to_face, in_face, lean_for
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import heading
from shmoo_mjx.geometry.hands import HAND_HEIGHT, HAND_RADIUS, REACH, touches
from shmoo_mjx.types import Command

_SPEED = 0.12
"""Speed at which contact is made [m/s]. Larger values knock light objects away; smaller values take longer."""
_SHIFT = 0.03
"""Displacement at which an object near the hands counts as touched, however small its resistance [m]. It is several
times the camera's noise at that distance."""
_NEAR = 0.08
"""Distance of the hands from the face below which a force or a displacement counts as contact [m]. Farther away, a
force comes from the unfolding arms and a displacement from somebody else."""
_ASTRAY = (0.5, 0.3)
"""Distance of the hands from the face, and lateral error of the robot, at which contact has failed [m]."""


class ContactState(NamedTuple):
    """State of one attempt to make contact."""

    object_pose: Float[Array, "3"]
    """Pose of the object at the start of the attempt, in {W}."""
    lateral: Scalar = 0.0
    """Target offset along the face, to the robot's left of its middle [m]."""


def init(obs: ObjectObservation, lateral: Scalar = 0.0) -> ContactState:
    """State before the first step."""
    return ContactState(obs.object_pose, lateral)


def step(state: ContactState, obs: ObjectObservation, face: Float[Array, "4"]) -> tuple[ContactState, Move]:
    """One sample. Pure; takes NumPy or JAX arrays.

    Args:
        state: from :func:`init`.
        obs: robot and object.
        face: as in :func:`~shmoo_mjx.geometry.faces.faces_of`.
    """
    xp = se2.array_module(obs.object_pose, obs.robot_pose)
    local, away = in_face(obs.object_pose, obs.robot_pose, face), hands_to_face(obs.object_pose, obs.robot_pose, face)
    shift = obs.object_pose[:2] - state.object_pose[:2]
    gives_way = xp.hypot(shift[0], shift[1]) > _SHIFT
    over = (away < _NEAR) & (touches(obs.wrench) | gives_way)
    beside = local[1] - state.lateral
    sideways = xp.clip(-0.8 * beside, -0.1, 0.1)
    wish = xp.where(over, 0.0, se2.rotate(xp.stack([_SPEED + 0.0 * sideways, sideways]), -local[2]))
    lean = lean_for(obs, wish)
    command = Command(
        xp.concatenate([lean, xp.zeros(1)]), heading(obs.object_pose, face), xp.asarray(REACH), xp.asarray(HAND_HEIGHT)
    )
    failed = ~over & ((local[0] < -(REACH + HAND_RADIUS + _ASTRAY[0])) | (abs(beside) > _ASTRAY[1]))
    return state, Move(command, over, failed)
