"""Fit the criteria that the experiment object_planner compares roll-outs with to touches of objects of training.

Each object is probed with real senses by the navigator as it is. Finished touches are kept in the folder, so a stopped
run goes on. 124 objects take half an hour on two cores.

uv run python -m benchmarks.fit_criteria FOLDER
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.evaluation.manipulable import manipulable
from shmoo_mjx.evaluation.movability import FITTED, features_of
from shmoo_mjx.evaluation.object_planner import ObjectPlannerTrials, draw_object, probe
from shmoo_mjx.evaluation.trials import run_trials

FIRST_SEEDS = (300_000, 301_000)
"""Below a million, where the objects of training are."""
OBJECTS = 62
SHRINKAGE = 0.1
"""Of the slopes towards zero, as a variance of 10 would give it; without any a draw that the features separate would be
called certain."""


def main() -> None:
    """Print bias and slopes of each criterion."""
    folder, cfg = Path(sys.argv[1]), ObjectPlannerTrials()
    objects = {f"{first}-{index:03d}": (first, index) for first in FIRST_SEEDS for index in range(OBJECTS)}
    rows = run_trials(objects, partial(touch, cfg), folder, _report, workers=cfg.workers)
    truths = np.array([row["manipulable"] for row in rows], dtype=float)
    print(f"from {len(rows)} objects, {truths.sum():.0f} manipulable")
    for criterion in FITTED:
        x = np.array([features_of(row, criterion) for row in rows])
        print(f"after 1 s, {criterion}:", np.round(regression(x, truths), 3).tolist())


def _report(stage: str, done: float) -> None:
    print(f"{stage}: {done:.0%}")


def touch(cfg: ObjectPlannerTrials, trial: tuple[int, int]) -> list[dict[str, Any]]:
    """What one second of contact tells of an object, and the truth; nothing if it was never touched."""
    first, index = trial
    condition, side, _ = draw_object(index, first, cfg.truth)
    told, _ = probe(condition, side, first + index, cfg=cfg, weights=asset(WEIGHTS))
    return [told | {"manipulable": manipulable(condition, told["side"], cfg.truth)}] if told else []


def regression(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bias and slopes ``[1 + F]`` of least regularised log loss, of features ``x [N, F]`` and truths ``y [N]``."""

    def loss(b: np.ndarray) -> float:
        z = b[0] + x @ b[1:]
        return float(np.sum(np.logaddexp(0.0, z) - y * z) + 0.5 * SHRINKAGE * np.sum(b[1:] ** 2))

    return np.asarray(minimize(loss, np.zeros(1 + x.shape[1])).x)


if __name__ == "__main__":
    main()
