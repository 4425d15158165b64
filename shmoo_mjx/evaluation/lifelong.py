"""Experiment `lifelong`: five goals in a row, in a world that stays as the robot has left it.

The robot keeps its beliefs about objects from goal to goal, and the drift of its sensors continues. A sequence ends if
the robot gives up, falls or runs out of time, and the remaining goals count as not reached. A goal reached with a wall
contact on the way does not count as reached.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from pydantic import BaseModel

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.experiment import Experiment, ExperimentConfig, Prepared, Setup
from shmoo_mjx.evaluation.navigation import POLICIES, deciding, map_arguments, play, scores_of, told_of
from shmoo_mjx.evaluation.navigation_failures import keep_failure, write_failures
from shmoo_mjx.evaluation.navigation_places import Places, find_places, kept
from shmoo_mjx.evaluation.paired import OURS, metrics_by_method
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult
from shmoo_mjx.evaluation.scenarios import Extra, Generated, ScenarioConfig, draw_scenario, largest_room
from shmoo_mjx.evaluation.tables import Section, Table, cell, lines_of, measured, number, percent
from shmoo_mjx.planning.distance_field import DistanceField
from shmoo_mjx.planning.footprints import footprint_polygon
from shmoo_mjx.planning.maps import OccupancyGrid, distance_field, load_map
from shmoo_mjx.planning.paths import Path as Route
from shmoo_mjx.planning.paths import path_blocked_by, plan_path
from shmoo_mjx.planning.scenario import ROBOT_RADIUS, Limits, ObjectEntry
from shmoo_mjx.report.tables import markdown_table

_TRIES = 60
"""Maximum number of draws of each further goal."""


@dataclass(frozen=True)
class LifelongTrials(ExperimentConfig):
    """Settings of the experiment."""

    sequences: int = 8
    """Number of sequences per map."""
    goals: int = 5
    """Number of goals per sequence."""
    policies: tuple[str, ...] = (OURS,)
    scenario: ScenarioConfig = ScenarioConfig()


class GoalSequence(BaseModel):
    """A world and the goals that the robot is given in it, one after the other."""

    generated: Generated
    """The world and the first goal."""
    goals: tuple[tuple[float, float], ...]
    """All goals in {W} in their order, including the first [m]."""
    shortest: tuple[float, ...]
    """Length of the path without objects to each goal, from the start or the goal before [m]."""


def _adjust(options: ExperimentOptions, config: LifelongTrials) -> LifelongTrials:
    count = config.sequences if options.scenarios is None else options.scenarios
    return replace(config, sequences=count, policies=options.chosen(POLICIES) if options.policies else (OURS,))


def _prepare(options: ExperimentOptions, config: LifelongTrials, folder: Path) -> Prepared:
    """The maps of ``options.maps``, or generated buildings."""
    return Prepared(
        find_places(options, folder, config.scenario, most=1 if options.quick else None), *deciding(options)
    )


def _trials(setup: Setup[LifelongTrials]) -> dict[str, tuple[str, int, str]]:
    config = setup.config
    return {
        f"{name}-{i}-{config.goals}-{policy}": (name, i, policy)
        for policy in config.policies
        for i in range(config.sequences)
        for name in setup.data.maps
    }


def _trial(setup: Setup[LifelongTrials], trial: tuple[str, int, str]) -> list[dict[str, Any]]:
    """Run one sequence. No row if the map has no place for it."""
    map_name, number, policy = trial
    grid = load_map(setup.data.maps[map_name])
    sequence = _kept_sequence(setup, grid, map_name, number)
    if sequence is None:
        return []
    generated = sequence.generated
    episode = play(setup.options, grid, generated, policy, goals=sequence.goals)
    legs, reached = episode.result["legs"], _reached(episode.result["legs"])
    scores = scores_of(episode, generated.scenario, sum(sequence.shortest))
    row = {"map": map_name, "scenario": number, "policy": policy, "kind": generated.kind} | told_of(episode, generated)
    row |= {"success": row["success"] and reached == len(sequence.goals), "goals_reached": reached}
    row |= {"legs": _legs(legs, sequence.shortest)} | {k: scores[k] for k in ("effort", "effort_force")}
    if policy == OURS and not row["success"]:
        keep_failure(setup.store, f"{map_name}-{number}", episode)
    return [row]


def _kept_sequence(
    setup: Setup[LifelongTrials], grid: OccupancyGrid, map_name: str, number: int
) -> GoalSequence | None:
    """Sequence ``number`` of a map; None if the map has no place for it."""
    places: Places = setup.data
    count = setup.config.goals

    def draw(extra: Extra, rng: np.random.Generator) -> GoalSequence:
        first = draw_scenario(grid, extra, rng, places.first_unseen, cfg=places.config)
        return draw_sequence(first, grid, rng, count=count, cfg=places.config)

    return kept(places, grid, map_name, (number, count), form=GoalSequence, draw=draw)


def _reached(legs: list[dict[str, Any]]) -> int:
    return sum(leg["outcome"] == "success" for leg in legs)


def _legs(legs: list[dict[str, Any]], shortest: tuple[float, ...]) -> list[dict[str, Any]]:
    """Outcome of each goal that was begun, compared with the shortest path without objects."""
    names = ("outcome", "reason", "time_s", "path_length_m", "goal")
    rows = []
    for leg, length in zip(legs, shortest, strict=False):
        efficiency = (leg["outcome"] == "success") * min(length / max(leg["path_length_m"], 1e-9), 1.0)
        rows.append({name: leg[name] for name in names} | {"shortest_m": length, "efficiency": efficiency})
    return rows


def measure(rows: list[dict[str, Any]], policies: tuple[str, ...], goals: int) -> dict[str, Any]:
    """Metrics of every policy. Ours have no prefix. For example, ``*_goal3`` belongs to the third goal.

    Args:
        rows: rows of all sequences.
        policies: names of the policies.
        goals: number of goals per sequence.
    """
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
    for i in range(goals):
        begun = [r["legs"][i] for r in rows if len(r["legs"]) > i]
        reached = [leg for leg in begun if leg["outcome"] == "success"]
        metrics[f"success_rate_goal{i + 1}"] = _mean([leg["outcome"] == "success" for leg in begun])
        metrics[f"time_s_goal{i + 1}"] = _mean([leg["time_s"] for leg in reached])
        metrics[f"efficiency_goal{i + 1}"] = _mean([leg["efficiency"] for leg in reached])
    return metrics


def _mean(values: list[Any]) -> float | None:
    return float(np.mean(values)) if values else None


def draw_sequence(
    generated: Generated, grid: OccupancyGrid, rng: np.random.Generator, *, count: int, cfg: ScenarioConfig
) -> GoalSequence:
    """Draw further goals in a scenario, ``count`` in all. The time limit of ``cfg`` applies to each goal.

    Each goal can be reached from the previous one without the movable objects in the way. If possible, every second
    path leads through the initial place of an object, so that what the robot knows about the object is useful. The
    paths do not take into account where pushes have left objects.

    Raises:
        ShmooError: the map has no place for such a sequence.
    """
    walls = distance_field(grid)
    goals, shortest = [generated.scenario.goal], [generated.shortest]
    while len(goals) < count:
        leg = _next_leg(grid, walls, generated, start=goals[-1], blocked=len(goals) % 2 == 1, rng=rng, cfg=cfg)
        if leg is None:
            raise ShmooError(f"{grid.source or 'the map'}: no {count} goals in a row were found; give another map.")
        goals.append((round(float(leg.points[-1][0]), 3), round(float(leg.points[-1][1]), 3)))
        shortest.append(leg.length)
    limits = Limits(time_s=cfg.time_s * count)
    scenario = generated.scenario.model_copy(update={"limits": limits})
    world = generated.model_copy(update={"scenario": scenario})
    return GoalSequence(generated=world, goals=tuple(goals), shortest=tuple(shortest))


def _next_leg(
    grid: OccupancyGrid,
    walls: DistanceField,
    generated: Generated,
    *,
    start: tuple[float, float],
    blocked: bool,
    rng: np.random.Generator,
    cfg: ScenarioConfig,
) -> Route | None:
    """The path without objects to a random goal in reach; None if no goal is found.

    If possible, an object blocks the path (``blocked``) or no object does (not ``blocked``).
    """
    shapes = [_shape(entry) for entry in generated.scenario.objects]
    gone = [movable and in_the_way for movable, in_the_way in zip(generated.movable, generated.blocking, strict=True)]
    staying = [shape for shape, is_gone in zip(shapes, gone, strict=True) if not is_gone]
    centres = grid.cell_to_world(largest_room(np.asarray(walls.values), cfg.start_clearance))
    distance = np.linalg.norm(centres - np.asarray(start), axis=1)
    clear = shapely.distance(shapely.MultiPolygon(shapes), shapely.points(centres)) > ROBOT_RADIUS + 0.15
    near = rng.permutation(np.flatnonzero((distance > 0.6 * cfg.path[0]) & (distance < cfg.path[1]) & clear))
    other = None
    for index in near[:_TRIES]:
        path = plan_path(grid, start, centres[index], robot_radius=ROBOT_RADIUS, wall_clearance=walls)
        if path is None or not cfg.path[0] <= path.length <= cfg.path[1]:
            continue
        through = any(path_blocked_by(path, shape, ROBOT_RADIUS)[0] for shape in shapes)
        if through != blocked and other is not None:
            continue
        if plan_path(grid, start, centres[index], staying, robot_radius=ROBOT_RADIUS, wall_clearance=walls) is None:
            continue
        if through == blocked:
            return path
        other = path
    return other


def _shape(entry: ObjectEntry) -> shapely.Polygon:
    return footprint_polygon(entry.pose, entry.condition().half_extents)


def _draw(setup: Setup[LifelongTrials], rows: list[dict[str, Any]]) -> None:
    write_failures(setup.folder, [r for r in rows if r["policy"] == OURS], setup.store, setup.options.progress)


_GOALS = range(1, LifelongTrials().goals + 1)


def _goal_table(result: ExperimentResult) -> str:
    lines = {
        "success_rate": "Share reached, of those begun",
        "time_s": "Mean time [s]",
        "efficiency": "Path efficiency",
    }
    rows = [[label, *(cell(result.metrics, f"{name}_goal{i}") for i in _GOALS)] for name, label in lines.items()]
    return markdown_table(("", *(f"goal {i}" for i in _GOALS)), rows)


def _shows(result: ExperimentResult) -> str:
    first, last = (measured(result, f"time_s_goal{i}") for i in (1, _GOALS[-1]))
    return (
        f"All goals are reached in {percent(measured(result, 'success_rate'))} of "
        f"{measured(result, 'sequences'):.0f} sequences. The first goal takes {number(first)} s, the last "
        f"{number(last)} s. Objects that were pushed aside stay aside, and the robot keeps what it has learned."
    )


EXPERIMENT = Experiment(
    Section(
        "Five goals in a row",
        "Does navigation stay reliable in a world that stays as the robot has left it?",
        (
            _goal_table,
            Table(
                ("value",),
                lines_of(
                    {
                        "success_rate": "Share of sequences with all goals reached",
                        "goals_reached": "Share of goals reached",
                        "falls": "Falls",
                        "wall_contacts_per_100_goals": "Wall contacts in 100 goals",
                        "effort": "Effort efficiency, by mass moved",
                        "effort_force": "Effort efficiency, by force",
                        "sequences": "Sequences",
                    }
                ),
            ),
        ),
        _shows,
        arguments=map_arguments,
    ),
    LifelongTrials(),
    quick=LifelongTrials(sequences=1, goals=2),
    adjust=_adjust,
    prepare=_prepare,
    trials=_trials,
    trial=_trial,
    metrics=lambda setup, rows: measure(rows, setup.config.policies, setup.config.goals),
    draw=_draw,
    neutral=("sequences", "goals", "policies"),
    about=lambda setup: {"maps": list(setup.data.maps), "generated_maps": setup.options.maps is None},
)
