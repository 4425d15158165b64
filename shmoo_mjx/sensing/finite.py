"""Replaces non-finite values in observations."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.types import DT, Observation


def finite(observed: Observation, last: Observation | None = None) -> Observation:
    """Replace NaN and infinity in an observation.

    The rules are:

    - A non-finite value of the robot's own state is replaced by that of ``last``, or by 0 without ``last``. In this
      case ``robot_age`` grows by one sample, or is infinite without ``last``, so that a caller can stop.
    - An object with a non-finite pose or twist counts as not detected, and its twist is 0. If the pose is not finite,
      the object keeps the pose of ``last``, and its age grows by one sample.
    - An object that was never detected keeps an all-NaN pose and an infinite age. Its twist and wrench are 0.
    - A non-finite wrench becomes 0.

    Args:
        observed: observation from any engine or recorder.
        last: result of this function one sample earlier.

    Returns:
        The repaired observation, or the same object if nothing had to be replaced.
    """
    own = {name: np.asarray(getattr(observed, name), dtype=float) for name in _OWN}
    pose, twist = np.asarray(observed.object_pose, dtype=float), np.asarray(observed.object_twist, dtype=float)
    wrench, age = np.asarray(observed.wrench, dtype=float), np.asarray(observed.object_age, dtype=float)
    fit = np.isfinite(pose).all(axis=-1) & np.isfinite(twist).all(axis=-1)
    felt = np.isfinite(wrench).all(axis=-1)
    whole = all(np.isfinite(value).all() for value in own.values())
    if whole and fit.all() and felt.all() and not np.isnan(age).any():
        return observed
    robot_age = np.asarray(observed.robot_age, dtype=float)
    if not whole:
        before = {n: np.zeros_like(v) if last is None else np.asarray(getattr(last, n)) for n, v in own.items()}
        own = {n: np.where(np.isfinite(v), v, before[n]) for n, v in own.items()}
        robot_age = np.full_like(robot_age, np.inf) if last is None else np.asarray(last.robot_age) + DT
    old_pose = np.full_like(pose, np.nan) if last is None else np.asarray(last.object_pose, dtype=float)
    old_age = np.full_like(age, np.inf) if last is None else np.asarray(last.object_age, dtype=float) + DT
    # An object with a finite pose has been located, even if its twist is unknown.
    placed = np.isfinite(pose).all(axis=-1)
    return observed._replace(
        **own,
        robot_age=robot_age,
        object_pose=np.where(placed[..., None], pose, old_pose),
        object_twist=np.where(fit[..., None], twist, 0.0),
        wrench=np.where((felt & (placed | np.isfinite(old_pose).all(axis=-1)))[..., None], wrench, 0.0),
        object_age=np.where(placed & ~np.isnan(age), age, old_age),
        detected=np.asarray(observed.detected, dtype=bool) & fit,
    )


_OWN = ("time", "robot_pose", "robot_twist", "lean", "lean_rate", "hands")
"""Fields of the robot's own state."""
