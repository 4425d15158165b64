"""Soak: what counts as a livelock, and a short form of the real thing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from shmoo_mjx.behavior.state import Mode, Transition
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.evaluation.soak import SoakTrials, livelocks, play
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.run.simulation import History, Sample


def _record(speed: float) -> History:
    history = History()
    for t in np.arange(0.0, 3.0, 0.1):
        pose = np.array([speed * t, 0.0, 0.0])
        none = np.zeros(3)
        history.rows.append(Sample(float(t), pose, none[None], none[:2], none, none[:2], None, -1, 0))
    return history


def _back_and_forth(period: float) -> list[Transition]:
    times = np.arange(0.5, 2.5, period)
    pairs: list[Any] = [(Mode.REPLAN, Mode.FOLLOW, "a way"), (Mode.FOLLOW, Mode.REPLAN, "no way")]
    return [Transition(float(t), *pairs[i % 2]) for i, t in enumerate(times)]


def test_a_state_entered_again_within_a_second_without_moving_is_a_livelock() -> None:
    assert livelocks(_back_and_forth(0.2), _record(0.0)) > 3
    assert livelocks(_back_and_forth(0.2), _record(0.5)) == 0
    assert livelocks(_back_and_forth(0.8), _record(0.0)) == 0


@pytest.mark.slow
def test_errands_in_a_building_where_others_move_objects() -> None:
    row = play(SoakTrials(minutes=2.0, moved_every=20.0), 951, PushController(load_weights()))
    assert row["falls"] == row["livelocks"] == row["open_files_left"] == 0
    assert row["errands"] >= 4 and row["done"] >= 0.8 * row["errands"]
    assert row["moved"] >= 2
