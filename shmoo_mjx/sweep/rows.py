"""One row a world: what it was and what came of it."""

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
    """What is counted of a world's push."""

    time: Array
    """[s]"""
    contact: Array
    """Time with more than 2 N on the hands [s]."""
    lean: Array
    """Largest lean [rad]."""
    force: Array
    """Largest mean force over a sample [N]."""
    pose: Array
    """``[3]`` of the object in {W}, true."""


def rows_of(config: SweepConfig, worlds: Sequence[Drawn], ended: tuple[np.ndarray, Tally]) -> list[dict[str, Any]]:
    """One row a world: what it was and what came of it."""
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
    """What came of a world, in a word."""
    ended = {one_push.UNSTABLE: "unstable", one_push.FELL: "fell", one_push.APPROACH: "unfelt"}
    if phase in ended:
        return ended[phase]
    return "success" if near else "stuck" if moved < 0.1 else "astray"
