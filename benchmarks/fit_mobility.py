"""Fit the logistic regression of `shmoo_mjx.navigation.mobility` to touches of objects of training, and the criteria
of the experiment object_planner.

Each object is probed for four seconds of contact, with real senses and by the navigator as it is but for its verdict.
Finished touches are kept in the folder, so a stopped run goes on. 124 objects take half an hour on two cores.

uv run python benchmarks/fit_mobility.py FOLDER
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from shmoo_mjx.assets import WEIGHTS, asset
from shmoo_mjx.episode import Hooks, run_episode
from shmoo_mjx.evaluation.manipulable import manipulable
from shmoo_mjx.evaluation.object_planner import (
    CRITERIA,
    ObjectPlannerTrials,
    after_a_second,
    calibration,
    draw_object,
    features_of,
    navigator_config,
    open_floor,
    open_floor_scenario,
)
from shmoo_mjx.evaluation.trials import controller_of, run_trials
from shmoo_mjx.navigation.mobility import features
from shmoo_mjx.navigation.verdicts import PROBE_TIME
from shmoo_mjx.types import DT

FIRST_SEEDS = (300_000, 301_000)
"""Below a million, where the objects of training are."""
OBJECTS = 62
LOOKS = np.arange(1.0, 4.01, 0.25)
"""Contact times that are fitted [s]."""
SHRINKAGE = 0.1
"""Of the two slopes towards zero, as a variance of 10 would give it; without any a draw that two features separate
would be called certain."""


def main() -> None:
    """Print the coefficients, and how well the navigator's, fitted to all other objects, tell each object."""
    folder, cfg = Path(sys.argv[1]), ObjectPlannerTrials()
    objects = {f"{first}-{index:03d}": (first, index) for first in FIRST_SEEDS for index in range(OBJECTS)}
    rows = run_trials(
        objects, partial(touch, cfg), folder, lambda stage, done: print(f"{stage}: {done:.0%}"), cfg.workers
    )
    rows = [r for r in rows if r["looks"]]
    truth = np.array([r["manipulable"] for r in rows])
    print("bias, moved, impulse:", np.round(fit(rows), 3), f"from {len(rows)} objects, {truth.sum()} manipulable")
    others = [fit([r for r in rows if r is not row]) for row in rows]
    for k, look in enumerate(LOOKS):
        p = np.array([told(row, k, found) for row, found in zip(rows, others, strict=True)])
        right = np.mean((p >= 0.5) == truth)
        print(f"after {look:.2f} s: {right:.3f} right, calibration error {calibration(p, truth):.3f}")
    touched = [row for row in rows if "K_first" in row]
    truths = np.array([row["manipulable"] for row in touched], dtype=float)
    for criterion in CRITERIA:
        x = np.array([features_of(row, criterion) for row in touched])
        print(f"after 1 s, {criterion}:", np.round(regression(x, truths), 3).tolist())


def touch(cfg: ObjectPlannerTrials, trial: tuple[int, int]) -> list[dict[str, Any]]:
    """(distance moved, impulse) of one object at each of `LOOKS`; none if it was never touched."""
    first, index = trial
    condition, side, _ = draw_object(index, first, cfg.truth)
    never = replace(navigator_config(), sure=1.0, decide_after=cfg.time_s)
    samples: list[tuple[float, float, float]] = []
    first_second: dict[str, Any] = {}
    controller = controller_of(asset(WEIGHTS))

    def over(navigator: Any) -> bool:
        push = navigator.segment.push if navigator.segment is not None else None
        # A touch that was lost and taken up again counts once it has lasted longer than the one before.
        if push is not None and (not samples or push.contact_time >= samples[-1][0]):
            moved = push.moved(navigator.belief.objects[0].pose)
            samples.append((push.contact_time, moved, push.impulse))
            if not first_second and push.contact_time >= PROBE_TIME:
                first_second.update(after_a_second(navigator, controller))
        return bool(samples) and samples[-1][0] >= LOOKS[-1]

    scenario = open_floor_scenario(condition, side, first + index, cfg.time_s)
    episode = run_episode(open_floor(), scenario, controller, never, Hooks(over=over))
    if episode.navigator.segment is not None:
        side = episode.navigator.segment.side
    return [first_second | {"manipulable": manipulable(condition, side, cfg.truth), "looks": looks(np.array(samples))}]


def looks(samples: np.ndarray) -> list[list[float]]:
    """The first sample at or after each of `LOOKS`; what rolls ahead of the hands is looked at for its last one."""
    if not len(samples) or samples[-1, 0] < DT:
        return []
    at = np.minimum(np.searchsorted(samples[:, 0], LOOKS - 1e-6), len(samples) - 1)
    return samples[at, 1:].tolist()


def fit(rows: list[dict[str, Any]]) -> np.ndarray:
    """Bias and slopes ``[3]`` of least regularised log loss; each object counts as three looks, as they are alike."""
    x = np.array([features(*look) for row in rows for look in row["looks"]])
    y = np.repeat([row["manipulable"] for row in rows], len(LOOKS)).astype(float)

    return regression(x, y, 3 / len(LOOKS))


def regression(x: np.ndarray, y: np.ndarray, weight: float = 1.0) -> np.ndarray:
    """Bias and slopes ``[1 + F]`` of least regularised log loss, of features ``x [N, F]`` and truths ``y [N]``."""

    def loss(b: np.ndarray) -> float:
        z = b[0] + x @ b[1:]
        return float(weight * np.sum(np.logaddexp(0.0, z) - y * z) + 0.5 * SHRINKAGE * np.sum(b[1:] ** 2))

    return np.asarray(minimize(loss, np.zeros(1 + x.shape[1])).x)


def told(row: dict[str, Any], look: int, b: np.ndarray) -> float:
    """The probability that ``b`` gives an object at one look."""
    return float(expit(b[0] + b[1:] @ features(*row["looks"][look])))


if __name__ == "__main__":
    main()
