"""Sequences of goals in one world, and what is measured of runs through them."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import shapely
from toy import toy_generated, toy_scenario

from shmoo_mjx.evaluation import experiment, lifelong, navigation
from shmoo_mjx.evaluation.certify import Attempt, Certificate
from shmoo_mjx.evaluation.lifelong import GoalSequence, draw_sequence, measure
from shmoo_mjx.evaluation.navigation import play
from shmoo_mjx.evaluation.page import render
from shmoo_mjx.evaluation.registry import run_experiment
from shmoo_mjx.evaluation.result import ExperimentOptions
from shmoo_mjx.evaluation.scenarios import Generated, ScenarioConfig, draw_scenario
from shmoo_mjx.planning.floorplan import draw_building
from shmoo_mjx.planning.footprints import footprint_polygon
from shmoo_mjx.planning.maps import OccupancyGrid
from shmoo_mjx.planning.paths import path_blocked_by, plan_path
from shmoo_mjx.planning.scenario import ROBOT_RADIUS, Scenario
from shmoo_mjx.plant.objects import draw_condition
from shmoo_mjx.run import episode


def all_move(grid: OccupancyGrid, scenario: Scenario) -> Certificate:
    """A quick stand-in: every object can be pushed out of the way."""
    way = {"face": 0, "lateral": 0.0, "steering": 0.0, "start": (0.0, 0.0, 0.0), "result": "free"}
    way |= {"progress": 0.9, "seconds": 30.0}
    attempts = [Attempt.model_validate(way | {"object": i}) for i in range(len(scenario.objects))]
    return Certificate(attempts=tuple(attempts), round_s=None, reference_s=30.0, best=(0,))


@cache
def drawn() -> tuple[OccupancyGrid, GoalSequence]:
    rng, cfg = np.random.default_rng(0), ScenarioConfig()
    grid = draw_building(rng)
    return grid, draw_sequence(
        draw_scenario(grid, None, rng, 1_000_000, cfg=cfg, certifier=all_move), grid, rng, count=5, cfg=cfg
    )


def shapes(found: Generated) -> list[shapely.Polygon]:
    entries = found.scenario.objects
    return [footprint_polygon(o.pose, draw_condition(o.family, o.seed, o.properties).half_extents) for o in entries]


def test_every_goal_can_be_reached_once_what_can_be_moved_is_gone() -> None:
    grid, sequence = drawn()
    found, objects = sequence.generated, shapes(sequence.generated)
    staying = [s for s, m, b in zip(objects, found.movable, found.blocking, strict=True) if not (m and b)]
    points = [found.scenario.start[:2], *sequence.goals]
    assert sequence.goals[0] == found.scenario.goal and len(sequence.goals) == len(sequence.shortest) == 5
    for start, goal, length in zip(points, points[1:], sequence.shortest, strict=False):
        free, past = (plan_path(grid, start, goal, o, robot_radius=ROBOT_RADIUS) for o in ([], staying))
        assert free is not None and past is not None and free.length == pytest.approx(length, abs=0.05)
        assert all(s.distance(shapely.Point(goal)) > ROBOT_RADIUS for s in objects)


def test_the_second_path_leads_through_an_object() -> None:
    grid, sequence = drawn()
    path = plan_path(grid, sequence.goals[0], sequence.goals[1], [], robot_radius=ROBOT_RADIUS)
    assert path is not None
    assert any(path_blocked_by(path, s, ROBOT_RADIUS)[0] for s in shapes(sequence.generated))


def test_there_is_time_for_every_goal() -> None:
    assert drawn()[1].generated.scenario.limits.time_s == 5 * ScenarioConfig().time_s


class FakeTrace(NamedTuple):
    object_pose: Any = np.zeros((11, 1, 3))
    force: Any = np.zeros((11, 2))


class FakeEpisode(NamedTuple):
    result: dict[str, Any]
    trace: FakeTrace = FakeTrace()


def leg(outcome: str, time: float, path: float) -> dict[str, Any]:
    return {"outcome": outcome, "reason": "why", "time_s": time, "path_length_m": path, "goal": [1.0, 2.0], "more": 0}


def fake_run(outcome: str, legs: list[dict[str, Any]]) -> dict[str, Any]:
    whole = {
        "outcome": outcome,
        "reason": "state push",
        "falls": 0,
        "wall_contacts": 1,
        "wall_parts": {},
        "objects": [],
        "decisions": [],
    }
    return whole | {"time_s": 60.0, "path_length_m": 20.0, "legs": legs}


def test_legs_are_measured_one_by_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs = [
        fake_run("success", [leg("success", 30.0, 8.0), leg("success", 20.0, 4.0)]),
        fake_run("timeout", [leg("success", 40.0, 8.0), leg("timeout", 240.0, 30.0)]),
    ]
    asked: list[Any] = []

    def fake_play(options: Any, grid: Any, generated: Any, policy: str, *, goals: Any) -> FakeEpisode:
        asked.append((policy, goals))
        return FakeEpisode(runs[len(asked) - 1])

    world = toy_generated(True)
    sequence = GoalSequence(generated=world, goals=((5.0, 2.6), (1.2, 2.0)), shortest=(4.0, 4.0))
    kept: list[str] = []
    monkeypatch.setattr(lifelong, "play", fake_play)
    monkeypatch.setattr(lifelong, "_kept_sequence", lambda *args: sequence)
    monkeypatch.setattr(lifelong, "keep_failure", lambda store, name, episode: kept.append(name))
    monkeypatch.setattr(
        experiment,
        "run_trials",
        lambda trials, work, *rest, workers: [row for t in trials.values() for row in work(t)],
    )
    result = run_experiment("lifelong", ExperimentOptions(out=tmp_path, quick=True, scenarios=2, senses="perfect"))
    assert asked == [("ours", sequence.goals)] * 2 and kept == ["building_0-1"]
    metrics = result.metrics
    assert (metrics["success_rate"], metrics["goals_reached"], metrics["sequences"]) == (0.5, 0.75, 2)
    assert (metrics["success_rate_goal1"], metrics["success_rate_goal2"]) == (1.0, 0.5)
    assert (metrics["time_s_goal1"], metrics["time_s_goal2"]) == (35.0, 20.0)
    assert (metrics["efficiency_goal1"], metrics["efficiency_goal2"]) == (0.5, 1.0)
    assert metrics["wall_contacts_per_100_goals"] == 50.0
    assert result.config["senses"] == "perfect" and "more" not in result.rows[0]["legs"][0]
    assert "out of time in state push (1)" in (tmp_path / "lifelong" / "failures.md").read_text()
    assert "| Share reached, of those begun | 1 | 0.50 |" in render({"lifelong": result}, {})


def test_goals_that_were_not_begun_are_not_reached() -> None:
    numbers = {"policy": "ours", "falls": 1, "wall_contacts": 0, "effort": 1.0, "effort_force": 1.0, "success": False}
    row = numbers | {"goals_reached": 1, "legs": [leg("success", 9.0, 9.0) | {"efficiency": 1.0}]}
    metrics = measure([row], ("ours",), 3)
    assert metrics["goals_reached"] == pytest.approx(1 / 3) and metrics["success_rate_goal2"] is None


def test_a_run_is_given_what_it_can_take(monkeypatch: pytest.MonkeyPatch) -> None:
    grid = toy_scenario(1, True)[0]
    world = toy_generated(True)
    taken: list[dict[str, Any]] = []

    def able(
        grid: Any,
        scenario: Any,
        controller: Any,
        config: Any,
        first_status: Any,
        senses: str,
        goals: Any = (),
        policy: Any = None,
    ) -> Any:
        taken.append({"senses": senses, "goals": goals})

    monkeypatch.setattr(navigation, "controller_of", lambda *_: None)
    options = ExperimentOptions(senses="perfect")
    monkeypatch.setattr(episode, "run_episode", able)
    play(options, grid, world, "ours", goals=[(1.0, 2.0)])
    play(options, grid, world, "ours")
    assert taken == [{"senses": "perfect", "goals": [(1.0, 2.0)]}, {"senses": "perfect", "goals": ()}]


@pytest.mark.slow
def test_two_goals_in_a_row(tmp_path: Path) -> None:
    result = run_experiment("lifelong", ExperimentOptions(out=tmp_path, quick=True))
    assert len(result.rows) == 1 and result.metrics["falls"] == 0 and result.rows[0]["legs"]
