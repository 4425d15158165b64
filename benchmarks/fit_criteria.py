"""Fits the criteria that the experiment `object_planner` compares with roll-outs, on touches of training objects.

The shipped navigator probes each object with realistic sensing. Finished touches are kept in the folder, so an
interrupted run can resume. 124 objects take half an hour on two cores.

Run: uv run python -m benchmarks.fit_criteria FOLDER
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
"""First seeds of the two sets of objects. Seeds below one million belong to training objects."""
OBJECTS = 62
SHRINKAGE = 0.1
"""Weight of the quadratic penalty on the slopes, equal to a prior variance of 10. Without it, the fit would be certain
of its decisions if the features separate the objects perfectly."""


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
    """The row of one object: measures after 1 s of contact, and the ground truth. No row if it was never touched."""
    first, index = trial
    condition, side, _ = draw_object(index, first, cfg.truth)
    told, _ = probe(condition, side, first + index, cfg=cfg, weights=asset(WEIGHTS))
    return [told | {"manipulable": manipulable(condition, told["side"], cfg.truth)}] if told else []


def regression(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bias and slopes ``[1 + F]`` of a regularised logistic regression on features ``x [N, F]``, truths ``y [N]``."""

    def loss(b: np.ndarray) -> float:
        z = b[0] + x @ b[1:]
        return float(np.sum(np.logaddexp(0.0, z) - y * z) + 0.5 * SHRINKAGE * np.sum(b[1:] ** 2))

    return np.asarray(minimize(loss, np.zeros(1 + x.shape[1])).x)


if __name__ == "__main__":
    main()
