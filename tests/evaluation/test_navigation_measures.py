"""Scores and paired differences of the experiment navigation, and how failures are sorted."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from toy import toy_generated as generated

from shmoo_mjx.evaluation.certify import Attempt, Certificate
from shmoo_mjx.evaluation.navigation import POLICIES
from shmoo_mjx.evaluation.navigation_failures import keep_failure, write_failures
from shmoo_mjx.evaluation.navigation_figures import _time_over_extra
from shmoo_mjx.evaluation.navigation_measures import (
    EXTRA_BANDS,
    FAILURE_S,
    cause_of,
    choice_of,
    effort_by_force,
    effort_by_mass,
    interactive_score,
    measure,
)
from shmoo_mjx.evaluation.navigation_tables import navigation_tables, reference_table
from shmoo_mjx.evaluation.page import render_experiment
from shmoo_mjx.evaluation.paired import paired_difference
from shmoo_mjx.evaluation.result import ExperimentOptions, make_result
from shmoo_mjx.evaluation.tables import verdict
from shmoo_mjx.report.trace import Trace


def test_effort_is_the_robots_share_of_all_mass_moved() -> None:
    assert effort_by_mass(40.0, 10.0, [5.0, 20.0], [0.0, 0.0]) == 1.0
    assert effort_by_mass(40.0, 10.0, [10.0, 20.0], [2.0, 4.0]) == pytest.approx(400.0 / 500.0)
    assert effort_by_mass(40.0, 0.0, [10.0], [1.0]) == 1.0


def test_effort_is_the_robots_weight_beside_the_force_of_its_hands() -> None:
    assert effort_by_force(40.0, np.zeros((10, 2))) == 1.0
    weight = 40.0 * 9.81
    force = np.array([[0.6 * weight, -0.8 * weight], [0.0, 0.0]])
    assert effort_by_force(40.0, force) == pytest.approx(2.0 / 3.0)
    assert effort_by_force(40.0, np.zeros((0, 2))) == 1.0


def test_the_interactive_score_is_half_path_and_half_effort() -> None:
    assert interactive_score(1.0, 1.0, 1.0) == 1.0
    assert interactive_score(0.0, 0.8, 0.6) == pytest.approx(0.35)


def result(outcome: str, *states: str, judged: dict[int, bool] | None = None, state: str = "push") -> dict[str, Any]:
    return {
        "outcome": outcome,
        "reason": f"240 s were not enough; 1.00 m from the goal, state {state}",
        "objects": [{"status": s} for s in states],
        "decisions": [{"object": i, "manipulable": m} for i, m in (judged or {}).items()],
    }


@pytest.mark.parametrize(
    ("run", "movable", "cause"),
    [
        (result("success", "parked"), (True,), ""),
        (result("fall", "unknown"), (True,), "fall"),
        (result("wall contact", "parked"), (True,), "wall contact"),
        (
            result("wall contact", "parked") | {"wall_parts": {"torso": 2, "hand": 1, "ball": 0}},
            (True,),
            "wall contact: hand, torso",
        ),
        (result("timeout", "unknown"), (True,), "out of time in state push"),
        (result("timeout", "unknown", state="follow path"), (True,), "out of time in state follow path"),
        (
            result("timeout", "unknown", judged={0: True}),
            (False,),
            "out of time in state push, and an immovable object was judged movable",
        ),
        (result("blocked", "fixed", judged={0: False}), (True,), "a movable object was judged immovable"),
        (result("blocked", "parked", judged={0: True}), (False,), "an immovable object was judged movable"),
        (result("blocked", "fixed", judged={0: True}), (False,), "no way found past objects that can't be moved"),
        (result("blocked", "fixed"), (True,), "a movable object was given up"),
        (
            result("blocked", "fixed", "parked", judged={0: False}),
            (False, True),
            "an object was left where it blocks the way",
        ),
        (result("blocked", "fixed", judged={0: False}), (False,), "no way found past objects that can't be moved"),
    ],
)
def test_failures_are_sorted_by_cause(run: dict[str, Any], movable: tuple[bool, ...], cause: str) -> None:
    assert cause_of(run, generated(*movable)) == cause


def test_a_paired_difference_has_an_interval_that_holds_it() -> None:
    rng = np.random.default_rng(0)
    theirs = rng.normal(size=80)
    found = paired_difference(theirs + 0.5 + 0.3 * rng.normal(size=80), theirs)
    assert found is not None and found.pairs == 80
    # The pairs take out what trials differ by: the spread of 1 between them does not widen the interval.
    assert 0.3 < found.low < found.mean < found.high < 0.7
    assert paired_difference([1.0], [0.0]) is None
    same = paired_difference([1.0, 1.0, 1.0], [0.0, 0.0, 0.0])
    assert same is not None and same[:3] == (1.0, 1.0, 1.0)


def test_better_is_said_only_where_the_interval_excludes_zero() -> None:
    assert verdict(0.1, 0.3, True) == "better" and verdict(0.1, 0.3, False) == "worse"
    assert verdict(-0.3, -0.1, True) == "worse" and verdict(-0.3, -0.1, False) == "better"
    assert verdict(-0.1, 0.3, True) == "" and verdict(0.0, 0.0, True) == ""


def row(scenario: int, policy: str, success: bool, kind: str = "push only", time: float = 50.0) -> dict[str, Any]:
    numbers = {
        "falls": 0,
        "toppled": 0,
        "wall_contacts": 0,
        "time_s": time,
        "path_length_m": 8.0,
        "displacement_m": 1.0,
    }
    scores = {"efficiency": 0.5 * success, "effort": 0.9, "effort_force": 0.8, "ins": 0.25 * success + 0.425}
    about = {"map": "m", "scenario": scenario, "policy": policy, "kind": kind, "wanted": "push only"}
    objects = {"movable": [True, False], "blocking": [True, False]}
    return about | numbers | scores | objects | {"success": success, "cause": "" if success else "fall"}


ROWS = [
    *(row(0, p, p in ("ours", "always_push", "oracle")) for p in POLICIES),
    *(row(1, p, p in ("ours", "always_avoid", "oracle"), "detour only", 70.0 + 10.0 * (p == "ours")) for p in POLICIES),
    *(row(2, p, p in ("ours", "oracle")) for p in POLICIES),
    *(row(3, p, p == "oracle") for p in POLICIES),
]


def test_measures_of_every_policy_and_what_neither_baseline_can_do() -> None:
    metrics = measure(ROWS, tuple(POLICIES))
    assert metrics["success_rate"] == 0.75 and metrics["baseline_oracle_success_rate"] == 1.0
    assert metrics["baseline_always_avoid_success_rate"] == metrics["baseline_always_push_success_rate"] == 0.25
    assert metrics["time_s"] == pytest.approx((50 + 80 + 50) / 3) and metrics["efficiency"] == 0.375
    assert metrics["ins"] == pytest.approx(0.75 * 0.25 + 0.425)
    assert metrics["success_rate_push_only"] == pytest.approx(2 / 3) and metrics["success_rate_detour_only"] == 1.0
    assert metrics["success_rate_either"] is None
    assert (metrics["scenarios"], metrics["neither_baseline"], metrics["neither_baseline_but_ours"]) == (4, 2, 1)
    assert metrics["time_over_oracle"] == pytest.approx(180 / 170)


def test_kinds_and_objects_are_counted() -> None:
    metrics = measure(ROWS, tuple(POLICIES))
    assert (metrics["scenarios_push_only"], metrics["scenarios_detour_only"]) == (3, 1)
    assert metrics["scenarios_with_2_objects"] == metrics["scenarios_with_1_objects_in_the_way"] == 4


def test_differences_are_paired_and_times_are_those_that_both_solve() -> None:
    metrics = measure(ROWS, tuple(POLICIES))
    assert metrics["difference_oracle_success"] == -0.25 and metrics["difference_oracle_success_pairs"] == 4
    assert metrics["difference_oracle_success_low"] <= -0.25 <= metrics["difference_oracle_success_high"]
    assert (
        metrics["difference_oracle_time_s"] == pytest.approx(10 / 3) and metrics["difference_oracle_time_s_pairs"] == 3
    )
    # One scenario alone is solved by both.
    assert "difference_always_push_time_s" not in metrics


class _Touching(NamedTuple):
    force: Any
    robot_pose: Any
    object_pose: Any


def certified(touched: int | None, outcome: str = "success", time: float = 40.0) -> dict[str, Any]:
    """A run in a scenario with two objects: pushing the first takes 30 s, the second 32 s, going round 50 s."""
    way = {"face": 0, "lateral": 0.0, "steering": 0.0, "start": (0.0, 0.0, 0.0), "progress": 0.9, "result": "free"}
    pushes = [Attempt.model_validate(way | {"object": i, "seconds": 30.0 + 2 * i}) for i in range(2)]
    told = Certificate(attempts=tuple(pushes), round_s=50.0, reference_s=30.0, best=(0,))
    found = generated(True, True, kind="either", detour=14.0, certificate=told)
    force = np.zeros((5, 2))
    if touched is not None:
        force[2] = 9.0
    objects = np.tile([[2.0, 0.0, 0.0], [2.0, 4.0, 0.0]], (5, 1, 1))
    robot = np.tile([1.2, 4.0 * (touched or 0), 0.0], (5, 1))
    result = {"outcome": outcome, "time_s": time, "objects": [{"half_extents": [0.3, 0.3]}] * 2}
    return choice_of(result, _Touching(force, robot, objects), found)


def test_regret_is_time_minus_the_reference_and_a_failure_has_a_price() -> None:
    assert certified(0)["regret_s"] == 10.0 and certified(0, "timeout", 240.0)["regret_s"] == FAILURE_S


def test_a_first_choice_is_right_if_it_leads_nearly_as_quickly_to_the_goal() -> None:
    assert [certified(i)["first_choice"] for i in (0, 1, None)] == [0, 1, None]
    assert [certified(i)["right_choice"] for i in (0, 1, None)] == [True, True, False]


def test_policies_are_compared_with_the_certificates_of_what_can_be_solved() -> None:
    told = {"reference_s": 30.0, "first_choice": None, "right_choice": True, "outcome": "success"}
    rows = [
        row(n, policy, True, "either") | told | {"regret_s": 10.0 * n + 5.0 * (policy == "my_own:P"), "extra_m": extra}
        for policy in ("ours", "my_own:P")
        for n, extra in enumerate((2.0, 8.0, 40.0, None))
    ]
    none = dict.fromkeys(("reference_s", "regret_s", "first_choice", "right_choice", "extra_m"))
    rows += [row(9, p, False, "unsolvable") | none | {"outcome": "blocked"} for p in ("ours", "my_own:P")]
    metrics = measure(rows, ("ours", "my_own:P"))
    assert metrics["certified"] == 4 and metrics["success_rate_certified"] == 1.0 and metrics["regret_s"] == 15.0
    assert [metrics[f"regret_s_{band}"] for band in EXTRA_BANDS] == [0.0, 10.0, 20.0, 30.0]
    assert metrics["unsolvable"] == metrics["unsolvable_called_blocked"] == 1
    assert metrics["difference_my_own:P_regret_s"] == -5.0 and metrics["difference_my_own:P_regret_s_pairs"] == 4
    config = {"policies": ("ours", "my_own:P")}
    text = reference_table(make_result("navigation", ExperimentOptions(), config, metrics, paper={}, rows=rows))
    assert (
        "| my_own:P | 1.00 | 20.0 | 20.0 | 5.0 | 15.0 | 25.0 | 35.0 | 1.00 | 1 / 1 |" in text
        and "-5 (-5 to -5)" in text
    )
    assert _time_over_extra([r for r in rows if r["reference_s"] is not None]) is not None


def test_without_certificates_there_is_no_such_table() -> None:
    metrics = measure(ROWS, tuple(POLICIES))
    assert "certified" not in metrics
    config = {"policies": tuple(POLICIES)}
    assert reference_table(make_result("navigation", ExperimentOptions(), config, metrics, paper={}, rows=ROWS)) == ""


def test_some_policies_alone_are_measured_as_well() -> None:
    ours = measure([r for r in ROWS if r["policy"] == "ours"], ("ours",))
    assert ours["success_rate"] == 0.75 and not any(name.startswith(("baseline", "difference")) for name in ours)
    oracle = measure([r for r in ROWS if r["policy"] == "oracle"], ("oracle",))
    assert oracle["baseline_oracle_success_rate"] == 1.0 and "success_rate" not in oracle


def test_the_page_says_better_by_interval_and_what_failed() -> None:
    many = [r | {"scenario": 4 * k + r["scenario"]} for k in range(8) for r in ROWS]
    metrics = measure(many, tuple(POLICIES))
    found = make_result(
        "navigation", ExperimentOptions(senses="perfect"), {"policies": tuple(POLICIES)}, metrics, paper={}, rows=many
    )
    text = navigation_tables(found)
    assert "| Success rate | " in text and "| -0.25 (" in text and "**worse**" in text and "**better**" in text
    assert "| Objects in the scenario | 24 of 32 |" in text and "- fall: 8" in text
    page = render_experiment(found, [])
    assert text in page and "| Success rate, all scenarios | 0.75 | 0 | 0 | 0.25 | 0.25 | 0 | 0 | 1 |" in page
    assert "`shmoo experiment navigation --maps DIR --seed 0 --condition-seed 0 --senses perfect`" in page


class _Episode(NamedTuple):
    result: dict[str, Any]
    trace: Trace


def failed_episode() -> Any:
    count, blank = 21, np.zeros((21, 2))
    trace = Trace(
        t=np.arange(count) * 0.1,
        robot_pose=np.linspace([1.0, 1.0, 0.0], [2.0, 1.0, 0.0], count),
        lean=blank,
        u=np.zeros((count, 3)),
        object_pose=np.tile([3.0, 1.0, 0.0], (count, 1, 1)),
        force=blank,
        learned=np.zeros((count, 0)),
        learned_names=(),
        learned_object=np.full(count, -1),
        state=np.zeros(count, dtype=int),
        state_names=("push",),
        map_cells=np.zeros((40, 80), dtype=np.int8),
        map_origin=np.zeros(3),
        map_resolution=0.05,
        plan_times=np.zeros(0),
        plans=(),
        decision_rollouts=(),
        decision_candidates=(),
    )
    item = {"id": 0, "family": "box", "start_pose": [3, 1, 0], "final_pose": [3, 1, 0], "half_extents": [0.3, 0.3]}
    about = {"outcome": "timeout", "reason": "240 s were not enough", "goal": [3.5, 1.0]}
    return _Episode(about | {"objects": [item], "transitions": [], "decisions": []}, trace)


def test_each_failure_gets_a_film_and_a_line_below_its_cause(tmp_path: Path) -> None:
    store = tmp_path / "trials"
    keep_failure(store, "m-3", failed_episode())
    rows = [row(n, "ours", n == 0) | {"reason": f"reason {n}"} for n in (0, 2, 3)]
    text = write_failures(tmp_path, rows, store).read_text()
    assert text.startswith("# 2 of 3 runs failed\n\n## fall (2)\n")
    assert "- m-2, push only, 50 s: reason 2" in text
    assert "- [m-3](trials/failures/m-3.mp4), push only, 50 s: reason 3" in text
    keep_failure(store, "a [b] (c)-3", failed_episode())
    oddly_named = write_failures(tmp_path, [rows[2] | {"map": "a [b] (c)"}], store).read_text()
    assert "- [a \\[b\\] (c)-3](trials/failures/a%20%5Bb%5D%20%28c%29-3.mp4), push only" in oddly_named
    film = store / "failures" / "m-3.mp4"
    drawn = film.stat().st_mtime_ns
    assert film.stat().st_size > 1000
    write_failures(tmp_path, rows, store)
    assert film.stat().st_mtime_ns == drawn
    # What is run again is drawn again.
    keep_failure(store, "m-3", failed_episode())
    assert not film.exists()
