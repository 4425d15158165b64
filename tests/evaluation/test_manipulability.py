"""The truth about pushes, the measures of the experiment object_planner, and trials that outlive a stop."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.evaluation.experiment import Setup
from shmoo_mjx.evaluation.manipulable import (
    SteadyPush,
    draw_immovable,
    manipulable,
    near_border,
    near_border_by_load,
    steady_push,
)
from shmoo_mjx.evaluation.movability import CRITERIA, open_floor_scenario, probability_by
from shmoo_mjx.evaluation.object_planner import (
    ObjectPlannerTrials,
    _trial,
    auc,
    calibration,
    draw_border_object,
    draw_object,
    log_score,
    measure,
    probe,
)
from shmoo_mjx.evaluation.result import ExperimentOptions
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.geometry.faces import faces_of, heading
from shmoo_mjx.plant.objects import draw_condition

QUICK = SteadyPush(seconds=4.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mass", "friction", "moves"), [(3.0, 0.4, True), (12.0, 0.4, True), (40.0, 0.6, False), (90.0, 0.5, False)]
)
def test_a_box_moves_if_its_friction_is_below_what_the_robot_can_push(
    mass: float, friction: float, moves: bool
) -> None:
    """At 0.15 rad the robot balances some 95 N at the height of its hands."""
    box = draw_condition("box", 3, {"mass": mass, "payload": 0.0, "friction": friction})
    moved = steady_push(box, 0)
    assert (moved >= SteadyPush().distance) == moves
    assert moves or moved < 0.05


def test_a_box_that_is_fixed_to_the_floor_stays() -> None:
    assert steady_push(draw_immovable("fixed", "box", 7), 2, QUICK) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("family", "locked", "side"), [("wheelchair", 1, 0), ("wheelchair", 1, 2), ("cart", 0, 0)])
def test_what_turns_away_about_a_locked_wheel_is_not_manipulable(family: str, locked: int, side: int) -> None:
    """It would come as far if it might turn as it likes, and it does so on free wheels."""
    wheels = [i == locked for i in range(4)]
    turning = draw_condition(family, 5, {"locked": wheels, "payload": 10.0})
    assert not manipulable(turning, side) and manipulable(turning, side, SteadyPush(turn=np.pi))
    assert manipulable(draw_condition(family, 5, {"locked": [False] * 4, "payload": 10.0}), side)


@pytest.mark.slow
@pytest.mark.parametrize("side", range(4))
def test_progress_is_along_the_push_whichever_face_is_pushed(side: int) -> None:
    assert steady_push(draw_condition("box", 3, {"mass": 3.0, "payload": 0.0, "friction": 0.4}), side) > 0.3


@pytest.mark.slow
@pytest.mark.parametrize("index", range(4))
def test_objects_are_drawn_as_the_plant_has_them(index: int) -> None:
    condition, side, kind = draw_object(index, 1_000_000, SteadyPush())
    assert (steady_push(condition, side) >= SteadyPush().distance) == (kind == "drawn") == (index % 2 == 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "seed", "side", "moves", "near"),
    [("wheelchair", 5049, 1, False, True), ("cart", 5017, 1, True, True), ("cart", 5031, 3, True, False)],
)
def test_near_the_border_lies_what_nearly_moves_or_only_just(
    family: str, seed: int, side: int, moves: bool, near: bool
) -> None:
    condition = draw_condition(family, seed)
    assert (manipulable(condition, side), near_border(condition, side)) == (moves, near)


@pytest.mark.slow
@pytest.mark.parametrize(("index", "kind"), [(6, "drawn"), (9, "heavy")])
def test_a_load_brings_an_object_near_the_border_on_the_side_that_is_pushed(index: int, kind: str) -> None:
    condition, side, drawn = draw_border_object(index, 1_000_000, SteadyPush(), lambda _, side: (side + 1) % 4)
    pushed = (side + 1) % 4
    assert drawn == kind and near_border(condition, pushed)
    assert manipulable(condition, pushed) == (index % 2 == 0)


@pytest.mark.slow
def test_the_navigator_pushes_the_side_on_which_an_object_is_near_the_border(tmp_path: Path) -> None:
    row = _trial(Setup(ExperimentOptions(condition_seed=10), ObjectPlannerTrials(), tmp_path, tmp_path), ("border", 4))[
        0
    ]
    assert row["border"] and row["manipulable"]


@pytest.mark.slow
def test_a_probe_is_asked_after_each_second_or_at_the_end_of_what_rolls_away() -> None:
    light = draw_condition("cart", 5, {"locked": [False] * 4, "payload": 0.0, "rolling": [0.01] * 4})
    told, episode = probe(light, 0, 3, cfg=ObjectPlannerTrials(), weights=asset(WEIGHTS))
    assert len(told["probabilities"]) == 3 and told["probabilities"][-1] > 0.8 and told["moved_m_first"] > 0.02
    assert episode.result["time_s"] < 20.0
    fixed, _ = probe(draw_immovable("fixed", "box", 7), 2, 3, cfg=ObjectPlannerTrials(), weights=asset(WEIGHTS))
    assert len(fixed["probabilities"]) == 3 and max(fixed["probabilities"][1:]) < 0.2
    never, _ = probe(light, 0, 3, cfg=ObjectPlannerTrials(time_s=2.0), weights=asset(WEIGHTS))
    assert never == {}


@pytest.mark.slow
def test_what_is_fixed_comes_near_the_border_by_no_load() -> None:
    assert near_border_by_load(draw_immovable("fixed", "box", 7), 2, False, QUICK) is None


def test_what_is_fixed_is_not_near_the_border() -> None:
    assert not near_border(draw_immovable("fixed", "box", 7), 2, QUICK)


def test_kinds_differ_in_what_holds_them() -> None:
    assert draw_immovable("heavy", "cart", 1).payload > 150
    assert sum(draw_immovable("brakes", "wheelchair", 1).locked) == 2
    assert sum(draw_immovable("brakes", "cart", 1).locked) == 2
    assert draw_immovable("fixed", "cart", 1).locked == (True,) * 4


def test_the_open_floor_shows_the_chosen_face() -> None:
    condition = draw_condition("cart", 2)
    for side, face in enumerate(faces_of(condition.half_extents)):
        scenario = open_floor_scenario(condition, side, 3, 10.0)
        # Pushing that face pushes along +x, the robot's way.
        assert abs(heading(np.array(scenario.objects[0].pose), face)) < 0.16


def test_auc() -> None:
    truth = np.array([False] * 5 + [True] * 5)
    apart = np.array([0.0, 0.1, 0.2, 0.1, 0.0, 1.0, 2.0, 1.5, 3.0, 1.2])
    assert auc(apart, truth) == 1.0
    assert auc(-apart, truth) == 0.0
    assert auc(np.ones(10), truth) == 0.5
    assert np.isnan(auc(apart[:5], truth[:5]))


def row(manipulable: bool, said: float | None, k: float = 1.0, later: float = 0.9) -> dict[str, Any]:
    found = {"manipulable": manipulable, "border": k == 0.1}
    first = {"K_first": k, "moved_m_first": k / 5, "impulse_Ns_first": 50.0}
    return found if said is None else found | first | {"probabilities": [said, later, later]}


def test_measures_count_objects_that_were_not_touched_as_mistakes() -> None:
    rows = [row(True, 0.9, 2.0), row(True, 0.2, 0.1), row(False, 0.1, 0.01), row(False, None)]
    metrics = measure(rows)
    assert metrics["accuracy"] == metrics["accuracy_reach_after_1s"] == 0.5 and metrics["undecided"] == 1
    assert metrics["accuracy_3s"] == 0.5 and measure([row(True, 0.2)])["accuracy_2s"] == 1.0
    assert metrics["accuracy_clear"] == pytest.approx(2 / 3) and metrics["near_border"] == 1
    assert metrics["accuracy_K_after_1s"] == 0.5
    assert metrics["manipulable_called_manipulable"] == 1 and metrics["manipulable_called_immovable"] == 1
    assert metrics["immovable_called_immovable"] == 1 and metrics["immovable_called_manipulable"] == 0
    assert metrics["auc_K_after_1s"] == 1.0


def test_the_log_score_is_that_of_what_came_true() -> None:
    truth = np.array([True, False, False])
    assert log_score(np.full(3, 0.5), truth) == pytest.approx(np.log(0.5))
    assert log_score(np.array([0.9, 0.2, 0.1]), truth) == pytest.approx((2 * np.log(0.9) + np.log(0.8)) / 3)
    # What was called impossible costs much, and not infinitely much.
    assert -20 < log_score(np.array([0.0]), truth[:1]) < -10


def test_each_criterion_is_more_certain_the_more_has_been_seen_to_move() -> None:
    little, much = row(True, 0.1, 0.05), row(True, 0.9, 2.0)
    for criterion in CRITERIA:
        low, high = probability_by(criterion, [little, much])
        assert low < 0.5 < high, criterion


def test_calibration_is_the_mean_gap_between_what_is_said_and_what_is() -> None:
    truth = np.arange(10) < 7
    assert calibration(np.full(10, 0.7), truth) == pytest.approx(0.0)
    assert calibration(np.full(10, 0.9), truth) == pytest.approx(0.2)
    # Gaps of different bins do not make up for each other.
    assert calibration(np.where(truth, 0.9, 0.1), truth) == pytest.approx(0.1)


def test_trials_go_on_where_they_were_stopped(tmp_path: Path) -> None:
    calls: list[str] = []

    def work(name: str) -> list[dict[str, Any]]:
        calls.append(name)
        if name == "c" and len(calls) == 3:
            raise KeyboardInterrupt
        return [{"name": name}]

    def silent(stage: str, fraction: float) -> None:
        return None

    names = {name: name for name in "abc"}
    with pytest.raises(KeyboardInterrupt):
        run_trials(names, work, tmp_path, silent, workers=1)
    rows = run_trials(names, work, tmp_path, silent, workers=1)
    assert calls == ["a", "b", "c", "c"] and [r["name"] for r in rows] == ["a", "b", "c"]
    assert json.loads((tmp_path / "b.json").read_text()) == [{"name": "b"}]
    given = run_trials({"a": 1, "d": ("x", 2)}, lambda trial: [{"given": trial}], tmp_path, silent, workers=1)
    assert given == [{"name": "a"}, {"given": ["x", 2]}]
