"""Measures of the experiment navigation, and how failures are sorted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation import navigation
from shmoo_mjx.evaluation.navigation import POLICIES, cause_of, effort, find_maps, measure
from shmoo_mjx.evaluation.result import Ask
from shmoo_mjx.evaluation.scenarios import Generated, toy_scenario
from shmoo_mjx.navigation.belief import Status
from shmoo_mjx.navigation.maps import save_map


def generated(*movable: bool) -> Generated:
    return Generated(toy_scenario(1, True)[1], "push only", movable, (True,) * len(movable), 4.0, None)


def test_effort_is_the_robots_share_of_all_mass_moved() -> None:
    assert effort(40.0, 10.0, [5.0, 20.0], [0.0, 0.0]) == 1.0
    assert effort(40.0, 10.0, [10.0, 20.0], [2.0, 4.0]) == pytest.approx(400.0 / 500.0)
    assert effort(40.0, 0.0, [10.0], [1.0]) == 1.0


def result(outcome: str, *states: str, judged: tuple[int, ...] = (), state: str = "push") -> dict[str, Any]:
    return {
        "outcome": outcome,
        "reason": f"240 s were not enough; 1.00 m from the goal, state {state}",
        "objects": [{"status": s} for s in states],
        "decisions": [{"object": i, "manipulable": False} for i in judged],
    }


@pytest.mark.parametrize(
    ("run", "movable", "cause"),
    [
        (result("success", "parked"), (True,), ""),
        (result("fall", "unknown"), (True,), "fall"),
        (result("wall contact", "parked"), (True,), "wall contact"),
        (result("timeout", "unknown"), (True,), "out of time while to push"),
        (result("blocked", "fixed", judged=(0,)), (True,), "a movable object was judged immovable"),
        (result("blocked", "fixed"), (True,), "a movable object was given up"),
        (
            result("blocked", "fixed", "parked", judged=(0,)),
            (False, True),
            "an object was left where it blocks the way",
        ),
        (result("blocked", "fixed", judged=(0,)), (False,), "no way found past objects that can't be moved"),
    ],
)
def test_failures_are_sorted_by_cause(run: dict[str, Any], movable: tuple[bool, ...], cause: str) -> None:
    assert cause_of(run, generated(*movable)) == cause


def row(scenario: int, policy: str, success: bool, kind: str = "push only", time: float = 50.0) -> dict[str, Any]:
    numbers = {
        "falls": 0,
        "wall_contacts": 0,
        "time_s": time,
        "path_length_m": 8.0,
        "effort": 0.9,
        "displacement_m": 1.0,
    }
    names = {"map": "m", "scenario": scenario, "policy": policy, "kind": kind}
    return names | numbers | {"success": success, "efficiency": 0.5 * success, "cause": "" if success else "fall"}


def test_measures_of_every_policy_and_what_neither_baseline_can_do() -> None:
    rows = [
        *(row(0, p, p in ("ours", "always_push", "oracle")) for p in POLICIES),
        *(row(1, p, p in ("ours", "always_avoid", "oracle"), "detour only", 70.0) for p in POLICIES),
        *(row(2, p, p in ("ours", "oracle")) for p in POLICIES),
        *(row(3, p, p == "oracle") for p in POLICIES),
    ]
    metrics = measure(rows, tuple(POLICIES))
    assert metrics["success_rate"] == 0.75 and metrics["baseline_oracle_success_rate"] == 1.0
    assert metrics["baseline_always_avoid_success_rate"] == metrics["baseline_always_push_success_rate"] == 0.25
    assert metrics["time_s"] == pytest.approx((50 + 70 + 50) / 3) and metrics["efficiency"] == 0.375
    assert metrics["success_rate_push_only"] == pytest.approx(2 / 3) and metrics["success_rate_detour_only"] == 1.0
    assert metrics["success_rate_either"] is None
    assert (metrics["scenarios"], metrics["neither_baseline"], metrics["neither_baseline_but_ours"]) == (4, 2, 1)


def test_the_other_policies_are_compared_on_the_scenarios_that_they_ran() -> None:
    rows = [*(row(0, p, p == "ours") for p in POLICIES), row(1, "ours", False), row(2, "ours", False)]
    metrics = measure(rows, tuple(POLICIES))
    assert metrics["success_rate"] == pytest.approx(1 / 3)
    assert metrics["baseline_always_push_ours_success_rate"] == 1.0
    assert (metrics["scenarios"], metrics["scenarios_compared"]) == (3, 1)
    assert (metrics["neither_baseline"], metrics["neither_baseline_but_ours"]) == (1, 1)


def test_policies_know_what_they_are_meant_to_know() -> None:
    found = generated(True, False)
    avoid, oracle = POLICIES["always_avoid"].first_status, POLICIES["oracle"].first_status
    assert avoid is not None and avoid(found) == [Status.FIXED] * 2
    assert oracle is not None and oracle(found) == [Status.UNKNOWN, Status.FIXED]
    assert POLICIES["ours"].first_status is None and POLICIES["always_push"].first_status is None
    assert not POLICIES["always_push"].config.goes_round and POLICIES["ours"].config.goes_round


def test_maps_are_found_below_a_folder(tmp_path: Path) -> None:
    grid, _ = toy_scenario(1, True)
    (tmp_path / "a").mkdir()
    save_map(grid, tmp_path / "a" / "one.yaml")
    save_map(grid, tmp_path / "two.yaml")
    (tmp_path / "scenario.yaml").write_text("start: [0, 0, 0]\n")
    assert list(find_maps(tmp_path)) == ["a_one", "two"]
    with pytest.raises(ShmooError, match="holds no map_server YAML"):
        find_maps(tmp_path / "a" / "nothing")
    with pytest.raises(ShmooError, match="needs --maps"):
        find_maps(None)


@pytest.mark.slow
def test_the_whole_experiment_on_a_floor_plan_and_again_from_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from shmoo_mjx.navigation.floorplan import draw_floorplan

    (tmp_path / "maps").mkdir()
    save_map(draw_floorplan(np.random.default_rng(0)).grid, tmp_path / "maps" / "plan.yaml")
    ask = Ask(maps=tmp_path / "maps", scenarios=1, out=tmp_path / "out")
    first = navigation.run(ask)
    assert first.metrics["falls"] == 0 and {r["policy"] for r in first.rows} == set(POLICIES)
    assert (tmp_path / "out" / "navigation" / "success.png").is_file()
    assert (tmp_path / "out" / "navigation" / "runs-plan.png").is_file()
    monkeypatch.setattr(navigation, "_run_one", lambda *args: pytest.fail("a run that was kept is run again"))
    assert navigation.run(ask).metrics == first.metrics
