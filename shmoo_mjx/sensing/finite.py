"""Replacement of values that are not finite in observations."""

from __future__ import annotations

import numpy as np

from shmoo_mjx.types import DT, Observation


def finite(observed: Observation, last: Observation | None = None) -> Observation:
    """The observation with every NaN or infinity replaced; the same object if there was none.

    What the robot knows of itself is taken from ``last``, or is 0 before there is one, and ``robot_age`` grows (from
    infinity, if nothing was ever known): a caller that wants to stop can see that. An object with a broken pose or
    twist counts as not detected; its pose is that of ``last``, it rests, and its age has grown. An object that was
    never detected keeps a pose of NaN, all of it, with the age infinity by which it is known, and moves and feels
    nothing. A broken wrench is none.

    Args:
        observed: what an engine or a recorder of someone else reports.
        last: what this function gave one sample earlier.
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
    # An object whose pose alone is whole has been detected; its twist is unknown.
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
"""What a robot knows of itself."""
