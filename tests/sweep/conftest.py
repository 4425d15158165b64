"""A simulator in no time: whether a push succeeds follows from the world as drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from shmoo_mjx.sweep.config import SweepConfig
from shmoo_mjx.sweep.worlds import Drawn


class Pretend:
    """Light objects arrive, heavy ones tip the robot over, the rest stays where it is."""

    batch, bytes, free = 4, 4_000_000, 10**9

    def __init__(self) -> None:
        self.simulated: list[int] = []

    def time_one(self) -> float:
        return 2.0

    def run(
        self, worlds: Sequence[Drawn], progress: Callable[[float], None] = lambda fraction: None
    ) -> list[dict[str, Any]]:
        rows = []
        for w in worlds:
            self.simulated.append(w.index)
            mass = w.values["object.mass"]
            outcome = "success" if mass < 12 else "fell" if mass > 35 else "stuck"
            row = {"world": w.index, "object_seed": w.condition.seed, **w.values, "outcome": outcome}
            row["object.resistance"] = 9.81 * mass * w.condition.friction
            rows.append(row | {"success": outcome == "success", "fell": outcome == "fell"})
        progress(1.0)
        return rows


@pytest.fixture
def pretend() -> Pretend:
    return Pretend()


@pytest.fixture
def config() -> SweepConfig:
    """22 worlds of two families under one controller, in shards of 5."""
    vary = {"object.mass": {"log_uniform": [2, 60]}, "object.friction": {"uniform": [0.1, 0.8]}}
    axes = ["object.mass", "object.friction"]
    return SweepConfig.model_validate(
        {"worlds": 11, "shard": 5, "families": ["box", "cart"], "vary": vary, "map": axes, "question": "how heavy?"}
    )
