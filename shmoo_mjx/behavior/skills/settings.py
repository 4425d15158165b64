"""Result type and helper functions that the skills share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.control.observation import ObjectObservation
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import HAND_HEIGHT, HAND_RADIUS, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean
from shmoo_mjx.types import Command


class Move(NamedTuple):
    """Result of one step of a skill. Its flags are arrays under JAX."""

    command: Command
    """Command for the next sample, of one world: u ``[3]``, the rest scalars."""
    over: Scalar = False
    """Whether the skill has finished."""
    failed: Scalar = False
    """Whether the skill has failed."""


def batched(command: Command) -> Command:
    """The command of one world as a batch of one, as the engines take it."""
    return Command(*(np.asarray(field, dtype=float)[None] for field in command))


def in_face(
    object_pose: Float[Array, "3"], robot_pose: Float[Array, "3"], face: Float[Array, "4"]
) -> Float[Array, "3"]:
    """Pose of {R} in the frame of ``face``, whose x axis is the inward normal."""
    return se2.relative(se2.compose(object_pose, face[:3]), robot_pose)


def hands_to_face(object_pose: Float[Array, "3"], robot_pose: Float[Array, "3"], face: Float[Array, "4"]) -> Scalar:
    """Distance of the extended hands from the face [m]."""
    return -in_face(object_pose, robot_pose, face)[0] - REACH - HAND_RADIUS


def lean_for(obs: ObjectObservation, wish: Float[Array, "2"]) -> Float[Array, "2"]:
    """Lean command [rad] of the velocity loop for a velocity ``wish`` in {R} [m/s]."""
    velocity = se2.rotate(obs.robot_twist[:2], -obs.robot_pose[2])
    return velocity_to_lean(Gains(), velocity, obs.lean_rate, wish)


def hold(obs: ObjectObservation, extended: bool = False) -> Command:
    """Command to stand still, with the arms folded or extended."""
    reach, height = (REACH, HAND_HEIGHT) if extended else (TUCKED_REACH, TUCKED_HEIGHT)
    xp = se2.array_module(obs.robot_pose)
    lean = lean_for(obs, xp.zeros(2))
    return Command(xp.concatenate([lean, xp.zeros(1)]), obs.robot_pose[2], xp.asarray(reach), xp.asarray(height))
