"""Settings and results that the skills share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.control.pushing import Sighting
from shmoo_mjx.hands import HAND_HEIGHT, HAND_RADIUS, REACH, TUCKED_HEIGHT, TUCKED_REACH
from shmoo_mjx.plant.lowlevel import Gains, velocity_to_lean
from shmoo_mjx.types import Command

__all__ = ["Move", "SkillConfig", "batched", "hands_to_face", "hold", "in_face", "lean_for"]

Array = Any


@dataclass(frozen=True)
class SkillConfig:
    """Settings of the skills, SI units."""

    contact_gap: float = 0.12
    """Distance between hands and face at the stand-off pose [m]: more keeps off an object whose pose is uncertain."""
    contact_speed: float = 0.12
    """Speed at which contact is made [m/s]: faster knocks light objects away."""
    contact_shift: float = 0.03
    """An object near the hands that has moved this far is touched, however little it resists [m]."""
    retreat: float = 0.05
    """Distance between the extended hands' place and the face at which a retreat stops and the arms fold [m]."""
    withdraw: float = 0.12
    """How far the hands draw back as soon as a push ends [m]."""
    lead: float = 0.015
    """An object is let go where it is expected to stop this far before its goal: hands relax by about that much [m]."""
    within: float = 0.3
    """... but not from farther than this, since what is let go can't be steered [m]."""


class Move(NamedTuple):
    """One step of a skill; its flags are arrays under JAX."""

    command: Command
    """For the next sample, of one world: u ``[3]``, the rest scalars."""
    over: Array = False
    """The skill has reached its end."""
    failed: Array = False
    """It can't."""


def batched(command: Command) -> Command:
    """The command of one world as a batch of one, as the engines take it."""
    return Command(*(np.asarray(field, dtype=float)[None] for field in command))


def in_face(object_pose: Array, robot_pose: Array, face: Array) -> Array:
    """Pose ``[3]`` of {R} in the frame of ``face [4]``: x is along its inward normal."""
    return se2.relative(se2.compose(object_pose, face[:3]), robot_pose)


def hands_to_face(object_pose: Array, robot_pose: Array, face: Array) -> Array:
    """How far the place of the extended hands is off the face [m]."""
    return -in_face(object_pose, robot_pose, face)[0] - REACH - HAND_RADIUS


def lean_for(now: Sighting, wish: Array) -> Array:
    """Lean ``[2]`` [rad] of the velocity loop for a velocity ``wish [2]`` in {R} [m/s]."""
    velocity = se2.rotate(now.robot_twist[:2], -now.robot_pose[2])
    return velocity_to_lean(Gains(), velocity, now.lean_rate, wish)


def hold(now: Sighting, extended: bool = False) -> Command:
    """Stand still, arms folded or extended."""
    reach, height = (REACH, HAND_HEIGHT) if extended else (TUCKED_REACH, TUCKED_HEIGHT)
    xp = se2.array_module(now.robot_pose)
    lean = lean_for(now, xp.zeros(2))
    return Command(xp.concatenate([lean, xp.zeros(1)]), now.robot_pose[2], xp.asarray(reach), xp.asarray(height))
