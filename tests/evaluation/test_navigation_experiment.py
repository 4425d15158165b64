"""The experiment navigation: its order, what it keeps, what policies know, and where it takes place."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from toy import toy_generated as generated
from toy import toy_scenario

from shmoo_mjx.base.assets import PAPER_WEIGHTS, asset
from shmoo_mjx.behavior.belief import Status
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation import navigation, navigation_places
from shmoo_mjx.evaluation.certify import Attempt, Certificate
from shmoo_mjx.evaluation.navigation import POLICIES
from shmoo_mjx.evaluation.navigation_places import BUILDINGS, extras_of, find_maps, find_places, kept_scenario
from shmoo_mjx.evaluation.registry import experiment_named, run_experiment
from shmoo_mjx.evaluation.result import ExperimentOptions
from shmoo_mjx.evaluation.scenarios import EXTRAS, Generated, ScenarioConfig
from shmoo_mjx.planning.maps import load_map, save_map


def test_policies_know_what_they_are_meant_to_know() -> None:
    found = generated(True, False)
    avoid, oracle = POLICIES["always_avoid"].first_status, POLICIES["oracle"].first_status
    assert avoid is not None and avoid(found) == [Status.FIXED] * 2
    assert oracle is not None and oracle(found) == [Status.UNKNOWN, Status.FIXED]
    assert POLICIES["ours"].first_status is None and POLICIES["always_push"].first_status is None
    goes_round = {name: policy.config.goes_round for name, policy in POLICIES.items()}
    assert goes_round["ours"] == goes_round["frozen"] == "when quicker"
    assert goes_round["lazy"] == "always" and goes_round["always_push"] == "never"


def test_policies_run_in_their_own_order_and_unknown_ones_are_refused() -> None:
    assert ExperimentOptions().chosen(POLICIES) == tuple(POLICIES)
    assert ExperimentOptions(policies=("always_push", "ours")).chosen(POLICIES) == ("ours", "always_push")
    with pytest.raises(ShmooError, match="--policies never"):
        ExperimentOptions(policies=("never",)).chosen(POLICIES)


def test_maps_are_found_below_a_folder(tmp_path: Path) -> None:
    grid, _ = toy_scenario(1, True)
    (tmp_path / "a").mkdir()
    save_map(grid, tmp_path / "a" / "one.yaml")
    save_map(grid, tmp_path / "two.yaml")
    (tmp_path / "scenario.yaml").write_text("start: [0, 0, 0]\n")
    save_map(grid, tmp_path / "floor 2 [new].yml")
    (tmp_path / "folder.yaml").mkdir()
    assert list(find_maps(tmp_path)) == ["a_one", "floor 2 [new]", "two"]
    save_map(grid, tmp_path / "a_one.yml")
    with pytest.raises(ShmooError, match="both called a_one"):
        find_maps(tmp_path)
    with pytest.raises(ShmooError, match="holds no map_server YAML"):
        find_maps(tmp_path / "a" / "nothing")


def test_without_maps_buildings_are_drawn(tmp_path: Path) -> None:
    places = find_places(ExperimentOptions(condition_seed=3), tmp_path, ScenarioConfig())
    assert len(places.maps) == BUILDINGS
    cells = [load_map(path).cells for path in places.maps.values()]
    assert any(a.shape != b.shape or (a != b).any() for a, b in pairwise(cells))
    assert len(find_places(ExperimentOptions(), tmp_path, ScenarioConfig(), most=2).maps) == 2


def test_ranges_of_the_extra_length_take_turns_and_none_stands_in_last() -> None:
    for name in ("depot", "willow"):
        orders = [extras_of(name, n) for n in range(10)]
        assert sorted(map(str, (order[0] for order in orders))) == sorted(map(str, EXTRAS))
        assert all({*order} == {*EXTRAS} and None not in order[1:-1] for order in orders)


def test_a_scenario_is_drawn_once_and_again_for_another_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Any] = []

    def draw(grid: Any, extra: Any, *rest: Any, **options: Any) -> Generated:
        drawn.append(extra)
        if extra != extras_of("building_0", 0)[1]:
            raise ShmooError("no place.")
        return generated(True)

    monkeypatch.setattr(navigation_places, "draw_scenario", draw)
    places = find_places(ExperimentOptions(), tmp_path, ScenarioConfig())
    grid = load_map(places.maps["building_0"])
    wanted, found = kept_scenario(places, grid, "building_0", 0)
    assert drawn == extras_of("building_0", 0)[:2] and found is not None and wanted == found.kind
    assert kept_scenario(places, grid, "building_0", 0) == (wanted, found) and len(drawn) == 2
    kept_scenario(places, load_map(places.maps["building_1"]), "building_0", 0)
    assert len(drawn) == 4


def test_the_oracle_pushes_what_the_best_certified_option_pushes() -> None:
    found = generated(True, True)
    way = {"face": 0, "lateral": 0.0, "steering": 0.0, "start": (0.0, 0.0, 0.0), "progress": 0.9}
    push = Attempt.model_validate(way | {"object": 1, "result": "free", "seconds": 30.0})
    told = Certificate(attempts=(push,), round_s=90.0, reference_s=30.0, best=(0,))
    oracle = POLICIES["oracle"].first_status
    assert oracle is not None and oracle(found.model_copy(update={"certificate": told})) == [
        Status.FIXED,
        Status.UNKNOWN,
    ]
    walk = Certificate(attempts=(push,), round_s=20.0, reference_s=20.0, best=())
    assert oracle(found.model_copy(update={"certificate": walk})) == [Status.FIXED] * 2


class FakeTrace(NamedTuple):
    robot_pose: Any = np.zeros((11, 3))
    object_pose: Any = np.zeros((11, 1, 3))
    force: Any = np.zeros((11, 2))


class FakeEpisode(NamedTuple):
    result: dict[str, Any]
    trace: FakeTrace = FakeTrace()


def fake_result(outcome: str) -> dict[str, Any]:
    pose = [0.0, 0.0, 0.0]
    item = {"start_pose": pose, "final_pose": pose, "half_extents": [0.3, 0.3], "status": "parked", "family": "box"}
    item["toppled"] = False
    numbers = {"falls": 0, "wall_contacts": 0, "wall_parts": {}, "time_s": 40.0, "path_length_m": 8.0}
    return numbers | {"decisions": []} | {"outcome": outcome, "reason": "state push", "objects": [item | {"id": 0}]}


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Stands for scenarios, runs, figures and films; the policies that have run, in order."""
    ran: list[str] = []

    def play(robot: Any, grid: Any, generated: Any, policy: str) -> FakeEpisode:
        ran.append(policy)
        return FakeEpisode(fake_result("timeout" if policy == "ours" and ran.count("ours") == 2 else "success"))

    monkeypatch.setattr(navigation, "play", play)
    monkeypatch.setattr(navigation, "kept_scenario", lambda *args: ("either", generated(True)))
    monkeypatch.setattr(navigation, "keep_failure", lambda store, name, episode: ran.append(f"kept {name}"))
    monkeypatch.setattr(navigation, "draw_figures", lambda *args: None)
    one = {name: replace(getattr(navigation.EXPERIMENT, name), workers=1) for name in ("config", "quick")}
    monkeypatch.setattr(navigation, "EXPERIMENT", replace(navigation.EXPERIMENT, **one))
    experiment_named.cache_clear()
    yield ran
    experiment_named.cache_clear()


def test_all_policies_run_on_all_scenarios_ours_first(tmp_path: Path, fakes: list[str]) -> None:
    result = run_experiment("navigation", ExperimentOptions(out=tmp_path, quick=True, senses="perfect"))
    assert fakes == [
        "ours",
        "ours",
        "kept building_1-0",
        *["lazy"] * 2,
        *["frozen"] * 2,
        *["oracle"] * 2,
        *["always_avoid"] * 2,
        *["always_push"] * 2,
        *["paper"] * 2,
        *["geometric"] * 2,
    ]
    assert result.metrics["success_rate"] == 0.5 and result.metrics["baseline_always_push_scenarios"] == 2
    assert result.config["senses"] == "perfect" and result.config["generated_maps"] is True
    assert {r["policy"] for r in result.rows} == set(POLICIES) and "driven" not in result.rows[0]
    assert "out of time in state push (1)" in (tmp_path / "navigation" / "failures.md").read_text()


def test_the_paper_runs_with_its_own_weights_and_pushing_and_the_others_with_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: dict[str, tuple[Path, str]] = {}
    monkeypatch.setattr(navigation, "controller_of", lambda weights, method: (weights, method))
    monkeypatch.setattr(
        "shmoo_mjx.run.episode.run_episode", lambda grid, scenario, controller, *rest, **more: controller
    )
    options = ExperimentOptions(weights=tmp_path / "mine.safetensors")
    for policy in POLICIES:
        ran[policy] = navigation.play(options, toy_scenario(1, True)[0], generated(True), policy)  # type: ignore[assignment]
    assert ran.pop("paper") == (asset(PAPER_WEIGHTS), "paper")
    assert ran.pop("frozen") == (options.weights, "frozen")
    assert set(ran.values()) == {(options.weights, "ours")}


def test_ours_alone_is_there_for_the_others_to_join(tmp_path: Path, fakes: list[str]) -> None:
    options = ExperimentOptions(out=tmp_path, scenarios=1, policies=("ours",))
    alone = run_experiment("navigation", options)
    assert fakes.count("ours") == BUILDINGS and set(alone.config["policies"]) == {"ours"}
    run_experiment("navigation", ExperimentOptions(out=tmp_path, scenarios=1))
    assert fakes.count("ours") == BUILDINGS and fakes.count("always_push") == BUILDINGS
    # Other senses, other runs.
    run_experiment("navigation", ExperimentOptions(out=tmp_path, scenarios=1, policies=("ours",), senses="perfect"))
    assert fakes.count("ours") == 2 * BUILDINGS


@pytest.mark.slow
def test_the_whole_experiment_on_a_floor_plan_and_again_from_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from shmoo_mjx.planning.floorplan import draw_floorplan

    (tmp_path / "maps").mkdir()
    save_map(draw_floorplan(np.random.default_rng(0)).grid, tmp_path / "maps" / "plan.yaml")
    options = ExperimentOptions(maps=tmp_path / "maps", scenarios=1, out=tmp_path / "out")
    first = run_experiment("navigation", options)
    assert first.metrics["falls"] == 0 and [r["policy"] for r in first.rows] == list(POLICIES)
    assert all(0.0 <= r["ins"] <= 1.0 for r in first.rows) and json.dumps(first.metrics)
    assert (tmp_path / "out" / "navigation" / "success.png").is_file()
    assert (tmp_path / "out" / "navigation" / "runs-plan.png").is_file()
    monkeypatch.setattr(navigation, "play", lambda *args: pytest.fail("a run that was kept is run again"))
    assert run_experiment("navigation", options).metrics == first.metrics
