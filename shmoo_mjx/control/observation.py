"""Inputs of the pushing controllers: the observation of the robot and one object, and the map around the object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.types import Observation


class LocalDistanceField(NamedTuple):
    """Clearance around the object on a grid of fixed size, so that one compiled controller works for every map."""

    values: Float[Array, "N N"]
    """Distance to the nearest obstacle [m]."""
    origin: Float[Array, "3"]
    """Pose of the grid's corner in {W} [m, m, rad]."""
    resolution: Scalar
    """Side of a cell [m]."""


class ObjectObservation(NamedTuple):
    """Observation of the robot and one object at one time."""

    robot_pose: Float[Array, "3"]
    """Pose of the robot in {W} [m, m, rad]."""
    robot_twist: Float[Array, "3"]
    """Twist of the robot in {W} [m/s, m/s, rad/s]."""
    lean: Float[Array, "2"]
    """Lean towards +x and +y of {R} [rad]."""
    lean_rate: Float[Array, "2"]
    """Rates of the lean [rad/s]."""
    object_pose: Float[Array, "3"]
    """Pose of the object in {W} [m, m, rad]."""
    object_twist: Float[Array, "3"]
    """Twist of the object in {W} [m/s, m/s, rad/s]."""
    wrench: Float[Array, "3"]
    """Mean wrench of the hands over the last sample, about the object's centre, in {W} [N, N m]."""
    detected: Scalar = True
    """True if the object was detected in the last sample, False if its pose is extrapolated."""
    age: Scalar = 0.0
    """Time since the camera frame of the object's pose and twist [s]."""

    @classmethod
    def of(cls, obs: Observation, index: int) -> ObjectObservation:
        """The observation of object ``index``, from an Observation of one world (batch size one)."""
        robot = (obs.robot_pose, obs.robot_twist, obs.lean, obs.lean_rate)
        of_object = (obs.object_pose, obs.object_twist, obs.wrench, obs.detected, obs.object_age)
        return cls(*(np.asarray(v[0]) for v in robot), *(np.asarray(v[0, index]) for v in of_object))


def local_distance_field(
    clearance: Any, centre: Sequence[float] | Float[Array, "n"], size: float = 7.0, resolution: float = 0.05
) -> LocalDistanceField:
    """A square section of a clearance field.

    Args:
        clearance: clearance field with a method ``at(points)``.
        centre: centre of the square in {W} [m].
        size: side of the square [m].
        resolution: side of a cell of the result [m].
    """
    n = round(size / resolution)
    corner = np.asarray(centre, dtype=float)[:2] - size / 2
    ticks = (np.arange(n) + 0.5) * resolution
    points = np.stack(np.meshgrid(corner[0] + ticks, corner[1] + ticks, indexing="xy"), axis=-1)
    values = np.asarray(clearance.at(points), dtype=np.float32)
    origin = np.array([corner[0], corner[1], 0.0], dtype=np.float32)
    return LocalDistanceField(values, origin, np.asarray(resolution, np.float32))
