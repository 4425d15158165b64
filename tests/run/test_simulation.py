"""A simulated world that diverges: whatever runs in it ends as a failure, with a reason, and keeps what it has."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest

from shmoo_mjx.base.assets import asset
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.data.collect import CollectConfig, record
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation import soak
from shmoo_mjx.evaluation.pushing_trials import Runner, draw_trials
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.live.scenes import scene_named
from shmoo_mjx.live.session import Session
from shmoo_mjx.plant.engine_mujoco import MujocoEngine, World
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.plant.observe import DIVERGED
from shmoo_mjx.report.trace import load_trace


@pytest.fixture(autouse=True)
def diverging(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a second after its start every world gets a NaN."""
    advance = MujocoEngine.advance

    def broken(self: MujocoEngine, world: World, *arguments: Any, **options: Any) -> Any:
        physics = world.physics.copy()
        physics[physics[:, 0] > 0.495, 3] = np.nan
        return advance(self, world._replace(physics=physics), *arguments, **options)

    monkeypatch.setattr(MujocoEngine, "advance", broken)


def test_a_run_ends_with_exit_code_1_a_reason_and_a_report_without_nan(
    shmoo: Callable[..., CompletedProcess[str]], tmp_path: Path
) -> None:
    scenario = str(asset("experiments/scenarios/box_in_doorway.yaml"))
    done = shmoo("navigate", "--scenario", scenario, "--no-video", "--out", str(tmp_path / "run"))
    assert done.returncode == 1 and DIVERGED in done.stdout
    result = json.loads((tmp_path / "run" / "result.json").read_text(), parse_constant=pytest.fail)
    assert (result["outcome"], result["reason"], result["falls"]) == ("diverged", DIVERGED, 0)
    assert result["time_s"] == pytest.approx(0.5)
    trace = load_trace(tmp_path / "run" / "trace.npz")
    assert np.isfinite(trace.robot_pose).all() and np.isfinite(trace.object_pose).all()


def test_a_pushing_trial_fails_with_a_reason() -> None:
    trial = draw_trials(1_000_000, 0, 1)[0]
    row, track = Runner(load_weights(), 60.0).run(trial, "ours")
    assert not row["success"] and not row["fell"]
    assert (row["ended"], row["reason"]) == ("diverged", DIVERGED)
    assert all(np.isfinite(values).all() for name, values in track.items() if name != "phase")
    json.dumps(row, allow_nan=False)


def test_no_recording_is_made_of_it() -> None:
    condition = draw_condition("box", 3)
    with pytest.raises(ShmooError, match="diverged"):
        list(record(CollectConfig(episodes=1, seconds=1.0), [condition], 0))


@pytest.mark.slow
def test_a_soak_ends_and_says_why() -> None:
    row = soak.play(soak.SoakTrials(minutes=2.0), 951, PushController(load_weights()))
    assert row["given_up"] == [DIVERGED] and row["errands"] == 1 and row["falls"] == 0
    assert row["simulated_s"] == pytest.approx(0.5)


def test_the_live_world_stands_still(tmp_path: Path) -> None:
    session = Session(load_weights(), lambda: scene_named("box_in_doorway", tmp_path), "perfect", tmp_path)
    for _ in range(9):
        session.step()
    assert session.simulation.time == pytest.approx(0.5) and session.simulation.history.ended
    assert np.isfinite(session.simulation.qpos).all()
    session.reset()
    session.step()
    assert session.simulation.time == pytest.approx(0.1)
    session.close()
