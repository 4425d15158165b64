"""Recorded planar pushes of other people's robots: folders with ``mit_push`` and ``mlab_triangle`` in them.

A condition is one object on one surface: a shape-surface pair, or the triangle with one support. Everything is in the
frame the object had before the push, so the pose in the room plays no part.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.geometry import se2

_POSES = ("obj_x0", "obj_y0", "obj_th0", "obj_x1", "obj_y1", "obj_th1")
_FEWEST = 10


class RealPushCondition(NamedTuple):
    """N pushes of one object on one surface."""

    shape: str
    """Conditions of one shape look the same."""
    start: np.ndarray
    """``[N, 2]`` pusher before the push, in the object's frame before the push [m]."""
    end: np.ndarray
    """``[N, 2]`` pusher after the push, in the same frame [m]."""
    motion: np.ndarray
    """``[N, 3]`` the object's pose after the push, in the same frame [m, m, rad]."""
    touch: np.ndarray
    """``[N, 2]`` where the pusher's centre was while it touched, in the object's own frame at that moment [m]."""
    published: dict[str, np.ndarray]
    """``[N, 3]`` motions that published models predict."""
    touching_at_start: bool
    """Whether a recording starts at first contact; otherwise there is a gap before it."""
    tip_radius: float
    """Of the pusher [m]."""


def load(directory: Path) -> dict[str, dict[str, RealPushCondition]]:
    """Data sets by name, each with its conditions by name.

    Args:
        directory: holds ``mit_push/pushes_heldout_with_model_pred.csv``, ``mlab_triangle/pushes.csv`` or both.

    Raises:
        ShmooError: neither is there, or one lacks a column, a number or enough pushes.
    """
    readers = {
        "mit_push": ("pushes_heldout_with_model_pred.csv", _mit_push),
        "mlab_triangle": ("pushes.csv", _mlab_triangle),
    }
    paths = {name: directory / name / file for name, (file, _) in readers.items()}
    data = {name: readers[name][1](path) for name, path in paths.items() if path.is_file()}
    if not data:
        wanted = " or ".join(f"{name}/{file}" for name, (file, _) in readers.items())
        raise ShmooError(f"{directory}: holds neither {wanted}; give the folder of recorded pushes with --data.")
    return data


def _mit_push(path: Path) -> dict[str, RealPushCondition]:
    """Cylinder of 4.75 mm radius; recordings start at first contact and carry two models' predictions."""
    models = {"quadratic": "quad", "poly4": "poly4"}
    predicted = [f"pred_{short}_{axis}1" for short in models.values() for axis in ("x", "y", "th")]
    columns = [*_POSES, "tip_x0", "tip_y0", "tip_x1", "tip_y1", *predicted]
    conditions = {}
    for (surface, shape), values in _groups(path, ("surface", "shape"), columns).items():
        before, after, start, end, poses = np.split(values, [3, 6, 8, 10], axis=1)
        start, end = (se2.inverse_transform_point(before, point) for point in (start, end))
        split = zip(models, np.split(poses, len(models), axis=1), strict=True)
        published = {name: se2.relative(before, pose) for name, pose in split}
        motion = se2.relative(before, after)
        conditions[f"{surface}/{shape}"] = RealPushCondition(shape, start, end, motion, start, published, True, 0.00475)
    return conditions


def _mlab_triangle(path: Path) -> dict[str, RealPushCondition]:
    """One triangle on several supports; recordings start before contact and end on the outline itself."""
    columns = [*_POSES, "pusher_x0", "pusher_y0", "pusher_x1", "pusher_y1"]
    conditions = {}
    for (surface, support), values in _groups(path, ("surface", "support"), columns).items():
        before, after, start, end = np.split(values, [3, 6, 8], axis=1)
        touch, motion = se2.inverse_transform_point(after, end), se2.relative(before, after)
        start, end = (se2.inverse_transform_point(before, point) for point in (start, end))
        conditions[f"{surface}/{support}"] = RealPushCondition("triangle", start, end, motion, touch, {}, False, 0.0)
    return conditions


def _groups(path: Path, keys: tuple[str, str], columns: Sequence[str]) -> dict[tuple[str, str], np.ndarray]:
    """The columns' numbers by the values of two keys."""
    groups: dict[tuple[str, str], list[list[float]]] = {}
    try:
        with path.open(newline="") as file:
            reader = csv.DictReader(file)
            missing = [c for c in (*keys, *columns) if c not in (reader.fieldnames or ())]
            if missing:
                raise ShmooError(
                    f"{path}: has no column {missing[0]!r}; give a file with the columns of the data page."
                )
            for number, row in enumerate(reader, start=2):
                groups.setdefault((row[keys[0]], row[keys[1]]), []).append(_numbers(path, number, row, columns))
    except UnicodeDecodeError:
        raise ShmooError(f"{path}: is not text; give a CSV file.") from None
    if len(groups) < 3:
        raise ShmooError(f"{path}: has {len(groups)} conditions; give at least 3, so that one can be left out.")
    for key, rows in groups.items():
        if len(rows) < _FEWEST:
            what = "/".join(key)
            raise ShmooError(f"{path}: {what} has {len(rows)} pushes; give at least {_FEWEST} of each condition.")
    return {key: np.asarray(rows) for key, rows in sorted(groups.items())}


def _numbers(path: Path, number: int, row: dict[str, str], columns: Sequence[str]) -> list[float]:
    values = []
    for column in columns:
        try:
            value = float(row[column])
        except (TypeError, ValueError):
            value = np.nan
        if not np.isfinite(value):
            raise ShmooError(f"{path}: line {number}, {column}: {row[column]!r} is no finite number; repair the line.")
        values.append(value)
    return values
