"""Force estimate Gamma = J tau, assigned to the object that the hands can be touching."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.plant.joint_torque import joint_torque_wrench
from shmoo_mjx.plant.robot import RobotState

__all__ = ["TouchConfig", "felt"]

Array = Any


@dataclass(frozen=True)
class TouchConfig:
    """The estimate of contact forces from the arms' motor currents."""

    least: float = 2.0
    """Force below which a reading counts as no contact [N]: the arms' swing and the errors of motor constants
    leave as much. More: light touches are missed."""


def felt(touch: TouchConfig, robot: RobotState, torque: Array, reach: Array, object_pose: Array) -> np.ndarray:
    """Gamma ``[W, N, 3]`` on each object about its centre, in {W}; all of it goes to the one nearest to the hands.

    Args:
        touch: see there.
        robot: joint angles and lean, and as pose the one the robot believes in.
        torque: of the arms' motors ``[W, 6]`` [N m].
        reach: of the hands ``[W]`` [m].
        object_pose: believed ``[W, N, 3]`` in {W}; NaN where unknown.
    """
    wrench = np.zeros_like(object_pose)
    if not wrench.size:
        return wrench
    hands = se2.transform_point(robot.pose, np.stack([reach, np.zeros_like(reach)], axis=-1))
    far = np.linalg.norm(object_pose[..., :2] - hands[:, None], axis=-1)
    nearest = np.argmin(np.where(np.isfinite(far), far, np.inf), axis=1)
    rows = np.arange(len(nearest))
    reading = joint_torque_wrench(robot, torque, object_pose[rows, nearest])
    # A comparison with NaN is false: what is not known anywhere is not touched either.
    firm = (np.hypot(reading[:, 0], reading[:, 1]) > touch.least) & np.isfinite(reading).all(axis=-1)
    wrench[rows, nearest] = np.where(firm[:, None], reading, 0.0)
    return wrench
