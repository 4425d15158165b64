"""A made-up run with two objects, two decisions and lists of unequal length."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from shmoo_mjx.learning import online
from shmoo_mjx.report import html
from shmoo_mjx.report.trace import Trace

STATES = ("follow path", "approach", "probe", "push", "retreat", "replan", "done")


def make_trace(yaw: float = 0.0) -> Trace:
    """40 s on an 8 m x 6 m floor with a wall; a box is pushed aside, a wheelchair stays."""
    t = np.arange(0, 40, 0.1)
    cells = np.zeros((60, 80), dtype=np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    cells[25:28, 20:50] = 100
    cells[40:60, 70:80] = -1
    x = np.interp(t, [0, 10, 20, 25, 40], [1.0, 2.6, 3.6, 3.2, 7.0])
    y = np.interp(t, [0, 10, 20, 30, 40], [1.2, 1.5, 1.6, 3.6, 4.4])
    objects = np.tile(np.array([[3.2, 1.5, 0.1], [5.8, 3.4, 1.1]]), (len(t), 1, 1))
    objects[:, 0, 0] += np.interp(t, [12, 20], [0, 1.1])
    pushing = (t > 12) & (t < 20)
    rng = np.random.default_rng(0)
    wander = np.exp(np.cumsum(rng.normal(size=(len(t), 3, 1)) * pushing[:, None, None] * 0.05, axis=0) + 1)
    wander = (wander * [0.8, 1.0, 1.3]).reshape(len(t), 9)
    ends = [np.array([3.2, 1.5]) + np.linspace(0, 1, 50)[:, None] * rng.normal([1, 0], 0.3, (1, 2)) for _ in range(40)]
    fan = np.stack(ends)
    stuck = np.tile([5.8, 3.4], (30, 50, 1)) + 0.05 * rng.normal(size=(30, 1, 2)) * np.linspace(0, 1, 50)[None, :, None]
    return Trace(
        t=t,
        robot_pose=np.stack([x, y, 0.1 * np.sin(t)], axis=-1),
        lean=0.1 * np.stack([np.sin(t), np.cos(t)], axis=-1) * pushing[:, None],
        u=0.1 * np.stack([np.sin(t + 0.2), np.cos(t), 0 * t], axis=-1) * pushing[:, None],
        object_pose=objects,
        force=np.stack([20 + np.sin(3 * t), 2 * np.cos(t)], axis=-1) * pushing[:, None],
        learned=wander,
        learned_names=online.NAMES,
        learned_object=np.where(pushing, 0, np.where(t > 28, 1, -1)),
        state=np.digitize(t, [10, 12, 13, 20, 22, 24]).clip(0, 6),
        state_names=STATES,
        map_cells=cells,
        map_origin=np.array([0.0, 0.0, yaw]),
        map_resolution=0.1,
        plan_times=np.array([0.0, 22.0]),
        plans=(
            np.array([[1.0, 1.2], [7.0, 1.5], [7.0, 4.4]]),
            np.array([[3.6, 1.6], [5.5, 2.0], [6.8, 3.0], [7.0, 4.4]]),
        ),
        decision_rollouts=(fan, stuck),
        decision_candidates=(np.concatenate([fan[::3, -1], np.zeros((14, 1))], axis=1), np.zeros((0, 3))),
    )


def make_result() -> dict[str, Any]:
    return {
        "name": "demo",
        "outcome": "success",
        "seed": 3,
        "time_s": 39.9,
        "path_length_m": 9.31,
        "goal_distance_m": 0.14,
        "falls": 0,
        "wall_contacts": 0,
        "start": [1.0, 1.2, 0.0],
        "goal": [7.0, 4.4],
        "transitions": [
            {"t": 0.0, "from": "start", "to": "follow path", "reason": "path of 9.1 m found"},
            {"t": 10.0, "from": "follow path", "to": "approach", "reason": "box-1 blocks the path 0.6 m ahead"},
            {"t": 12.0, "from": "approach", "to": "probe", "reason": "hands <on> the face"},
            {"t": 13.0, "from": "probe", "to": "push", "reason": "K = 1.9 m²: it moves"},
            {"t": 22.0, "from": "push", "to": "replan", "reason": "the object left the path"},
        ],
        "decisions": [
            {
                "t": 13.0,
                "object": "box-1",
                "K": 1.91,
                "G": 0.8,
                "manipulable": True,
                "goal": [4.3, 1.5, 0.1],
                "reason": "closest of 14 reachable collision-free goals",
            },
            {
                "t": 30.0,
                "object": "chair-2",
                "K": 0.012,
                "G": 0.03,
                "manipulable": False,
                "goal": None,
                "reason": "K = 0.012 m² < 0.3 m²",
            },
        ],
        "objects": [
            {
                "id": "box-1",
                "family": "box",
                "start_pose": [3.2, 1.5, 0.1],
                "final_pose": [4.3, 1.5, 0.1],
                "half_extents": [0.25, 0.3],
                "true": {"mass": 6.0, "friction_x": 23.5, "friction_y": 24.5},
                "registered": False,
            },
            {
                "id": "chair-2",
                "family": "wheelchair",
                "start_pose": [5.8, 3.4, 1.1],
                "final_pose": [5.8, 3.4, 1.1],
                "half_extents": [0.5, 0.33],
                "registered": True,
            },
        ],
        "config": {"samples": 500, "horizon": 30},
        "versions": {"mujoco": "3.17.0", "shmoo_mjx": "0.1.0"},
    }


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages without figures, which take 5 s to draw."""
    monkeypatch.setattr(html, "to_png", lambda figure, dpi=0: b"\x89PNG")


@pytest.fixture
def trace() -> Trace:
    return make_trace()


@pytest.fixture
def result() -> dict[str, Any]:
    return make_result()
