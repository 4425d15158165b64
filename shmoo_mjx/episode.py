"""One run of a scenario: the simulated world on one side, the navigator on the other, and a record of both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.control.pushing import PushController
from shmoo_mjx.navigation.belief import Status
from shmoo_mjx.navigation.maps import OccupancyGrid, occupied_rectangles
from shmoo_mjx.navigation.navigator import Navigator
from shmoo_mjx.navigation.records import Mode, NavigatorConfig
from shmoo_mjx.navigation.scenario import Scenario
from shmoo_mjx.plant.engine_mujoco import MujocoEngine, World
from shmoo_mjx.plant.objects import Condition, draw_condition
from shmoo_mjx.plant.scene import Scene, build_scene
from shmoo_mjx.report.trace import Trace
from shmoo_mjx.types import DT, Observation

__all__ = ["Episode", "Hooks", "conditions_of", "run_episode", "scene_of"]


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


class Hooks(NamedTuple):
    """What a caller may add to a run; each is called once a sample."""

    progress: Callable[[float, str], None] = lambda time, mode: None
    """Takes (simulated time [s], state)."""
    perceive: Callable[[Observation], Observation] = lambda seen: seen
    """What the robot's senses make of the truth; NaN stands for the pose of an object that was not detected."""
    disturb: Callable[[Scene, World], World] = lambda scene, world: world
    """What others do in the world, such as moving an object or releasing its brakes."""
    over: Callable[[Navigator], bool] = lambda navigator: False
    """Ends the run before the navigator does."""


@dataclass
class _Record:
    rows: list[dict[str, Any]]
    qpos: list[np.ndarray]
    falls: int = 0
    wall_contacts: int = 0
    touching: bool = False


def conditions_of(scenario: Scenario) -> list[Condition]:
    """The objects' conditions, drawn from family and seed with the given properties replaced."""
    return [draw_condition(o.family, o.seed, o.properties) for o in scenario.objects]


def scene_of(grid: OccupancyGrid, scenario: Scenario, conditions: list[Condition]) -> Scene:
    """The MuJoCo world: every wall of the map (a way round may lead anywhere), objects and the robot."""
    walls = occupied_rectangles(grid, unknown_borders=True)
    placed = [(c, o.pose) for c, o in zip(conditions, scenario.objects, strict=True)]
    return build_scene(placed, scenario.start, walls, float(grid.origin[2]))


def run_episode(
    grid: OccupancyGrid,
    scenario: Scenario,
    controller: PushController,
    config: NavigatorConfig | None = None,
    hooks: Hooks = Hooks(),  # noqa: B008  (immutable)
    first_status: Sequence[Status] | None = None,
) -> Episode:
    """Run ``scenario`` until the navigator ends, the robot falls or time is up.

    Args:
        grid: the map.
        scenario: start, goal, objects, limits.
        controller: the adaptive pushing controller.
        config: the navigator's settings.
        hooks: callbacks of the caller.
        first_status: what the robot takes each object to be when it first sees it; UNKNOWN if not given.
    """
    conditions = conditions_of(scenario)
    scene = scene_of(grid, scenario, conditions)
    engine = MujocoEngine([scene])
    sizes = [c.half_extents for c in conditions]
    navigator = Navigator(grid, scenario.goal, sizes, controller, scenario.seed, config, first_status)
    world = engine.init()
    seen = engine.observe(world)
    record = _Record([], [])
    while not navigator.finished and float(seen.time[0]) < scenario.limits.time_s and not record.falls:
        command = navigator.tick(hooks.perceive(seen))
        hooks.progress(float(seen.time[0]), str(navigator.mode))
        _note(record, navigator, seen, command.u[0], world.physics[0, 1 : 1 + scene.model.nq])
        if hooks.over(navigator):
            break
        world, seen = engine.step(hooks.disturb(scene, world), command)
        # A contact counts once, however long it lasts.
        record.wall_contacts += int(world.wall_contact[0] and not record.touching)
        record.touching = bool(world.wall_contact[0])
        record.falls += int(engine.fallen(world)[0])
    engine.close()
    return Episode(
        _result(scenario, conditions, navigator, record, seen),
        _trace(grid, navigator, record),
        scene,
        np.array(record.qpos),
        navigator,
    )


def _note(record: _Record, navigator: Navigator, seen: Observation, u: np.ndarray, qpos: np.ndarray) -> None:
    adapting = navigator.coefficients
    index = -1 if adapting is None else adapting[0]
    wrench = seen.wrench[0, :, :2].sum(axis=0)
    record.qpos.append(qpos.copy())
    record.rows.append(
        {
            "t": float(seen.time[0]),
            "robot_pose": seen.robot_pose[0],
            "lean": seen.lean[0],
            "u": u,
            "object_pose": seen.object_pose[0],
            "force": se2.rotate(wrench, -seen.robot_pose[0, 2]),
            "coefficients": None if adapting is None else adapting[1],
            "coefficient_object": index,
            "state": list(Mode).index(navigator.mode),
        }
    )


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
        plan_times=np.array([t for t, _ in navigator.plans]),
        plans=tuple(p for _, p in navigator.plans),
        decision_rollouts=tuple(d.rollouts for d in navigator.decisions),
        decision_candidates=tuple(d.candidates for d in navigator.decisions),
    )


def _result(
    scenario: Scenario, conditions: list[Condition], navigator: Navigator, record: _Record, seen: Observation
) -> dict[str, Any]:
    distance = float(np.linalg.norm(seen.robot_pose[0, :2] - np.array(scenario.goal)))
    outcome, reason = _outcome(scenario, navigator, record, distance)
    path = np.array([row["robot_pose"][:2] for row in record.rows])
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
        "reason": reason,
        "seed": scenario.seed,
        "time_s": round(float(seen.time[0]), 2),
        "path_length_m": round(float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()), 3),
        "goal_distance_m": round(distance, 3),
        "falls": record.falls,
        "wall_contacts": record.wall_contacts,
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
        "events": [{"t": round(t, 2), "what": what} for t, what in navigator.belief.events],
        "objects": objects,
        "config": {"navigator": asdict(navigator.config), "scenario": scenario.model_dump(mode="json"), "dt": DT},
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
