"""Result rows of a sweep, one per world."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.behavior.skills import one_push
from shmoo_mjx.geometry import se2
from shmoo_mjx.sweep.config import SweepConfig
from shmoo_mjx.sweep.parameters import RESISTANCE
from shmoo_mjx.sweep.worlds import Drawn


class Tally(NamedTuple):
    """Running statistics of a world's push."""

    time: Array
    """Time since the start [s]."""
    contact: Array
    """Total time with more than CONTACT_FORCE (2 N) on the hands [s]."""
    lean: Array
    """Largest lean [rad]."""
    force: Array
    """Largest force of the hands, as a mean over one sample [N]."""
    pose: Array
    """True pose of the object in {W} [m, rad], ``[3]``."""


def rows_of(config: SweepConfig, worlds: Sequence[Drawn], ended: tuple[np.ndarray, Tally]) -> list[dict[str, Any]]:
    """Result rows with the parameters and the outcome of each world.

    Args:
        config: configuration of the sweep.
        worlds: drawn worlds.
        ended: final phase (see `one_push`) and statistics of each world.
    """
    phases, tally = ended
    rows = []
    for i, w in enumerate(worlds):
        pose = np.asarray(tally.pose[i], dtype=float)
        offset = float(np.linalg.norm(pose[:2] - w.goal[:2]))
        turned = float(np.rad2deg(abs(se2.wrap(pose[2] - w.goal[2]))))
        moved, near = float(np.linalg.norm(pose[:2])), offset <= config.tolerance_m and turned <= config.tolerance_deg
        outcome = _outcome(int(phases[i]), near, moved)
        values: dict[str, Any] = {"world": w.index, "object_seed": w.condition.seed, **w.values}
        values |= {"object.length": w.condition.size[0], "object.width": w.condition.size[1]}
        values |= {RESISTANCE: w.condition.resistance}
        rows.append(values | {
            "outcome": outcome, "success": outcome == "success", "fell": outcome == "fell",
            "offset_m": offset, "yaw_error_deg": turned, "moved_m": moved, "time_s": float(tally.time[i]),
            "contact_s": float(tally.contact[i]), "largest_lean_rad": float(tally.lean[i]),
            "largest_force_N": float(tally.force[i]),
            "final_x": pose[0], "final_y": pose[1], "final_yaw": pose[2],
        })  # fmt: skip
    return rows


def _outcome(phase: int, near: bool, moved: float) -> str:
    """Outcome of a world.

    Args:
        phase: final phase of `one_push`.
        near: whether the object is within the goal's tolerances.
        moved: distance of the object from its start [m].
    """
    ended = {one_push.UNSTABLE: "unstable", one_push.FELL: "fell", one_push.APPROACH: "unfelt"}
    if phase in ended:
        return ended[phase]
    return "success" if near else "stuck" if moved < 0.1 else "astray"
