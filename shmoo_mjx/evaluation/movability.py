"""Alternative criteria of the experiment object_planner, and the open floor on which objects are probed."""

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
"""Criteria other than roll-outs: K of Algorithm 1, displacement with impulse, and displacement alone. Bias and slopes
of the logistic regressions are fitted to touches of training objects: python -m benchmarks.fit_criteria FOLDER"""
CRITERIA = ("reach", *FITTED)
"""Criteria after the first second of contact. The navigator uses the first one."""
LEAST_K = 1e-4
"""Lower bound of K [m^2]."""
_LEAST_MOVED = 0.02
"""Offset of displacements, so that camera noise on an object at rest has little effect [m]."""


def navigator_config() -> NavigatorConfig:
    """Settings of the navigator that do not allow it to go round the object, which the open floor would permit."""
    return NavigatorConfig(goes_round="never")


def open_floor(length: float = 9.0, width: float = 7.0, resolution: float = 0.05) -> OccupancyGrid:
    """An empty room. Lengths in m."""
    cells = np.zeros((round(width / resolution), round(length / resolution)), dtype=np.int8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = OCCUPIED
    return OccupancyGrid(cells, resolution)


def open_floor_scenario(condition: Condition, side: int, seed: int, time_s: float) -> Scenario:
    """The object in the middle of `open_floor`, with face ``side`` towards the robot and a small random yaw."""
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
    """Features of a criterion in `FITTED` after the first second of contact."""
    if criterion == "K":
        return (float(np.log(max(row["K_first"], LEAST_K))),)
    moved, impulse = float(np.log(row["moved_m_first"] + _LEAST_MOVED)), float(np.log(row["impulse_Ns_first"] + 1.0))
    return (moved,) if criterion == "moved_m" else (moved, impulse)


def probability_by(criterion: str, rows: list[dict[str, Any]]) -> Float[np.ndarray, "N"]:
    """Probability of being manipulable by a criterion, for each of N touches after the first second of contact."""
    if criterion == "reach":
        return np.array([row["probabilities"][0] for row in rows])
    bias, *slopes = FITTED[criterion]
    return np.array([expit(bias + np.dot(slopes, features_of(row, criterion))) for row in rows])
