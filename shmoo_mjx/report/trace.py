"""The two input files of the report: ``result.json`` (events and outcome) and ``trace.npz`` (every sample).

``result.json`` is an object with at least

    outcome         str, "success" or a word for the kind of failure
    transitions     [{"t", "from", "to", "reason"}]
    decisions       [{"t", "object", "probability", "K", "G", "manipulable", "goal": [x, y, yaw] or null, "reason"}]
    objects         [{"id", "family", "start_pose", "final_pose", "half_extents", "registered"}], in the trace's order,
                    each with an optional "description" and "toppled"

Optional entries, which the report shows if they exist, are ``reason`` (of the outcome), ``name``, ``seed``, ``time_s``,
``path_length_m``, ``goal_distance_m``, ``falls``, ``wall_contacts``, ``senses``, ``start`` and ``goal`` ([x, y, ...] in
{W}), ``config`` and ``versions``. A replay uses ``method`` and ``policy``. The ``object`` of a decision is the ``id``
of an object. The roll-outs of a decision have the same index in the trace. A decision by expected times also has
``options``: [{"text", "works_s", "mean_s", "probability"}], see `shmoo_mjx.behavior.state.Option`.
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
    """Times ``[T]`` [s]."""
    robot_pose: Array
    """Poses of the robot ``[T, 3]``."""
    lean: Array
    """Lean towards +x and +y of {R} ``[T, 2]`` [rad]."""
    u: Array
    """Applied commands ``[T, 3]`` [rad]."""
    object_pose: Array
    """Poses of the objects ``[T, N, 3]``; NaN if unknown."""
    force: Array
    """Force of the hands on the object in {R} ``[T, 2]`` [N]."""
    learned: Array
    """Estimated properties of the pushed object ``[T, n]``; NaN without a pushed object."""
    learned_names: tuple[str, ...]
    """Names of the n properties, from `online.summary`."""
    learned_object: Array
    """Index of the pushed object, int ``[T]``; -1 for none."""
    state: Array
    """State of the navigator as an index into ``state_names``, int ``[T]``."""
    state_names: tuple[str, ...]
    """Names of the states."""
    map_cells: Array
    """Cells of the map, int8 ``[H, W]``, row 0 at the bottom: 0 free, 100 occupied, -1 unknown."""
    map_origin: Array
    """Pose of the map's lower-left corner ``[3]``."""
    map_resolution: float
    """Side of a cell [m]."""
    plan_times: Array
    """Time at which each path was planned ``[P]`` [s]."""
    plans: tuple[Array, ...]
    """P planned paths ``[M_p, 2]``."""
    decision_rollouts: tuple[Array, ...]
    """Predicted positions of the object for each of D decisions ``[R_d, H_d, 2]``, a subset of the roll-outs."""
    decision_candidates: tuple[Array, ...]
    """Candidate goals of each of D decisions ``[C_d, 3]``."""


def save_trace(path: str | Path, trace: Trace) -> Path:
    """Write ``trace.npz``. Lists of arrays with different shapes become numbered entries."""
    arrays: dict[str, np.ndarray] = {}
    for name, value in trace._asdict().items():
        if name in _RAGGED:
            arrays |= {f"{name}.{i:04d}": np.asarray(item, dtype=np.float32) for i, item in enumerate(value)}
        else:
            arrays[name] = np.asarray(value)
    return write_arrays(path, arrays)


def load_trace(path: str | Path) -> Trace:
    """Read ``trace.npz``.

    Raises:
        ShmooError: the file is missing or damaged, or lacks an entry.
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
    """Read ``result.json``.

    Raises:
        ShmooError: the file is missing, is not a JSON object, or lacks a key.
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
    """Indices of the key decisions: for each object the first, the last, and those that changed the verdict.

    The other decisions repeat the verdict: a long push is reviewed every few seconds, mostly with the same outcome.
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
    """True if an entry of ``result.json`` is a finite number."""
    return isinstance(value, int | float) and bool(np.isfinite(value))


def object_index(result: dict[str, Any], name: Any) -> int | None:
    """Index in ``objects`` and in the trace of the object whose ``id`` is ``name``; None if there is none."""
    return next((i for i, item in enumerate(result["objects"]) if item["id"] == name), None)
