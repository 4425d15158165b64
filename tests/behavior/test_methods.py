"""Methods: what each runs with, that the paper's is as printed, and that its runs can be replayed."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest
from toy import toy_scenario

from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.behavior.methods import METHODS, method_named
from shmoo_mjx.behavior.state import NavigatorConfig
from shmoo_mjx.control.cost import PushCost
from shmoo_mjx.control.presets import PushConfig, pose_push_config
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.navigation import POLICIES
from shmoo_mjx.learning import online
from shmoo_mjx.learning.weights import load_weights
from shmoo_mjx.planning.maps import save_map
from shmoo_mjx.planning.scenario import Limits, ObjectEntry, save_scenario

Shmoo = Callable[..., CompletedProcess[str]]
PAPER = METHODS["paper"]


def test_ours_is_the_default_everywhere() -> None:
    ours = METHODS["ours"]
    assert (ours.pushing, ours.pose_pushing, ours.navigator) == (PushConfig(), pose_push_config(), NavigatorConfig())
    assert ours.load().info == load_weights().info


@pytest.mark.parametrize("config", [PAPER.pushing, PAPER.pose_pushing])
def test_the_papers_cost_is_eq_9_alone(config: PushConfig) -> None:
    weights = {f.name: getattr(config.cost, f.name) for f in fields(PushCost) if f.name.endswith("_weight")}
    assert weights.pop("yaw_weight") == 1.0
    assert weights and not any(weights.values())
    assert config.control.num_rollouts == 500 and config.control.horizon == 30 and config.control.temperature == 0.7


def test_the_papers_psi_is_as_printed_and_learned_by_eq_8() -> None:
    loaded = PAPER.load()
    assert loaded.config.object == ObjectConfig.paper()
    assert loaded.config.robot == load_weights().config.robot  # the shipped R
    learner = online.learner(loaded.config.object, PAPER.pushing.estimate, PAPER.pushing.adapt)
    assert isinstance(learner, online.Printed)
    assert not learner.config.to_prior and PAPER.pushing.adapts


def test_the_papers_navigator_decides_by_k() -> None:
    assert PAPER.navigator.decides_by == "K" and PAPER.navigator.planner.threshold == 0.3
    assert POLICIES["paper"].config == PAPER.navigator and POLICIES["paper"].method == "paper"
    assert all(policy.method == "ours" for name, policy in POLICIES.items() if name not in ("paper", "frozen"))


def test_frozen_is_ours_without_learning() -> None:
    frozen, ours = METHODS["frozen"], METHODS["ours"]
    assert replace(frozen.pushing, adapts=True) == ours.pushing and not frozen.pushing.adapts
    assert replace(frozen.pose_pushing, adapts=True) == ours.pose_pushing and not frozen.pose_pushing.adapts
    assert (frozen.weights, frozen.navigator) == (ours.weights, ours.navigator)


def test_weights_that_do_not_fit_the_method_are_refused() -> None:
    with pytest.raises(ShmooError, match=r"demo\.safetensors.* --form paper"):
        PAPER.load(asset(WEIGHTS))
    with pytest.raises(ShmooError, match="no method 'printed'; choose from ours, frozen, paper"):
        method_named("printed")


def navigate(shmoo: Shmoo, seconds: float, *objects: ObjectEntry) -> dict[str, Any]:
    """The result of a run of the paper's system in the folder run, of the given length."""
    grid, scenario = toy_scenario(1, True)
    save_map(grid, "rooms.yaml")
    short = {"map": "rooms.yaml", "objects": objects, "limits": Limits(time_s=seconds)}
    save_scenario(scenario.model_copy(update=short), Path("short.yaml"))
    done = shmoo("navigate", "--scenario", "short.yaml", "--no-video", "--method", "paper", "--out", "run")
    assert done.returncode == 1 and "timeout: " in done.stdout, done.stderr
    return dict(json.loads(Path("run/result.json").read_text()))


@pytest.mark.slow
def test_a_run_says_its_method_and_is_repeated_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shmoo: Shmoo
) -> None:
    monkeypatch.chdir(tmp_path)
    result = navigate(shmoo, 3.0)
    assert result["method"] == "paper" and result["config"]["navigator"]["decides_by"] == "K"
    assert result["weights"] == PAPER.load().info and not Path("run/weights.safetensors").exists()
    assert result["command"].endswith("--method paper --out run-again")
    assert shmoo("replay", "run").returncode == 0
    slow = replace(PAPER.navigator, trajectory=replace(PAPER.navigator.trajectory, speed=0.2))
    monkeypatch.setitem(METHODS, "paper", replace(PAPER, navigator=slow))
    done = shmoo("replay", "run")
    assert done.returncode == 1 and "differs" in done.stdout


@pytest.mark.slow
def test_a_push_of_the_papers_system_is_repeated_bit_for_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shmoo: Shmoo
) -> None:
    monkeypatch.chdir(tmp_path)
    box = toy_scenario(1, True)[1].objects[0].model_copy(update={"pose": (2.4, 2.025, 0.0)})
    navigate(shmoo, 14.0, box)
    with np.load("run/trace.npz") as trace:
        assert trace["learned_names"].tolist() == [f"a{k + 1}" for k in range(18)]
        assert len(np.unique(trace["learned"][np.isfinite(trace["learned"][:, 0]), 0])) > 5
    (decision, *_) = json.loads((tmp_path / "run/result.json").read_text())["decisions"]
    assert decision["probability"] is None and decision["K"] > 0.3 and decision["manipulable"]
    assert shmoo("replay", "run").returncode == 0
    # The pushing controller's settings count as well.
    monkeypatch.setitem(METHODS, "paper", replace(PAPER, pushing=METHODS["ours"].pushing))
    done = shmoo("replay", "run")
    assert done.returncode == 1 and "differs" in done.stdout


@pytest.mark.parametrize("command", [("demo", "--quick"), ("navigate", "--scenario", "short.yaml")])
def test_an_unknown_method_is_answered_with_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shmoo: Shmoo, command: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    grid, scenario = toy_scenario(1, True)
    save_map(grid, tmp_path / "rooms.yaml")
    save_scenario(scenario.model_copy(update={"map": "rooms.yaml"}), tmp_path / "short.yaml")
    for words, said in (
        (("--method", "papr"), "choose ours, frozen or paper"),
        (("--method", "paper", "--weights", str(asset(WEIGHTS))), "--form paper"),
    ):
        done = shmoo(*command, *words)
        assert done.returncode == 2 and said in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr
        assert not list(tmp_path.rglob("result.json"))
