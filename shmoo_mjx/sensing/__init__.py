"""Simulated sensing (camera, odometry, touch and tracker): turns true states into the robot's observations."""

from __future__ import annotations

from shmoo_mjx.sensing.engine import SensedEngine, SensedWorld
from shmoo_mjx.sensing.finite import finite
from shmoo_mjx.sensing.senses import PERFECT, REAL, Senses, altered, senses_named

__all__ = ["PERFECT", "REAL", "SensedEngine", "SensedWorld", "Senses", "altered", "finite", "senses_named"]
