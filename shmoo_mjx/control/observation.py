"""Inputs of the pushing controllers: the robot and one object as perceived, and the map round the object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.types import Observation


class LocalDistanceField(NamedTuple):
    """Clearance round the object on a grid of fixed size, so that one compiled controller serves every map."""

    values: Float[Array, "N N"]
    """[m]"""
    origin: Float[Array, "3"]
    """Pose of the grid's corner in {W}."""
    resolution: Scalar
    """[m]"""


class ObjectObservation(NamedTuple):
    """The robot and one object as perceived at one instant: an Observation reduced to that object."""

    robot_pose: Float[Array, "3"]
    robot_twist: Float[Array, "3"]
    lean: Float[Array, "2"]
    lean_rate: Float[Array, "2"]
    object_pose: Float[Array, "3"]
    object_twist: Float[Array, "3"]
    wrench: Float[Array, "3"]
    """Mean over the sample that just ended, about the object's centre, in {W}."""
    detected: Scalar = True
    """Whether the object's pose was detected in that sample, not carried on."""
    age: Scalar = 0.0
    """Time since the frame that the object's pose and twist were last seen in [s]."""

    @classmethod
    def of(cls, obs: Observation, index: int) -> ObjectObservation:
        """From an observation of one world (batch of one)."""
        robot = (obs.robot_pose, obs.robot_twist, obs.lean, obs.lean_rate)
        of_object = (obs.object_pose, obs.object_twist, obs.wrench, obs.detected, obs.object_age)
        return cls(*(np.asarray(v[0]) for v in robot), *(np.asarray(v[0, index]) for v in of_object))


def local_distance_field(
    clearance: Any, centre: Sequence[float] | Float[Array, "n"], size: float = 7.0, resolution: float = 0.05
) -> LocalDistanceField:
    """Cut a square of ``size`` metres round ``centre`` out of a clearance field with a method ``at(points)``."""
    n = round(size / resolution)
    corner = np.asarray(centre, dtype=float)[:2] - size / 2
    ticks = (np.arange(n) + 0.5) * resolution
    points = np.stack(np.meshgrid(corner[0] + ticks, corner[1] + ticks, indexing="xy"), axis=-1)
    values = np.asarray(clearance.at(points), dtype=np.float32)
    origin = np.array([corner[0], corner[1], 0.0], dtype=np.float32)
    return LocalDistanceField(values, origin, np.asarray(resolution, np.float32))
