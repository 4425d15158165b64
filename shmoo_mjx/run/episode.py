"""One run of a scenario from start to end: its result and its history."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.behavior.belief import Status
from shmoo_mjx.behavior.interaction import Machine
from shmoo_mjx.behavior.state import Mode, NavigatorConfig
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.geometry import se2
from shmoo_mjx.learning.contact_prior import true_values
from shmoo_mjx.planning.maps import OccupancyGrid
from shmoo_mjx.planning.scenario import Scenario, check_point
from shmoo_mjx.plant.observe import DIVERGED, toppled
from shmoo_mjx.plant.scene import Scene
from shmoo_mjx.report.trace import Trace
from shmoo_mjx.run.recording import Recording
from shmoo_mjx.run.simulation import Simulation
from shmoo_mjx.sensing import Senses, senses_named
from shmoo_mjx.types import DT, Observation

_YAW_TOLERANCE = float(np.radians(20.0))
"""Maximum yaw error of an object that counts as brought to its pose [rad]."""

Point = Sequence[float]


class Episode(NamedTuple):
    """A finished run."""

    result: dict[str, Any]
    """JSON-compatible: outcome, transitions, decisions, objects (report/trace.py lists the keys)."""
    trace: Trace
    """The history as arrays."""
    scene: Scene
    """The simulated scene."""
    qpos: np.ndarray
    """``[T, nq]`` configurations for rendering."""
    navigator: Machine
    """The navigator in its final state."""
    recorded: Recording
    """The navigator's observations and commands."""


class Hooks(NamedTuple):
    """Callbacks of a run. Each is called once per sample."""

    progress: Callable[[float, str], None] = lambda time, mode: None
    """Takes (simulated time [s], mode)."""
    perceive: Callable[[Observation], Observation] = lambda obs: obs
    """Adds a fault to the observation, such as a pose of NaN."""
    over: Callable[[Machine], bool] = lambda navigator: False
    """Ends the run before the navigator does, if it returns True."""


def run_episode(
    grid: OccupancyGrid,
    scenario: Scenario,
    controller: PushController,
    *,
    config: NavigatorConfig | None = None,
    hooks: Hooks = Hooks(),  # noqa: B008  (immutable)
    first_status: Sequence[Status] | None = None,
    senses: str | Senses | None = None,
    goals: Sequence[Point] = (),
    real_time: bool = False,
    policy: str | None = None,
) -> Episode:
    """Runs ``scenario`` until the navigator finishes, the robot falls, the physics diverges or the time is over.

    Args:
        grid: the map.
        scenario: start, goal, objects, limits.
        controller: the adaptive pushing controller.
        config: the navigator's settings.
        hooks: callbacks of the caller.
        first_status: initial status of each object in the robot's belief; UNKNOWN if not given.
        senses: sensing, real, perfect or custom; by default that of the scenario, or real.
        goals: ``(x, y)`` in {W} [m], in place of the scenario's. The robot drives to one after the other in the same
            world and keeps its belief. The time limit applies to the sum.
        real_time: run against the wall clock. A command takes effect after its real computing time.
        policy: "package.module:Name" of a policy that replaces the navigator (docs/how_to/policy.md).

    Raises:
        ShmooError: a goal lies off the map or not on free floor, or there is no such sensing or policy.
    """
    chosen = senses_named(senses or scenario.senses or "real")
    ahead = [tuple(goal) for goal in goals] or [scenario.goal]
    for goal in ahead:
        check_point(grid, goal, 0.0, "run_episode: the goal")
    first = scenario.model_copy(update={"goal": ahead[0]})
    legs: list[Leg] = []
    with closing(
        Simulation(grid, first, controller, config=config, first_status=first_status, senses=chosen, policy=policy)
    ) as simulation:
        navigator = simulation.navigator
        for number, goal in enumerate(ahead):
            began = simulation.time
            if number:
                navigator.head_for(goal, began)
            while not navigator.finished and simulation.time < scenario.limits.time_s and not simulation.history.ended:
                tick = time.perf_counter()
                command = simulation.decide(hooks.perceive)
                hooks.progress(simulation.time, str(navigator.mode))
                if hooks.over(navigator):
                    break
                simulation.advance(command, time.perf_counter() - tick if real_time else None)
                if real_time:
                    time.sleep(max(0.0, DT - (time.perf_counter() - tick)))
            legs.append(_leg(simulation, goal, began))
            if not legs[-1].success:
                break
    simulation.scenario = scenario  # The result contains the scenario's own goal, even if other goals were used
    history = simulation.history
    return Episode(
        result_of(simulation, legs, len(ahead)),
        trace_of(simulation),
        simulation.scene,
        np.array(history.qpos),
        navigator,
        Recording(_stacked(history.observations), _stacked(history.commands), np.array(history.goals)),
    )


def _stacked(rows: Sequence[Any]) -> Any:
    """Stacks named tuples of arrays along a new leading time axis."""
    return type(rows[0])(*(np.stack([np.asarray(v) for v in column]) for column in zip(*rows, strict=True)))


def trace_of(simulation: Simulation) -> Trace:
    """The history so far as arrays."""
    grid, navigator, history = simulation.grid, simulation.navigator, simulation.history

    def column(name: str) -> np.ndarray:
        return np.array([getattr(row, name) for row in history.rows])

    learned = next((tuple(row.learned) for row in history.rows if row.learned), ())
    blank = dict.fromkeys(learned, np.nan)
    names = ("t", "robot_pose", "lean", "u", "object_pose", "force", "learned_object", "state")
    return Trace(
        **{name: column(name) for name in names},
        learned=np.array([[*(row.learned or blank).values()] for row in history.rows]),
        learned_names=learned,
        state_names=tuple(str(m) for m in Mode),
        map_cells=grid.cells,
        map_origin=np.asarray(grid.origin, dtype=float),
        map_resolution=grid.resolution,
        plan_times=np.array([p.t for p in navigator.plans]),
        plans=tuple(p.points for p in navigator.plans),
        decision_rollouts=tuple(d.rollouts for d in navigator.decisions),
        decision_candidates=tuple(d.candidates for d in navigator.decisions),
    )


@dataclass(frozen=True)
class Leg:
    """Result of one goal."""

    goal: list[float]
    """Goal in {W} [m, m, rad]."""
    outcome: str
    """Outcome: "success", "blocked", "timeout" and so on."""
    reason: str
    """Reason for the outcome, as text."""
    success: bool
    """Whether the outcome is "success"."""
    time_s: float
    """Simulated time of this goal [s]."""
    path_length_m: float
    """Length of the robot's path [m]."""
    goal_distance_m: float
    """Final distance from the goal [m]."""


def _leg(simulation: Simulation, goal: Point, began: float) -> Leg:
    true, pushes = simulation.true, simulation.scenario.push_to is not None
    what = true.object_pose[0, 0] if pushes else true.robot_pose[0]
    distance = float(np.linalg.norm(what[:2] - np.asarray(goal)[:2]))
    outcome, reason = _outcome(simulation, distance)
    path = np.array([row.robot_pose[:2] for row in simulation.history.rows if row.t >= began - 1e-6])
    return Leg(
        goal=_floats(np.asarray(goal, dtype=float)),
        outcome=outcome,
        reason=reason,
        success=outcome == "success",
        time_s=round(simulation.time - began, 2),
        path_length_m=_length(path),
        goal_distance_m=round(distance, 3),
    )


def _length(points: np.ndarray) -> float:
    """Length of a polyline [m], rounded to 1 mm."""
    return round(float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()), 3)


def result_of(simulation: Simulation, legs: Sequence[Leg] = (), goals: int = 1) -> dict[str, Any]:
    """The result so far, JSON-compatible (report/trace.py lists the keys).

    Args:
        simulation: the simulation.
        legs: result of each goal, if there were several.
        goals: number of goals to reach.
    """
    scenario, navigator, history = simulation.scenario, simulation.navigator, simulation.history
    legs = list(legs) or [_leg(simulation, navigator.state.goal.tolist(), 0.0)]
    last, true, senses = legs[-1], simulation.true, simulation.senses
    path = np.array([row.robot_pose[:2] for row in history.rows])
    reached = sum(leg.success for leg in legs)
    outcome = last.outcome if reached < goals else "success"
    over = toppled(simulation.scene, simulation.qpos)
    objects = []
    for i, (entry, condition) in enumerate(zip(scenario.objects, simulation.conditions, strict=True)):
        believed = navigator.belief.objects.get(i)
        objects.append(
            {
                "id": i,
                "family": Path(entry.family).stem,
                "description": condition.describe(),
                "start_pose": list(entry.pose),
                "final_pose": _floats(true.object_pose[0, i]),
                "half_extents": list(condition.half_extents),
                "true": {name: round(value, 3) for name, value in true_values(condition).items()},
                "status": "not seen" if believed is None else str(believed.status),
                "registered": believed is not None and believed.status == "fixed",
                "toppled": bool(over[i]),
            }
        )
    return {
        "outcome": outcome,
        "reason": last.reason,
        "senses": senses.name,
        "policy": simulation.policy,
        "seed": scenario.seed,
        "time_s": round(float(true.time[0]), 2),
        "path_length_m": _length(path),
        "goal_distance_m": last.goal_distance_m,
        "falls": history.falls,
        "wall_contacts": history.wall_contacts,
        "wall_parts": history.wall_parts,
        "legs": [asdict(leg) for leg in legs],
        "missed_deadlines": history.late,
        "start": list(scenario.start),
        "goal": list(scenario.goal),
        "push_to": None if scenario.push_to is None else list(scenario.push_to),
        "transitions": [
            {"t": round(t.t, 2), "from": str(t.source), "to": str(t.target), "reason": t.reason}
            for t in navigator.transitions
        ],
        "decisions": [
            {
                "t": round(d.t, 2),
                "object": d.object,
                "K": round(d.K, 4) if np.isfinite(d.K) else None,
                "G": round(d.G, 4) if np.isfinite(d.G) else None,
                "probability": None if d.probability is None else round(d.probability, 4),
                "manipulable": d.manipulable,
                "goal": None if d.goal is None else _floats(d.goal),
                "reason": d.reason,
                "options": [
                    {
                        "text": option.text,
                        "works_s": round(option.works, 2),
                        "mean_s": round(option.seconds, 2),
                        "probability": round(option.probability, 4),
                    }
                    for option in d.options
                ],
            }
            for d in navigator.decisions
        ],
        "events": sorted(
            [*({"t": round(note.t, 2), "what": note.text} for note in navigator.notes), *history.touches],
            key=lambda event: event["t"],
        ),
        "objects": objects,
        "config": {
            "navigator": asdict(navigator.config),
            "senses": asdict(senses),
            "scenario": scenario.model_dump(mode="json"),
            "dt": DT,
        },
    }


def _outcome(simulation: Simulation, distance: float) -> tuple[str, str]:
    scenario, navigator, history = simulation.scenario, simulation.navigator, simulation.history
    if history.diverged:
        return "diverged", DIVERGED
    if history.falls:
        return "fall", f"the robot fell while it was to {navigator.mode}"
    if scenario.push_to is not None:
        turned = float(abs(se2.wrap(simulation.true.object_pose[0, 0, 2] - scenario.push_to[2])))
        there = distance <= scenario.limits.goal_tolerance_m and turned <= _YAW_TOLERANCE
        where = f"the object is {distance:.2f} m and {np.degrees(turned):.0f} deg from its goal"
        if history.wall_contacts and there:
            return "wall contact", f"{where}, but the robot touched a wall {history.wall_contacts} times"
        if not navigator.finished:
            return "timeout", f"{scenario.limits.time_s:g} s were not enough; {where}"
        return ("success", where) if there else ("stopped short", navigator.transitions[-1].reason)
    if navigator.mode is Mode.FAILED:
        return "blocked", navigator.transitions[-1].reason
    if distance <= scenario.limits.goal_tolerance_m and navigator.mode is Mode.DONE:
        if history.wall_contacts:
            return "wall contact", f"goal reached, but the robot touched a wall {history.wall_contacts} times"
        return "success", f"goal reached to {distance:.2f} m"
    if navigator.finished:
        return "stopped short", f"it stopped {distance:.2f} m from the goal"
    return (
        "timeout",
        f"{scenario.limits.time_s:g} s were not enough; {distance:.2f} m from the goal, state {navigator.mode}",
    )


def _floats(values: Array) -> list[float]:
    return [round(float(v), 4) for v in values]
