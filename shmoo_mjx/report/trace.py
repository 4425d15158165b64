"""The two files of a run that the report draws: ``result.json`` (what happened) and ``trace.npz`` (every sample).

``result.json`` is an object with at least

    outcome         str, "success" or the word for what went wrong
    transitions     [{"t", "from", "to", "reason"}]
    decisions       [{"t", "object", "probability", "K", "G", "manipulable", "goal": [x, y, yaw] or null, "reason"}]
    objects         [{"id", "family", "start_pose", "final_pose", "half_extents", "registered"}], in the trace's order,
                    each with an optional "description" and "toppled"

and, drawn where present: ``reason`` (of the outcome), ``name``, ``seed``, ``time_s``, ``path_length_m``,
``goal_distance_m``, ``falls``, ``wall_contacts``, ``senses``, ``start`` and ``goal`` ([x, y, ...] in {W}),
``config`` and ``versions``. ``method`` and ``policy`` say what a replay takes.
A decision's ``object`` is an object's ``id``; its roll-outs stand in the trace at the decision's index.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.base.npz import read_arrays, write_arrays
from shmoo_mjx.errors import ShmooError

_RAGGED = ("plans", "decision_rollouts", "decision_candidates")
_REQUIRED = ("outcome", "transitions", "decisions", "objects")


class Trace(NamedTuple):
    """A run sampled every DT: T samples, N objects, D decisions. Poses in {W}, SI units."""

    t: Array
    """``[T]`` [s]"""
    robot_pose: Array
    """``[T, 3]``"""
    lean: Array
    """``[T, 2]`` [rad]"""
    u: Array
    """``[T, 3]`` applied command [rad]"""
    object_pose: Array
    """``[T, N, 3]``; NaN where an object's pose is not known"""
    force: Array
    """``[T, 2]`` force of the hands on the object in {R} [N]"""
    learned: Array
    """``[T, n]`` what has been learned of the object that is pushed; NaN where none is"""
    learned_names: tuple[str, ...]
    """n names of `online.summary`"""
    learned_object: Array
    """int ``[T]`` index of that object, -1 for none"""
    state: Array
    """int ``[T]`` index into ``state_names``"""
    state_names: tuple[str, ...]
    map_cells: Array
    """int8 ``[H, W]``, row 0 at the bottom: 0 free, 100 occupied, -1 unknown"""
    map_origin: Array
    """``[3]`` pose of the map's lower-left corner"""
    map_resolution: float
    """Side of a cell [m]"""
    plan_times: Array
    """``[P]`` when each path was planned [s]"""
    plans: tuple[Array, ...]
    """P paths ``[M_p, 2]``"""
    decision_rollouts: tuple[Array, ...]
    """D sets of the object's predicted positions ``[R_d, H_d, 2]``, a subset of the roll-outs"""
    decision_candidates: tuple[Array, ...]
    """D sets of candidate goals ``[C_d, 3]``"""


def save_trace(path: str | Path, trace: Trace) -> Path:
    """Writes ``trace.npz``; lists of arrays of unequal shape become numbered entries."""
    arrays: dict[str, np.ndarray] = {}
    for name, value in trace._asdict().items():
        if name in _RAGGED:
            arrays |= {f"{name}.{i:04d}": np.asarray(item, dtype=np.float32) for i, item in enumerate(value)}
        else:
            arrays[name] = np.asarray(value)
    return write_arrays(path, arrays)


def load_trace(path: str | Path) -> Trace:
    """Reads ``trace.npz``.

    Raises:
        ShmooError: the file is missing, damaged or lacks an entry.
    """
    source = Path(path)
    arrays = read_arrays(source, "trace")
    fields: dict[str, Any] = {}
    for name in Trace._fields:
        if name in _RAGGED:
            fields[name] = tuple(arrays[key] for key in sorted(arrays) if key.startswith(f"{name}."))
        elif name in arrays:
            fields[name] = arrays[name]
        else:
            raise ShmooError(f"{source}: entry '{name}' is missing; run the scenario again with this version.")
    for names in ("state_names", "learned_names"):
        fields[names] = tuple(str(name) for name in fields[names])
    fields["map_resolution"] = float(fields["map_resolution"])
    return Trace(**fields)


def load_result(path: str | Path) -> dict[str, Any]:
    """Reads ``result.json``.

    Raises:
        ShmooError: the file is missing, is no JSON object or lacks a key.
    """
    source = Path(path)
    try:
        result = json.loads(source.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ShmooError(f"{source}: there is no result here; give the folder of a finished run.") from None
    except (OSError, ValueError):
        raise ShmooError(f"{source}: this is no JSON; run the scenario again.") from None
    missing = [key for key in _REQUIRED if not isinstance(result, dict) or key not in result]
    if missing:
        raise ShmooError(f"{source}: key '{missing[0]}' is missing; run the scenario again with this version.")
    return result


def telling_decisions(result: dict[str, Any]) -> list[int]:
    """Decisions worth a picture: of each object the first, the last, and those that changed the verdict.

    A long push is reviewed every few seconds, mostly with the same outcome.
    """
    kept: list[int] = []
    by_object: dict[Any, list[int]] = {}
    for number, decision in enumerate(result["decisions"]):
        by_object.setdefault(decision["object"], []).append(number)
    for numbers in by_object.values():
        verdicts = [result["decisions"][n]["manipulable"] for n in numbers]
        changes = [n for n, a, b in zip(numbers[1:], verdicts[1:], verdicts, strict=False) if a != b]
        kept += {numbers[0], *changes, numbers[-1]}
    return sorted(kept)


def is_number(value: Any) -> bool:
    """Whether an entry of ``result.json`` is a finite number."""
    return isinstance(value, int | float) and bool(np.isfinite(value))


def object_name(result: dict[str, Any], name: Any) -> str:
    """What to call the object whose ``id`` is ``name``: its family and id."""
    index = object_index(result, name)
    return f"object {name}" if index is None else f"{result['objects'][index]['family']} {name}"


def object_index(result: dict[str, Any], name: Any) -> int | None:
    """Place in ``objects`` (and in the trace) of the object whose ``id`` is ``name``."""
    return next((i for i, item in enumerate(result["objects"]) if item["id"] == name), None)
