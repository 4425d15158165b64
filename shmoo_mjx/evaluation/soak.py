"""Soak test: one errand after another in one building for hours, while people move the objects.

The test looks for failures that a single run cannot show: a fall after an hour, a state that is left and entered again
without end, memory that grows, files that stay open. A failed errand is given up for the next one, and its reason is
kept.
"""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
import psutil
import shapely

from shmoo_mjx.behavior.state import Mode, Transition
from shmoo_mjx.control.observation import local_distance_field
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.evaluation.experiment import Experiment, ExperimentConfig, Setup
from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.evaluation.scenarios import largest_room
from shmoo_mjx.evaluation.tables import Section, cell, measured
from shmoo_mjx.evaluation.trials import controller_of
from shmoo_mjx.planning.floorplan import draw_floorplan
from shmoo_mjx.planning.footprints import footprint_polygon
from shmoo_mjx.planning.maps import distance_field
from shmoo_mjx.planning.scenario import Limits, ObjectEntry, Scenario
from shmoo_mjx.plant.objects import FAMILIES
from shmoo_mjx.plant.observe import DIVERGED
from shmoo_mjx.report.tables import markdown_table
from shmoo_mjx.run.simulation import History, Simulation

_ERRAND = 180.0
"""Time limit of an errand [s]: several times its usual duration in three rooms."""
_APART = 1.0
"""Minimum distance of a moved object from the robot before and after the move, and from the goal after it [m]. Half the
diagonal of the object is added."""


@dataclass(frozen=True)
class SoakTrials(ExperimentConfig):
    """Settings of the soak test."""

    minutes: float = 60.0
    """Simulated time in each building [min]."""
    buildings: int = 10
    """Number of buildings."""
    moved_every: float = 90.0
    """Interval at which somebody moves one object [s]."""


def summary(result: ExperimentResult) -> str:
    """Markdown table of the buildings, and the counted reasons for which errands were given up."""
    names = ("seed", "errands", "done", "falls", "livelocks", "wall_contacts", "memory_growth", "open_files_left")
    table = markdown_table([n.replace("_", " ") for n in names], [[str(row[n]) for n in names] for row in result.rows])
    reasons = [reason for row in result.rows for reason in row["given_up"]]
    counted = [f"{reasons.count(reason)} x {reason}" for reason in dict.fromkeys(reasons)]
    return "\n\n".join([table, *counted])


def play(trials: SoakTrials, seed: int, controller: PushController) -> dict[str, Any]:
    """The row of one building, with errands until the time is up or the simulation ends with a fall or divergence."""
    rng = np.random.default_rng([seed, 0x50A4])
    grid = draw_floorplan(rng).grid
    clearance = distance_field(grid)
    cells = largest_room(np.asarray(clearance.values), 0.55)
    places = grid.cell_to_world(cells)
    chosen = places[_apart(places, rng, 2 + len(FAMILIES))]
    objects = tuple(
        ObjectEntry(family=family, seed=1_000_000 + seed, pose=(*pose, float(rng.uniform(-np.pi, np.pi))))
        for family, pose in zip(FAMILIES, chosen[2:].tolist(), strict=True)
    )
    start, goal = (tuple(p) for p in chosen[:2].tolist())
    scenario = Scenario(start=(*start, 0.0), goal=goal, objects=objects, seed=seed, limits=Limits(time_s=3600.0))
    controller.compile(local_distance_field(clearance, (*start, 0.0)))  # before memory is measured
    this = psutil.Process()
    files = this.num_fds()
    memory: list[int] = []
    row: dict[str, Any] = {"seed": seed, "errands": 0, "done": 0, "given_up": [], "livelocks": 0}
    totals = {"falls": 0, "wall_contacts": 0, "moved": 0}
    with closing(Simulation(grid, scenario, controller)) as simulation:
        moved, lost = 0.0, False
        while simulation.time < 60 * trials.minutes and not lost:
            began = simulation.time
            while not _over(simulation, began + _ERRAND):
                simulation.advance(simulation.decide())
                if simulation.time - moved > trials.moved_every:
                    moved = simulation.time
                    totals["moved"] += _move_one(simulation, places, rng)
            row["errands"] += 1
            row["done"] += simulation.navigator.mode is Mode.DONE
            row["livelocks"] += livelocks(simulation.navigator.transitions, simulation.history)
            if simulation.navigator.mode is not Mode.DONE:
                row["given_up"].append(_reason(simulation))
            totals["falls"] += simulation.history.falls
            lost = simulation.history.ended
            totals["wall_contacts"] += simulation.history.wall_contacts
            memory.append(this.memory_info().rss)
            # A record of hours would hide other growth of memory, so each errand starts a new one.
            simulation.history = History(touching=simulation.history.touching)
            simulation.navigator.events.clear()
            simulation.navigator.head_for(_next_goal(simulation, places, rng), simulation.time)
        row["simulated_s"] = round(simulation.time, 1)
    warm = memory[len(memory) // 4]
    growth = round(memory[-1] / warm - 1, 3)
    return row | totals | {"memory_growth": growth, "open_files_left": max(0, this.num_fds() - files)}


def livelocks(transitions: list[Transition], history: History) -> int:
    """Number of times that a state was entered twice within 1 s for the same reason while nothing moved by 2 cm."""
    count = 0
    for i, later in enumerate(transitions):
        for earlier in reversed(transitions[:i]):
            if later.t - earlier.t > 1.0:
                break
            if (earlier.target, earlier.reason) == (later.target, later.reason):
                poses = [
                    np.concatenate([row.robot_pose[None], row.object_pose])[:, :2]
                    for row in history.rows
                    if earlier.t - 1e-6 <= row.t <= later.t + 1e-6
                ]
                count += not poses or float(np.abs(poses[-1] - poses[0]).max()) < 0.02
                break
    return count


def _over(simulation: Simulation, until: float) -> bool:
    return simulation.navigator.finished or simulation.time >= until or simulation.history.ended


def _reason(simulation: Simulation) -> str:
    navigator = simulation.navigator
    if simulation.history.diverged:
        return DIVERGED
    if simulation.history.falls:
        return f"fell while it was to {navigator.mode}"
    if navigator.mode is Mode.FAILED:
        return str(navigator.transitions[-1].reason)
    return f"{_ERRAND:g} s were not enough, at last to {navigator.mode}"


def _apart(places: np.ndarray, rng: np.random.Generator, count: int) -> list[int]:
    """Indices of at most ``count`` random places that are more than 1.2 m apart."""
    chosen: list[int] = []
    for index in rng.permutation(len(places)):
        if all(np.hypot(*(places[index] - places[other])) > 1.2 for other in chosen):
            chosen.append(int(index))
            if len(chosen) == count:
                break
    return chosen


def _shapes(simulation: Simulation) -> list[Any]:
    poses = simulation.true.object_pose[0]
    return [footprint_polygon(p, c.half_extents) for p, c in zip(poses, simulation.conditions, strict=True)]


def _next_goal(simulation: Simulation, places: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A random place ``[2]`` in {W} that is free of objects and more than 1 m away from the robot [m]."""
    free = shapely.distance(shapely.MultiPolygon(_shapes(simulation)), shapely.points(places)) > 0.45
    away = np.hypot(*(places - simulation.true.robot_pose[0, :2]).T) > 1.0
    return np.asarray(places[rng.choice(np.flatnonzero(free & away))])


def _move_one(simulation: Simulation, places: np.ndarray, rng: np.random.Generator) -> int:
    """Move one random object to a random free place, unless the robot is near; returns the number of moved objects."""
    index = int(rng.integers(len(simulation.conditions)))
    robot, goal = simulation.true.robot_pose[0, :2], simulation.navigator.state.goal
    half = float(np.hypot(*simulation.conditions[index].half_extents))
    others = [shape for i, shape in enumerate(_shapes(simulation)) if i != index]
    clear = shapely.distance(shapely.MultiPolygon(others), shapely.points(places)) > half + 0.05
    for taken in (robot, goal):
        clear &= np.hypot(*(places - taken).T) > _APART + half
    near = np.hypot(*(simulation.true.object_pose[0, index, :2] - robot)) < _APART + half
    if near or not clear.any():
        return 0
    place = places[rng.choice(np.flatnonzero(clear))]
    simulation.place(index, (*place, float(rng.uniform(-np.pi, np.pi))))
    return 1


def _trials(setup: Setup[SoakTrials]) -> dict[str, int]:
    first = setup.options.seed
    return {f"seed-{seed}": seed for seed in range(first, first + setup.config.buildings)}


def _trial(setup: Setup[SoakTrials], seed: int) -> list[dict[str, Any]]:
    return [play(setup.config, seed, controller_of(setup.options.weights_file))]


def _metrics(setup: Setup[SoakTrials], rows: list[dict[str, Any]]) -> dict[str, Any]:
    totals = ("falls", "livelocks", "open_files_left", "wall_contacts", "errands", "done")
    metrics: dict[str, Any] = {name: sum(r[name] for r in rows) for name in totals}
    metrics["hours"] = sum(r["simulated_s"] for r in rows) / 3600
    return metrics | {"memory_growth": max(r["memory_growth"] for r in rows)}


def _totals(result: ExperimentResult) -> str:
    names = {
        "hours": "simulated hours",
        "errands": "goals given",
        "done": "goals reached",
        "falls": "falls",
        "livelocks": "livelocks",
        "wall_contacts": "wall contacts",
        "memory_growth": "largest growth of memory",
        "open_files_left": "files left open",
    }
    shown = {name: label for name, label in names.items() if name in result.metrics}
    return markdown_table(tuple(shown.values()), [[cell(result.metrics, name) for name in shown]])


def _shows(result: ExperimentResult) -> str:
    done, errands = (measured(result, name) for name in ("done", "errands"))
    reasons = Counter(reason for row in result.rows for reason in row["given_up"])
    most = f" The most frequent reason to give up: {reasons.most_common(1)[0][0]}." if reasons else ""
    return f"The robot reaches {done:.0f} of {errands:.0f} goals.{most}"


EXPERIMENT = Experiment(
    Section(
        "Soak",
        "Does the robot keep working for hours?",
        (_totals, summary),
        _shows,
        arguments=lambda config: f"--minutes {config.get('minutes', 0):g} --buildings {config.get('buildings')}",
        draws_conditions=False,
    ),
    SoakTrials(),
    quick=SoakTrials(minutes=2.0, buildings=1),
    trials=_trials,
    trial=_trial,
    metrics=_metrics,
    # Each building is a trial of its own, so a larger number continues from the finished ones.
    neutral=("buildings",),
    first_seed=950,
    printed=summary,
)
