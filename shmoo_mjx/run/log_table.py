"""Reads the table of a user's own recording: columns as arrays, with plausibility checks."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.base.schema import closest_name
from shmoo_mjx.errors import ShmooError

REQUIRED = ("t", "object_x", "object_y", "object_yaw", "force_x", "force_y")
OPTIONAL = ("torque", "robot_x", "robot_y", "robot_yaw")

_SLOWEST = 0.12
"""Maximum median time between two rows [s]."""
_NOTHING = ("", "nan", "na", "n/a", "#n/a", "null", "none")
"""Cell contents that mean an unknown number."""
_LONGEST = (60.0, 4 * 3600.0)
"""Maximum time between two rows, and from the first to the last row [s]."""
_FARTHEST = (
    dict.fromkeys(("object_x", "object_y", "robot_x", "robot_y"), 100.0)
    | dict.fromkeys(("object_yaw", "robot_yaw"), 1000.0)
    | dict.fromkeys(("force_x", "force_y", "torque"), 10_000.0)
)
"""Maximum deviation of a column's values from its median [m, rad, N, N m]."""


def read_columns(file: Path) -> dict[str, np.ndarray]:
    """The known columns ``[N]`` of a CSV or Parquet file by name; NaN where a number is unknown.

    Columns of a CSV file are separated by commas, semicolons or tabs. The first row below the header is row 1.

    Raises:
        ShmooError: the file can't be read, a column is missing or occurs twice, a value is not a finite number, or
            times do not increase by small steps. The message names the column, and the row if one is wrong.
    """
    if not file.is_file():
        raise ShmooError(f"{file}: there is no such file; give a log as CSV or Parquet.")
    try:
        columns = (_parquet if file.suffix.lower() in (".parquet", ".pq") else _csv)(file)
    except (OSError, ValueError, RuntimeError, csv.Error):  # pyarrow's errors are of these kinds
        raise ShmooError(f"{file}: this is no CSV with a header, and no Parquet file (*.parquet).") from None
    _check_values(file, columns)
    _check_times(file, columns["t"])
    return columns


def _places(file: Path, names: list[str]) -> dict[str, int]:
    """Positions of the known columns among all columns."""
    for name in REQUIRED:
        if name not in names:
            near = closest_name(name, names)
            hint = near if near.startswith("did") else f"there are {', '.join(names)[:120]}."
            raise ShmooError(f"{file}: the column '{name}' is missing; {hint}")
    for name in (*REQUIRED, *OPTIONAL):
        if names.count(name) > 1:
            raise ShmooError(f"{file}: the column '{name}' stands {names.count(name)} times; keep one of them.")
    return {name: names.index(name) for name in (*REQUIRED, *OPTIONAL) if name in names}


def _parquet(file: Path) -> dict[str, np.ndarray]:
    from pyarrow import parquet

    names = parquet.read_schema(file).names
    places = _places(file, [name.strip() for name in names])
    table = parquet.read_table(file, columns=[names[i] for i in places.values()])
    return {name: _numbers(file, name, table[names[i]].to_pylist()) for name, i in places.items()}


def _csv(file: Path) -> dict[str, np.ndarray]:
    """Reads a CSV file. The separator is the one that splits the header into the most known names."""
    with file.open(encoding="utf-8-sig", newline="") as opened:
        lines = (line for line in opened if line.strip())
        header = next(lines, "")

        def split(delimiter: str) -> list[str]:
            return [name.strip() for name in next(csv.reader([header], delimiter=delimiter), [])]

        delimiter = max(",;\t", key=lambda d: len({*REQUIRED, *OPTIONAL} & {*split(d)}))
        names = split(delimiter)
        if not any(names):
            raise ValueError
        places, rows = _places(file, names), list(csv.reader(lines, delimiter=delimiter))
    for number, row in enumerate(rows, 1):
        if len(row) < len(names) or any(cell.strip() for cell in row[len(names) :]):
            remedy = "write a point for a decimal comma" if len(row) > len(names) else "give every column a cell"
            raise ShmooError(f"{file}: row {number} has {len(row)} cells, the header {len(names)}; {remedy}.")
    return {name: _numbers(file, name, [row[i] for row in rows]) for name, i in places.items()}


def _numbers(file: Path, name: str, values: list[Any]) -> np.ndarray:
    """The values of a column; NaN for empty cells."""
    numbers = np.full(len(values), np.nan)
    for i, value in enumerate(values):
        text = "" if value is None else str(value).strip()
        if text.lower() in _NOTHING:
            continue
        try:
            numbers[i] = float(text)
        except ValueError:
            comma = re.fullmatch(r"[+-]?\d*,\d+(e[+-]?\d+)?", text, re.IGNORECASE)
            remedy = "write a point for the decimal comma." if comma else "give numbers, or nothing where unknown."
            raise ShmooError(f"{file}: row {i + 1}: the column '{name}' holds {text[:40]!r}; {remedy}") from None
    return numbers


def _check_values(file: Path, columns: dict[str, np.ndarray]) -> None:
    if not len(columns["t"]):
        raise ShmooError(f"{file}: has a header but no rows; give a recording.")
    for name, values in columns.items():
        endless = np.flatnonzero(np.isinf(values))
        if endless.size:
            row = int(endless[0]) + 1
            raise ShmooError(f"{file}: row {row}: '{name}' is not finite; leave the cell empty if it is not known.")
        if name in REQUIRED and np.isnan(values).all():
            raise ShmooError(f"{file}: the column '{name}' holds no numbers; fill it in.")


def _check_times(file: Path, t: np.ndarray) -> None:
    steps = np.diff(t)
    back = np.flatnonzero(steps <= 0)
    if np.isnan(t).any() or back.size:
        row = int(back[0]) + 2 if back.size else int(np.flatnonzero(np.isnan(t))[0]) + 1
        raise ShmooError(f"{file}: the column 't' must grow from row to row, in s; row {row} does not.")
    gap, most = _LONGEST
    if steps.size and steps.max() > gap:
        row = int(steps.argmax()) + 2
        raise ShmooError(
            f"{file}: row {row}: 't' is {t[row - 1]:g}, which is {steps.max():g} s after the row before it; give it in "
            f"s, and cut a recording that pauses for more than {gap:g} s."
        )
    if len(t) < 10 or t[-1] - t[0] < 1.0 or np.median(steps) > _SLOWEST:
        raise ShmooError(f"{file}: give at least 1 s with 10 rows each second; 't' has {len(t)} from {t[0]:g} s on.")
    if t[-1] - t[0] > most:
        raise ShmooError(f"{file}: 't' spans {t[-1] - t[0]:g} s; cut the recording to {most:g} s or less.")


def check_extents(file: Path, columns: dict[str, np.ndarray]) -> None:
    """Checks that no value is far from the others of its column.

    Raises:
        ShmooError: a value is too far away. The message names the row and the column.
    """
    for name, values in columns.items():
        limit = _FARTHEST.get(name, np.inf)
        if np.isnan(values).all():
            continue
        away = np.abs(np.nan_to_num(values - np.nanmedian(values)))
        if away.max() > limit:
            row = int(away.argmax()) + 1
            raise ShmooError(
                f"{file}: row {row}: '{name}' is {values[row - 1]:g}, more than {limit:g} from the column's "
                "median; correct it, or leave the cell empty."
            )


def in_degrees(columns: dict[str, np.ndarray]) -> list[str]:
    """Warnings about yaws that exceed a whole turn and may therefore be in degrees."""
    sentences = []
    for name in ("object_yaw", "robot_yaw"):
        largest = float(np.nanmax(np.abs(columns.get(name, np.zeros(1))), initial=0.0))
        if largest > 2 * np.pi:
            sentences.append(
                f"'{name}' goes up to {largest:.0f}, which is more than a whole turn; "
                "if it is in degrees, give it in rad."
            )
    return sentences
