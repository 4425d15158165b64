"""What the live page draws over the world: lines on the floor, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np

from shmoo_mjx.control.mppi import Plan
from shmoo_mjx.navigation.belief import Status
from shmoo_mjx.navigation.navigator import Navigator
from shmoo_mjx.report.style import COLOURS, outline
from shmoo_mjx.sensing.camera import Camera
from shmoo_mjx.types import Observation

__all__ = ["Lines", "believed", "field_of_view", "path", "rollouts"]

Array = Any

_SHOWN = 60
"""Roll-outs that are drawn, evenly over the costs."""
_FLOOR = 0.015
"""Height of lines on the floor [m]: above it, or they flicker."""


class Lines(NamedTuple):
    """Segments in {W}."""

    points: np.ndarray
    """``[N, 2, 3]`` [m]"""
    colours: np.ndarray
    """``[N, 2, 3]`` uint8"""


def _lines(points: Array, colours: Array) -> Lines:
    """A polyline ``[T, 2 or 3]`` or several ``[S, T, ...]``, each of one colour (0 to 1)."""
    found = np.asarray(points, dtype=np.float32)
    found = found[None] if found.ndim == 2 else found
    if found.shape[-1] == 2:
        found = np.concatenate([found, np.full((*found.shape[:-1], 1), _FLOOR, dtype=np.float32)], axis=-1)
    pairs = np.stack([found[:, :-1], found[:, 1:]], axis=2)
    shades = np.broadcast_to(np.atleast_2d(colours)[:, None, None, :3], pairs.shape)
    whole = np.isfinite(pairs).all(axis=(2, 3))
    return Lines(pairs[whole], (255 * shades[whole]).astype(np.uint8))


def _rgb(colour: str) -> np.ndarray:
    return np.array(matplotlib.colors.to_rgb(colour))


def path(points: Array | None, colour: str = COLOURS["plan"]) -> Lines:
    """A way ``[N, 2]`` in {W}; nothing without one."""
    return _lines(np.zeros((1, 2)) if points is None else points, _rgb(colour))


def rollouts(plan: Plan | None, top: float = 0.0) -> Lines:
    """Where the object would go, roll-out by roll-out, from the dearest (dark) to the cheapest (bright).

    They are drawn above ``top`` [m], the object's height: on the floor it would hide them.
    """
    if plan is None:
        return path(None)
    costs = np.asarray(plan.costs)
    fit = np.flatnonzero(np.isfinite(costs))
    if not len(fit):
        return path(None)
    order = fit[np.argsort(-costs[fit])]
    chosen = order[np.unique(np.linspace(0, len(order) - 1, _SHOWN).astype(int))]
    places = np.asarray(plan.trajectories.object_pose)[chosen, :, :2]
    height = top + _FLOOR + 0.05 * np.linspace(0.0, 1.0, len(chosen))[:, None, None]
    points = np.concatenate([places, np.broadcast_to(height, (*places.shape[:-1], 1))], axis=-1)
    return _lines(points, matplotlib.colormaps["plasma"](np.linspace(0.05, 0.95, len(chosen))))


def field_of_view(camera: Camera, pose: Array) -> Lines:
    """The edge of what the camera sees from the robot's ``pose [3]``; walls are not looked at."""
    half = min(camera.field_of_view / 2, np.pi)
    angles = float(pose[2]) + np.linspace(-half, half, 25)
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    near, far = (np.asarray(pose)[:2] + distance * rays for distance in (camera.near, camera.far))
    return _lines(np.concatenate([near[:1], far, near[::-1]]), _rgb("#56B4E9"))


def believed(navigator: Navigator, seen: Observation, sizes: Sequence[tuple[float, float]]) -> Lines:
    """Footprints where the robot takes the objects to be: seen now (blue), remembered (grey), fixed (red)."""
    parts = [path(None)]
    for index, known in navigator.belief.objects.items():
        if index >= len(sizes):
            continue
        colour = COLOURS["robot"] if bool(seen.detected[0, index]) else "#777777"
        colour = COLOURS["registered"] if known.status is Status.FIXED else colour
        corners = outline(known.pose, np.asarray(sizes[index]) + 0.03)
        parts.append(path(np.concatenate([corners, corners[:1]]), colour))
    return Lines(*(np.concatenate(column) for column in zip(*parts, strict=True)))
