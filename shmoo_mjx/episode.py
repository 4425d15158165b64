"""One run of a scenario: the simulated world on one side, the navigator on the other, and a record of both."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.navigation.belief import Status
from shmoo_mjx.navigation.maps import OccupancyGrid, occupied_rectangles
from shmoo_mjx.navigation.navigator import Navigator
from shmoo_mjx.navigation.records import Mode, NavigatorConfig
from shmoo_mjx.navigation.scenario import Scenario
from shmoo_mjx.plant.objects import Condition
from shmoo_mjx.plant.scene import PARTS, Scene, build_scene
from shmoo_mjx.recorded import Recorded
from shmoo_mjx.report.trace import Trace
from shmoo_mjx.sensing import PERFECT, SensedEngine, SensedWorld, Senses, senses_named
from shmoo_mjx.types import DT, Command, Observation

__all__ = ["Episode", "Hooks", "conditions_of", "navigator_of", "run_episode", "scene_of"]

Point = Sequence[float]


class Episode(NamedTuple):
    """A finished run."""

    result: dict[str, Any]
    """JSON-able: outcome, transitions, decisions, objects (report/trace.py lists the keys)."""
    trace: Trace
    scene: Scene
    qpos: np.ndarray
    """``[T, nq]`` for rendering."""
    navigator: Navigator
    """As it was at the end."""
    recorded: Recorded


class Hooks(NamedTuple):
    """What a caller may add to a run; each is called once a sample."""

    progress: Callable[[float, str], None] = lambda time, mode: None
    """Takes (simulated time [s], state)."""
    perceive: Callable[[Observation], Observation] = lambda seen: seen
    """A further fault of the senses, such as a pose of NaN."""
    disturb: Callable[[Scene, SensedWorld], SensedWorld] = lambda scene, world: world
    """What others do in the world, such as moving an object or releasing its brakes."""
    over: Callable[[Navigator], bool] = lambda navigator: False
    """Ends the run before the navigator does."""


@dataclass
class _Record:
    rows: list[dict[str, Any]] = field(default_factory=list)
    qpos: list[np.ndarray] = field(default_factory=list)
    observations: list[Observation] = field(default_factory=list)
    commands: list[Command] = field(default_factory=list)
    goals: list[np.ndarray] = field(default_factory=list)
    legs: list[dict[str, Any]] = field(default_factory=list)
    late: list[dict[str, Any]] = field(default_factory=list)
    """Missed deadlines, against the wall clock."""
    falls: int = 0
    wall_contacts: int = 0
    touching: bool = False
    wall_parts: dict[str, int] = field(default_factory=dict)
    touches: list[dict[str, Any]] = field(default_factory=list)
    """Contacts with walls, as events."""


def conditions_of(scenario: Scenario) -> list[Condition]:
    """The objects' conditions, drawn from family and seed with the given properties replaced."""
    return [o.condition() for o in scenario.objects]


def scene_of(grid: OccupancyGrid, scenario: Scenario, conditions: list[Condition], senses: Senses = PERFECT) -> Scene:
    """The MuJoCo world: every wall of the map (a way round may lead anywhere), objects and the robot."""
    walls = occupied_rectangles(grid, unknown_borders=True)
    placed = [(c, o.pose) for c, o in zip(conditions, scenario.objects, strict=True)]
    adjust = senses.adjust(scenario.seed)
    return build_scene(placed, scenario.start, walls, float(grid.origin[2]), adjust=adjust)


def navigator_of(
    grid: OccupancyGrid,
    scenario: Scenario,
    controller: PushController,
    senses: Senses,
    config: NavigatorConfig | None = None,
    first_status: Sequence[Status] | None = None,
) -> Navigator:
    """The navigator of a run; what it has to compute takes as long as ``senses`` say."""
    config = replace(config or NavigatorConfig(), planning_time=senses.planning, latency=senses.latency)
    sizes = [c.half_extents for c in conditions_of(scenario)]
    return Navigator(grid, scenario.goal, sizes, controller, scenario.seed, config, first_status)


def run_episode(
    grid: OccupancyGrid,
    scenario: Scenario,
    controller: PushController,
    config: NavigatorConfig | None = None,
    hooks: Hooks = Hooks(),  # noqa: B008  (immutable)
    first_status: Sequence[Status] | None = None,
    senses: str | Senses | None = None,
    goals: Sequence[Point] = (),
    real_time: bool = False,
) -> Episode:
    """Run ``scenario`` until the navigator ends, the robot falls or time is up.

    Args:
        grid: the map.
        scenario: start, goal, objects, limits.
        controller: the adaptive pushing controller.
        config: the navigator's settings.
        hooks: callbacks of the caller.
        first_status: what the robot takes each object to be when it first sees it; UNKNOWN if not given.
        senses: real or perfect, or others; if not given those of the scenario, or real.
        goals: ``(x, y)`` in {W} [m], in place of the scenario's: one after the other, in the world as the robot has
            left it and with all that it knows; the time limit is that of all.
        real_time: run against the wall clock. A command takes effect after the time it really took to compute.
    """
    chosen = senses if isinstance(senses, Senses) else senses_named(senses or scenario.senses or "real")
    conditions = conditions_of(scenario)
    scene = scene_of(grid, scenario, conditions, chosen)
    ahead = [tuple(goal) for goal in goals] or [scenario.goal]
    first = scenario.model_copy(update={"goal": ahead[0]})
    navigator = navigator_of(grid, first, controller, chosen, config, first_status)
    record = _Record()
    with SensedEngine([scene], chosen, scenario.seed) as engine:
        world = engine.init()
        seen, true = engine.observe(world), engine.true_observation(world)
        for number, goal in enumerate(ahead):
            began = float(true.time[0])
            if number:
                navigator.head_for(goal, began)
            while not navigator.finished and float(true.time[0]) < scenario.limits.time_s and not record.falls:
                tick = time.perf_counter()
                perceived = hooks.perceive(seen)
                command = navigator.tick(perceived)
                hooks.progress(float(true.time[0]), str(navigator.mode))
                _note(record, navigator, perceived, true, command, world.physics[0, 1 : 1 + scene.model.nq])
                if hooks.over(navigator):
                    break
                world, spent = hooks.disturb(scene, world), time.perf_counter() - tick
                world, seen = _advance(engine, world, command, spent if real_time else None, record, navigator)
                true = engine.true_observation(world)
                _count_contacts(record, world, float(true.time[0]), navigator)
                record.falls += int(engine.fallen(world)[0])
                if real_time:
                    time.sleep(max(0.0, DT - (time.perf_counter() - tick)))
            record.legs.append(_leg(scenario, navigator, record, true, goal, began))
            if not record.legs[-1]["success"]:
                break
    return Episode(
        _result(scenario, conditions, navigator, record, true, chosen, len(ahead)),
        _trace(grid, navigator, record),
        scene,
        np.array(record.qpos),
        navigator,
        Recorded(_stacked(record.observations), _stacked(record.commands), np.array(record.goals)),
    )


def _advance(
    engine: SensedEngine,
    world: SensedWorld,
    command: Command,
    spent: float | None,
    record: _Record,
    navigator: Navigator,
) -> tuple[SensedWorld, Observation]:
    """The world after a sample, or after as many as computing has really taken."""
    world, seen = engine.step(world, command, computing=spent)
    if spent is None or spent <= DT:
        return world, seen
    record.late.append({"t": round(float(seen.time[0]), 1), "state": str(navigator.mode), "ms": round(1e3 * spent)})
    for _ in range(int(spent / DT)):
        world, seen = engine.step(world, command, computing=0.0)
    # The controller's samples are DT apart: what spans a longer time teaches nothing.
    return world, seen._replace(detected=np.zeros_like(seen.detected))


def _count_contacts(record: _Record, world: SensedWorld, now: float, navigator: Navigator) -> None:
    """A contact counts once, however long it lasts."""
    touching = bool(world.wall_contact[0])
    if touching and not record.touching:
        record.wall_contacts += 1
        parts = [PARTS[i] for i in np.flatnonzero(world.wall_parts[0])]
        for part in parts:
            record.wall_parts[part] = record.wall_parts.get(part, 0) + 1
        text = f"touches a wall with {' and '.join(parts)} while to {navigator.mode}"
        record.touches.append({"t": round(now, 2), "what": text})
    record.touching = touching


def _note(
    record: _Record,
    navigator: Navigator,
    seen: Observation,
    true: Observation,
    command: Command,
    qpos: np.ndarray,
) -> None:
    adapting = navigator.coefficients
    index = -1 if adapting is None else adapting[0]
    wrench = true.wrench[0, :, :2].sum(axis=0)
    record.qpos.append(qpos.copy())
    record.observations.append(seen)
    record.commands.append(command)
    record.goals.append(navigator.state.goal)
    record.rows.append(
        {
            "t": float(true.time[0]),
            "robot_pose": true.robot_pose[0],
            "lean": true.lean[0],
            "u": command.u[0],
            "object_pose": true.object_pose[0],
            "force": se2.rotate(wrench, -true.robot_pose[0, 2]),
            "coefficients": None if adapting is None else adapting[1],
            "coefficient_object": index,
            "state": list(Mode).index(navigator.mode),
        }
    )


def _stacked(rows: Sequence[Any]) -> Any:
    """Named tuples of arrays as one, with time in front."""
    return type(rows[0])(*(np.stack([np.asarray(v) for v in column]) for column in zip(*rows, strict=True)))


def _trace(grid: OccupancyGrid, navigator: Navigator, record: _Record) -> Trace:
    def column(name: str) -> np.ndarray:
        return np.array([row[name] for row in record.rows])

    width = next((len(r["coefficients"]) for r in record.rows if r["coefficients"] is not None), 18)
    blank = np.full(width, np.nan)
    coefficients = np.array([blank if r["coefficients"] is None else r["coefficients"] for r in record.rows])
    names = ("t", "robot_pose", "lean", "u", "object_pose", "force", "coefficient_object", "state")
    return Trace(
        **{name: column(name) for name in names},
        coefficients=coefficients,
        state_names=tuple(str(m) for m in Mode),
        map_cells=grid.cells,
        map_origin=np.asarray(grid.origin, dtype=float),
        map_resolution=grid.resolution,
        plan_times=np.array([p.t for p in navigator.plans]),
        plans=tuple(p.points for p in navigator.plans),
        decision_rollouts=tuple(d.rollouts for d in navigator.decisions),
        decision_candidates=tuple(d.candidates for d in navigator.decisions),
    )


def _leg(
    scenario: Scenario, navigator: Navigator, record: _Record, true: Observation, goal: Point, began: float
) -> dict[str, Any]:
    """How one goal was reached, or not."""
    distance = float(np.linalg.norm(true.robot_pose[0, :2] - np.asarray(goal)[:2]))
    outcome, reason = _outcome(scenario, navigator, record, distance)
    path = np.array([row["robot_pose"][:2] for row in record.rows if row["t"] >= began - 1e-6])
    return {
        "goal": _floats(np.asarray(goal, dtype=float)),
        "outcome": outcome,
        "reason": reason,
        "success": outcome == "success",
        "time_s": round(float(true.time[0]) - began, 2),
        "path_length_m": round(float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()), 3),
        "goal_distance_m": round(distance, 3),
    }


def _result(
    scenario: Scenario,
    conditions: list[Condition],
    navigator: Navigator,
    record: _Record,
    seen: Observation,
    senses: Senses,
    goals: int,
) -> dict[str, Any]:
    last = record.legs[-1]
    path = np.array([row["robot_pose"][:2] for row in record.rows])
    reached = sum(leg["success"] for leg in record.legs)
    outcome = last["outcome"] if reached < goals else "success"
    objects = []
    for i, (entry, condition) in enumerate(zip(scenario.objects, conditions, strict=True)):
        known = navigator.belief.objects.get(i)
        objects.append(
            {
                "id": i,
                "family": entry.family,
                "description": condition.describe(),
                "start_pose": list(entry.pose),
                "final_pose": _floats(seen.object_pose[0, i]),
                "half_extents": list(condition.half_extents),
                "status": "not seen" if known is None else str(known.status),
                "registered": known is not None and known.status == "fixed",
            }
        )
    return {
        "outcome": outcome,
        "reason": last["reason"],
        "senses": senses.name,
        "seed": scenario.seed,
        "time_s": round(float(seen.time[0]), 2),
        "path_length_m": round(float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()), 3),
        "goal_distance_m": last["goal_distance_m"],
        "falls": record.falls,
        "wall_contacts": record.wall_contacts,
        "wall_parts": record.wall_parts,
        "legs": record.legs,
        "missed_deadlines": record.late,
        "start": list(scenario.start),
        "goal": list(scenario.goal),
        "transitions": [
            {"t": round(t.t, 2), "from": str(t.source), "to": str(t.target), "reason": t.reason}
            for t in navigator.transitions
        ],
        "decisions": [
            {
                "t": round(d.t, 2),
                "object": d.object,
                "K": round(d.K, 4),
                "G": round(d.G, 4),
                "manipulable": d.manipulable,
                "goal": None if d.goal is None else _floats(d.goal),
                "reason": d.reason,
            }
            for d in navigator.decisions
        ],
        "events": sorted(
            [*({"t": round(note.t, 2), "what": note.text} for note in navigator.notes), *record.touches],
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


def _outcome(scenario: Scenario, navigator: Navigator, record: _Record, distance: float) -> tuple[str, str]:
    if record.falls:
        return "fall", f"the robot fell while it was to {navigator.mode}"
    if navigator.mode is Mode.FAILED:
        return "blocked", navigator.transitions[-1].reason
    if distance <= scenario.limits.goal_tolerance_m and navigator.mode is Mode.DONE:
        if record.wall_contacts:
            return "wall contact", f"goal reached, but the robot touched a wall {record.wall_contacts} times"
        return "success", f"goal reached to {distance:.2f} m"
    return (
        "timeout",
        f"{scenario.limits.time_s:g} s were not enough; {distance:.2f} m from the goal, state {navigator.mode}",
    )


def _floats(values: np.ndarray) -> list[float]:
    return [round(float(v), 4) for v in values]
