"""Reads public data sets of planar pushes by real robots (``mit_push`` and ``mlab_triangle``).

A condition is one object on one surface: a pair of shape and surface, or the triangle with one support. Poses are
relative to the object's frame before the push, so results do not depend on the pose in the room.
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
    """Name of the object's shape. Conditions with the same shape have the same appearance."""
    start: np.ndarray
    """Position of the pusher before the push, in the object's frame before the push [m], ``[N, 2]``."""
    end: np.ndarray
    """Position of the pusher after the push, in the same frame [m], ``[N, 2]``."""
    motion: np.ndarray
    """Pose of the object after the push, in the same frame [m, m, rad], ``[N, 3]``."""
    touch: np.ndarray
    """Position of the pusher's centre at a moment of contact, in the object's frame at that moment [m], ``[N, 2]``."""
    published: dict[str, np.ndarray]
    """Motions that published models predict, by model, in the format of ``motion``."""
    touching_at_start: bool
    """Whether the recording starts at first contact. Otherwise there is a gap before contact."""
    tip_radius: float
    """Radius of the pusher [m]."""


def load(directory: Path) -> dict[str, dict[str, RealPushCondition]]:
    """Load the data sets in a folder.

    Args:
        directory: folder with ``mit_push/pushes_heldout_with_model_pred.csv``, ``mlab_triangle/pushes.csv`` or both.

    Returns:
        Conditions by name, by name of the data set.

    Raises:
        ShmooError: neither file exists, a column is missing, a value is not a finite number, or there are too few
            conditions or pushes.
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
    """Read ``mit_push``: cylindrical pusher of 4.75 mm radius, start at first contact, predictions of two models."""
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
    """Read ``mlab_triangle``: one triangle on several supports, start before contact, end on the outline."""
    columns = [*_POSES, "pusher_x0", "pusher_y0", "pusher_x1", "pusher_y1"]
    conditions = {}
    for (surface, support), values in _groups(path, ("surface", "support"), columns).items():
        before, after, start, end = np.split(values, [3, 6, 8], axis=1)
        touch, motion = se2.inverse_transform_point(after, end), se2.relative(before, after)
        start, end = (se2.inverse_transform_point(before, point) for point in (start, end))
        conditions[f"{surface}/{support}"] = RealPushCondition("triangle", start, end, motion, touch, {}, False, 0.0)
    return conditions


def _groups(path: Path, keys: tuple[str, str], columns: Sequence[str]) -> dict[tuple[str, str], np.ndarray]:
    """Read the numbers of ``columns``, grouped by the values of two key columns."""
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
