"""Retreat: draw the hands back, back away from the face, and fold the arms at rest."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.behavior.skills.settings import Move, hands_to_face, lean_for
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, TUCKED_REACH
from shmoo_mjx.types import Command

CLEAR = 0.05
"""Distance of the extended hands' position from the face at which a retreat stops and the arms fold [m]. Larger values
give the arms more room and the robot a longer way back."""
WITHDRAW = 0.12
"""Distance by which the hands draw back when a push ends [m], because the base first rolls forward before it moves
back."""
_SPEED = 0.2
"""Backward speed [m/s]."""
_SLOW = 0.08
"""Speed below which the robot counts as standing [m/s]."""


def step(
    obs: ObjectObservation,
    face: Float[Array, "4"],
    folded: bool | np.bool | Array,
    *,
    lean: Float[Array, "2"] | None = None,
    room: bool | np.bool | Array = True,
) -> Move:
    """One sample. Pure and stateless; takes NumPy or JAX arrays.

    Args:
        obs: robot and object.
        face: as in :func:`~shmoo_mjx.geometry.faces.faces_of`.
        folded: whether the arms are folded.
        lean: lean command that follows a retreat path [rad]; straight back from the face if not given.
        room: whether the arms have room to fold.
    """
    xp = se2.array_module(obs.object_pose, obs.robot_pose)
    # The arms fold at rest, because their moving centre of mass would accelerate a moving robot.
    clear = hands_to_face(obs.object_pose, obs.robot_pose, face) > CLEAR
    slow = xp.hypot(obs.robot_twist[0], obs.robot_twist[1]) < _SLOW
    over = clear & folded & slow
    if lean is None:
        lean = lean_for(obs, xp.stack([xp.where(clear, 0.0, -_SPEED), xp.asarray(0.0)]))
    # A ball-balancing robot first rolls forward before it moves back. Extended hands would push the object again.
    reach = xp.where(clear & room, TUCKED_REACH, REACH - WITHDRAW)
    command = Command(xp.concatenate([lean, np.zeros(1)]), obs.robot_pose[2], reach, xp.asarray(HAND_HEIGHT))
    return Move(command, over)
