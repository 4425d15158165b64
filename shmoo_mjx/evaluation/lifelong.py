"""Experiment lifelong: five goals one after the other, in a world that stays as the robot has left it.

What it has found out about objects and where it has put them is carried on from goal to goal, as is the drift of its
senses. A robot that gives up, falls or runs out of time is given no further goal; those that are left count as not
reached. A goal reached with a wall touched on the way does not count as reached either.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.manipulable import BORDER
from shmoo_mjx.evaluation.navigation import POLICIES, Robot, play, robot_of, scores_of, told_of, trials_folder
from shmoo_mjx.evaluation.navigation_failures import keep_failure, write_failures
from shmoo_mjx.evaluation.navigation_places import Places, as_data, find_places, generated_from, kept, kinds_of, seed_of
from shmoo_mjx.evaluation.paired import OURS, metrics_by_method
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, make_result
from shmoo_mjx.evaluation.scenarios import PLANT, ScenarioConfig
from shmoo_mjx.evaluation.sequences import GoalSequence, draw_sequence
from shmoo_mjx.evaluation.trials import run_trials
from shmoo_mjx.navigation.maps import OccupancyGrid, load_map

__all__ = ["LifelongTrials", "measure", "run"]


@dataclass(frozen=True)
class LifelongTrials:
    """What is tried."""

    sequences: int = 8
    """Per map."""
    goals: int = 5
    """Per sequence."""
    policies: tuple[str, ...] = (OURS,)
    workers: int = 2
    scenario: ScenarioConfig = ScenarioConfig()


def run(options: ExperimentOptions) -> ExperimentResult:
    """Run the experiment on the maps of ``options.maps``; ``options.scenarios`` is the number of sequences per map."""
    folder = options.out / "lifelong"
    cfg = LifelongTrials(policies=options.chosen(POLICIES) if options.policies else (OURS,))
    if options.quick:
        cfg = replace(cfg, sequences=1, goals=2)
    if options.scenarios is not None:
        cfg = replace(cfg, sequences=options.scenarios)
    places = find_places(options, folder, cfg.scenario, most=1 if options.quick else None)
    store = trials_folder(options, folder, cfg.scenario)
    maps = list(places.maps)
    trials = {
        f"{name}-{i}-{cfg.goals}-{policy}": (name, i, policy)
        for policy in cfg.policies
        for i in range(cfg.sequences)
        for name in maps
    }
    work = partial(_trial, places, robot_of(options), store, cfg.goals)
    rows = run_trials(trials, work, store, options.progress, cfg.workers)
    write_failures(folder, [r for r in rows if r["policy"] == OURS], store, options.progress)
    metrics = measure(rows, cfg.policies, cfg.goals)
    about = {"senses": options.senses, "maps": maps, "generated_maps": options.maps is None, "border_m": BORDER}
    return make_result("lifelong", options, asdict(cfg) | about, metrics, {}, rows)


def _trial(places: Places, robot: Robot, store: Path, goals: int, trial: tuple[str, int, str]) -> list[dict[str, Any]]:
    """One run through a sequence. No row if the map has no place for it."""
    map_name, number, policy = trial
    grid = load_map(places.maps[map_name])
    sequence = _kept_sequence(places, grid, map_name, number, goals)
    if sequence is None:
        return []
    generated = sequence.generated
    episode = play(robot, grid, generated, policy, sequence.goals)
    legs, reached = episode.result["legs"], _reached(episode.result["legs"])
    scores = scores_of(episode, generated.scenario, sum(sequence.shortest))
    row = {"map": map_name, "scenario": number, "policy": policy, "kind": generated.kind} | told_of(episode, generated)
    row |= {"success": row["success"] and reached == len(sequence.goals), "goals_reached": reached}
    row |= {"legs": _legs(legs, sequence.shortest)} | {k: scores[k] for k in ("effort", "effort_force")}
    if policy == OURS and not row["success"]:
        keep_failure(store, f"{map_name}-{number}", episode)
    return [row]


def _kept_sequence(places: Places, grid: OccupancyGrid, map_name: str, number: int, count: int) -> GoalSequence | None:
    """Sequence ``number`` of a map, of the kind whose turn it is, or of another where the map has no place for it."""

    def draw() -> dict[str, Any] | None:
        for turn, kind in enumerate(kinds_of(map_name, number)):
            rng = np.random.default_rng([*seed_of(places, map_name, number), turn, count])
            try:
                found = draw_sequence(grid, kind, rng, places.first_unseen, count, PLANT, places.config)
            except ShmooError:
                continue
            return found._asdict() | {"generated": as_data(found.generated)}
        return None

    data = kept(places, grid, f"{map_name}-{number}-{count}", draw)
    if data is None:
        return None
    goals = tuple((x, y) for x, y in data["goals"])
    return GoalSequence(generated_from(data["generated"]), goals, tuple(data["shortest"]))


def _reached(legs: list[dict[str, Any]]) -> int:
    return sum(leg["outcome"] == "success" for leg in legs)


def _legs(legs: list[dict[str, Any]], shortest: tuple[float, ...]) -> list[dict[str, Any]]:
    """Of each goal that was begun: what became of it and how it compares with the shortest path past no object."""
    names = ("outcome", "reason", "time_s", "path_length_m", "goal")
    rows = []
    for leg, length in zip(legs, shortest, strict=False):
        efficiency = (leg["outcome"] == "success") * min(length / max(leg["path_length_m"], 1e-9), 1.0)
        rows.append({name: leg[name] for name in names} | {"shortest_m": length, "efficiency": efficiency})
    return rows


def measure(rows: list[dict[str, Any]], policies: tuple[str, ...], goals: int) -> dict[str, Any]:
    """Metrics of every policy, ours without a prefix; ``*_goal3`` is of the third goal, for example."""
    of = {policy: dict(enumerate(r for r in rows if r["policy"] == policy)) for policy in policies}
    return metrics_by_method(of, partial(_of_policy, goals), lambda policy, pairs: {})


def _of_policy(goals: int, rows: list[dict[str, Any]]) -> dict[str, Any]:
    contacts = _mean([r["wall_contacts"] for r in rows])
    metrics: dict[str, Any] = {
        "success_rate": _mean([r["success"] for r in rows]),
        "goals_reached": _mean([r["goals_reached"] / goals for r in rows]),
        "falls": sum(r["falls"] for r in rows),
        "wall_contacts": sum(r["wall_contacts"] for r in rows),
        "wall_contacts_per_100_goals": None if contacts is None else 100.0 * contacts / goals,
        "effort": _mean([r["effort"] for r in rows]),
        "effort_force": _mean([r["effort_force"] for r in rows]),
        "sequences": len(rows),
    }
    for number in range(goals):
        begun = [r["legs"][number] for r in rows if len(r["legs"]) > number]
        reached = [leg for leg in begun if leg["outcome"] == "success"]
        metrics[f"success_rate_goal{number + 1}"] = _mean([leg["outcome"] == "success" for leg in begun])
        metrics[f"time_s_goal{number + 1}"] = _mean([leg["time_s"] for leg in reached])
        metrics[f"efficiency_goal{number + 1}"] = _mean([leg["efficiency"] for leg in reached])
    return metrics


def _mean(values: list[Any]) -> float | None:
    return float(np.mean(values)) if values else None
