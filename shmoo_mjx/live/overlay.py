"""Lines and images that the live page draws over the world, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import matplotlib
import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.behavior.belief import Status
from shmoo_mjx.behavior.interaction import Machine
from shmoo_mjx.control.mppi import Plan
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.report.style import COLOURS, outline
from shmoo_mjx.sensing.camera import Camera
from shmoo_mjx.types import Observation

_CAMERA, _LOCAL, _REMEMBERED = "#56B4E9", "#CC79A7", "#777777"
_COSTS = matplotlib.colormaps["plasma"]
_CLEAR = 1.2
"""Clearance from which the image is white [m]."""
_SHOWN = 60
"""Number of roll-outs that are drawn, evenly spaced in the order of their costs."""
_FLOOR = 0.015
"""Height of lines above the floor [m]. On the floor they would flicker."""


class Lines(NamedTuple):
    """Line segments in {W}."""

    points: np.ndarray
    """``[N, 2, 3]`` end points [m]."""
    colours: np.ndarray
    """``[N, 2, 3]`` uint8 colours in linear light, because the browser converts line colours to sRGB."""


def _lines(points: Array, colours: Array) -> Lines:
    """Lines of a polyline ``[T, 2 or 3]`` or of several ``[S, T, ...]``, each with one colour (0 to 1)."""
    flat = np.asarray(points, dtype=np.float32)
    flat = flat[None] if flat.ndim == 2 else flat
    if flat.shape[-1] == 2:
        flat = np.concatenate([flat, np.full((*flat.shape[:-1], 1), _FLOOR, dtype=np.float32)], axis=-1)
    pairs = np.stack([flat[:, :-1], flat[:, 1:]], axis=2)
    shades = np.broadcast_to(np.atleast_2d(colours)[:, None, None, :3], pairs.shape)
    whole = np.isfinite(pairs).all(axis=(2, 3))
    return Lines(pairs[whole], np.round(255 * _linear(shades[whole])).astype(np.uint8))


def _linear(srgb: Array) -> np.ndarray:
    """Linear light of sRGB values, both 0 to 1."""
    values = np.asarray(srgb)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _rgb(colour: str) -> np.ndarray:
    return np.array(matplotlib.colors.to_rgb(colour))


def path(points: Array | None, local: bool = False) -> Lines:
    """Lines of a path ``[N, 2]`` in {W}; empty without one. ``local`` uses the colour of the local trajectory."""
    return _coloured(points, _LOCAL if local else COLOURS["plan"])


def _coloured(points: Array | None, colour: str) -> Lines:
    return _lines(np.zeros((1, 2)) if points is None else points, _rgb(colour))


def rollouts(plan: Plan | None, top: float = 0.0) -> Lines:
    """Predicted object positions of the roll-outs, coloured from the highest cost (dark) to the lowest (bright).

    They are drawn above ``top`` [m], the object's height. On the floor the object would hide them.
    """
    if plan is None:
        return path(None)
    costs = np.asarray(plan.costs)
    fit = np.flatnonzero(np.isfinite(costs))
    if not len(fit):
        return path(None)
    order = fit[np.argsort(-costs[fit])]
    chosen = order[np.unique(np.linspace(0, len(order) - 1, _SHOWN).astype(int))]
    places = np.asarray(plan.trajectories)[chosen, :, :2]
    height = top + _FLOOR + 0.05 * np.linspace(0.0, 1.0, len(chosen))[:, None, None]
    points = np.concatenate([places, np.broadcast_to(height, (*places.shape[:-1], 1))], axis=-1)
    return _lines(points, _COSTS(np.linspace(0.05, 0.95, len(chosen))))


def field_of_view(camera: Camera, pose: Array) -> Lines:
    """Boundary of the camera's field of view from the robot's ``pose [3]``. Walls are ignored."""
    half = min(camera.field_of_view / 2, np.pi)
    angles = float(pose[2]) + np.linspace(-half, half, 25)
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    near, far = (np.asarray(pose)[:2] + distance * rays for distance in (camera.near, camera.far))
    return _lines(np.concatenate([near[:1], far, near[::-1]]), _rgb(_CAMERA))


def believed(navigator: Machine, obs: Observation, sizes: Sequence[tuple[float, float]]) -> Lines:
    """Footprints of the objects in the robot's belief: detected now (blue), remembered (grey), fixed (red)."""
    parts = [path(None)]
    for index, item in navigator.belief.objects.items():
        if index >= len(sizes):
            continue
        colour = COLOURS["robot"] if bool(obs.detected[0, index]) else _REMEMBERED
        colour = COLOURS["registered"] if item.status is Status.FIXED else colour
        corners = outline(item.pose, np.asarray(sizes[index]) + 0.03)
        parts.append(_coloured(np.concatenate([corners, corners[:1]]), colour))
    return Lines(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def clearance_picture(field: DistanceField) -> np.ndarray:
    """Image ``[H, W, 3]`` uint8 of the distance to walls and known objects, row 0 at the bottom of the map."""
    near = np.clip(np.asarray(field.values) / _CLEAR, 0.0, 1.0)
    return (255 * matplotlib.colormaps["YlGnBu_r"](0.15 + 0.85 * near)[..., :3]).astype(np.uint8)


def legend(plan: Plan | None) -> str:
    """Legend of the colours as HTML, with the cost range of the roll-outs in ``plan``."""
    costs = np.zeros(0) if plan is None else np.asarray(plan.costs)
    costs = costs[np.isfinite(costs)]
    ends = (f"{costs.max():.1f}", f"{costs.min():.1f}") if len(costs) else ("", "")
    shades = ", ".join(matplotlib.colors.to_hex(_COSTS(x)) for x in np.linspace(0.05, 0.95, 7))
    bar = f"<div style='height: 9px; border-radius: 4px; background: linear-gradient(90deg, {shades})'></div>"
    names = {
        COLOURS["plan"]: "global path", _LOCAL: "local trajectory", _CAMERA: "camera's field of view",
        COLOURS["robot"]: "object seen now", _REMEMBERED: "remembered", COLOURS["registered"]: "immovable",
    }  # fmt: skip
    lines = "".join(f"<span style='color: {c}; font-weight: bold'>&#9473;</span> {n} &ensp;" for c, n in names.items())
    return (
        f"<div style='font-size: 0.8em; line-height: 1.5; margin: 0 0.8em 0.6em'>roll-outs of MPPI, by cost{bar}"
        f"<div style='display: flex; justify-content: space-between'><span>highest cost {ends[0]}</span>"
        f"<span>lowest cost {ends[1]}</span></div>{lines}</div>"
    )
