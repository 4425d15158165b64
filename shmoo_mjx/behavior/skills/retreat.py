"""Retreat: draw the hands back, back away from the face, fold the arms at rest."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.behavior.skills.settings import Move, hands_to_face, lean_for
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT, REACH, TUCKED_REACH
from shmoo_mjx.types import Command

CLEAR = 0.05
"""Distance between the extended hands' place and the face at which a retreat stops and the arms fold [m]: more room for
the arms, and a longer way back."""
WITHDRAW = 0.12
"""How far the hands draw back as soon as a push ends [m]: the base first rolls forward when it is to go back."""
_SPEED = 0.2
"""Speed backwards [m/s]."""
_SLOW = 0.08
"""Speed below which the robot stands [m/s]."""


def step(
    obs: ObjectObservation,
    face: Float[Array, "4"],
    folded: bool | np.bool | Array,
    *,
    lean: Float[Array, "2"] | None = None,
    room: bool | np.bool | Array = True,
) -> Move:
    """One sample; pure, on NumPy and JAX arrays alike. No memory: where robot and object are says what is next.

    Args:
        obs: robot and object.
        face: as in :func:`~shmoo_mjx.geometry.faces.faces_of`.
        folded: whether the arms are folded.
        lean: that follows a way back [rad]; straight back from the face if not given.
        room: whether the arms have room to fold.
    """
    xp = se2.array_module(obs.object_pose, obs.robot_pose)
    # The arms fold at rest: their centre of mass moves, and a robot under way would be carried along by it.
    clear = hands_to_face(obs.object_pose, obs.robot_pose, face) > CLEAR
    slow = xp.hypot(obs.robot_twist[0], obs.robot_twist[1]) < _SLOW
    over = clear & folded & slow
    if lean is None:
        lean = lean_for(obs, xp.stack([xp.where(clear, 0.0, -_SPEED), xp.asarray(0.0)]))
    # A ball-balancing robot first rolls forwards when it is to go back: hands left out would push once more.
    reach = xp.where(clear & room, TUCKED_REACH, REACH - WITHDRAW)
    command = Command(xp.concatenate([lean, np.zeros(1)]), obs.robot_pose[2], reach, xp.asarray(HAND_HEIGHT))
    return Move(command, over)
