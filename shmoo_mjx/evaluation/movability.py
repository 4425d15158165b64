"""Criteria of the experiment object_planner beside roll-outs, and the open floor on which objects are probed."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import expit

from shmoo_mjx.arrays import Float
from shmoo_mjx.behavior.state import NavigatorConfig
from shmoo_mjx.evaluation.scenarios import entry_of
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.faces import faces_of
from shmoo_mjx.planning.maps import OCCUPIED, OccupancyGrid
from shmoo_mjx.planning.scenario import Limits, Scenario
from shmoo_mjx.plant.condition import Condition

FITTED = {"K": (0.817, 1.148), "impulse": (28.173, 3.931, -5.141), "moved_m": (13.111, 4.519)}
"""Criteria beside roll-outs: K of Algorithm 1, displacement and impulse, and displacement alone. Bias and slopes of
each logistic regression are fitted to touches of objects of training: python -m benchmarks.fit_criteria FOLDER"""
CRITERIA = ("reach", *FITTED)
"""What may decide after the first second of contact; the first is the navigator's own way."""
LEAST_K = 1e-4
"""A smaller K counts as this [m^2]."""
_LEAST_MOVED = 0.02
"""So that the camera's noise on an object that stands still says nothing [m]."""


def navigator_config() -> NavigatorConfig:
    """The navigator as it is, but on open floor it must not just walk round the object."""
    return NavigatorConfig(goes_round="never")


def open_floor(length: float = 9.0, width: float = 7.0, resolution: float = 0.05) -> OccupancyGrid:
    """A room with nothing in it."""
    cells = np.zeros((round(width / resolution), round(length / resolution)), dtype=np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = OCCUPIED
    return OccupancyGrid(cells, resolution)


def open_floor_scenario(condition: Condition, side: int, seed: int, time_s: float) -> Scenario:
    """The object in the middle of ``open_floor``, face ``side`` towards the robot, a little askew."""
    rng = np.random.default_rng([seed, 7])
    yaw = float(se2.wrap(-faces_of(condition.half_extents)[side][2] + rng.uniform(-0.15, 0.15)))
    return Scenario(
        start=(1.2, 3.5 + round(rng.uniform(-0.2, 0.2), 3), 0.0),
        goal=(7.8, 3.5),
        objects=(entry_of(condition, (3.6, 3.5, yaw)),),
        seed=seed,
        limits=Limits(time_s=time_s),
    )


def features_of(row: dict[str, Any], criterion: str) -> tuple[float, ...]:
    """What one of `FITTED` goes by after the first second of contact."""
    if criterion == "K":
        return (float(np.log(max(row["K_first"], LEAST_K))),)
    moved, impulse = float(np.log(row["moved_m_first"] + _LEAST_MOVED)), float(np.log(row["impulse_Ns_first"] + 1.0))
    return (moved,) if criterion == "moved_m" else (moved, impulse)


def probability_by(criterion: str, rows: list[dict[str, Any]]) -> Float[np.ndarray, "N"]:
    """Probability of being manipulable by a criterion after the first second of contact, of each of N touches."""
    if criterion == "reach":
        return np.array([row["probabilities"][0] for row in rows])
    bias, *slopes = FITTED[criterion]
    return np.array([expit(bias + np.dot(slopes, features_of(row, criterion))) for row in rows])
