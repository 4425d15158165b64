"""Experiment navigation: generated scenarios on any maps, our policy against seven others on the same scenarios.

*lazy* goes round whenever there is a way round, however long, and pushes otherwise. *frozen* learns nothing: what is
known of an object stays what it looks like. *oracle* is told by the certificate which objects the best option pushes,
pushes these and goes round all others; without a certificate it is told which objects can be moved. Coefficients it
learns as we do. *always_avoid* takes every object for a wall. *always_push* pushes whatever is in the way and never
goes round. *paper* is the paper's system (`behavior.methods`): its weights, its cost, and K < 0.3 m^2 after 1 s of
contact. *geometric* takes whatever is in the way for movable, as planners after Stilman do, pushes wherever that makes
the path shorter, and registers what a push has not moved. The *reference* is the best option of each certificate, and
is not run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shmoo_mjx.base import custom
from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.behavior.belief import Status
from shmoo_mjx.behavior.methods import FROZEN, METHODS, PAPER
from shmoo_mjx.behavior.state import NavigatorConfig
from shmoo_mjx.evaluation.navigation_failures import keep_failure, write_failures
from shmoo_mjx.evaluation.navigation_measures import (
    cause_of,
    choice_of,
    effort_by_force,
    effort_by_mass,
    interactive_score,
    measure,
)
from shmoo_mjx.evaluation.navigation_places import Places, find_places, kept_scenario
from shmoo_mjx.evaluation.paired import OURS
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, file_id, make_result
from shmoo_mjx.evaluation.scenario_set import open_set
from shmoo_mjx.evaluation.scenarios import Generated, ScenarioConfig
from shmoo_mjx.evaluation.trials import controller_of, run_trials
from shmoo_mjx.planning.maps import OccupancyGrid, load_map
from shmoo_mjx.planning.object_planner import ObjectPlannerConfig
from shmoo_mjx.planning.scenario import Scenario
from shmoo_mjx.plant.robot import shmoobot

if TYPE_CHECKING:
    from shmoo_mjx.run.episode import Episode


class PolicyVariant(NamedTuple):
    """How objects are dealt with."""

    config: NavigatorConfig
    first_status: Callable[[Generated], list[Status]] | None = None
    """What the robot takes each object to be from the start."""
    method: str = OURS
    """Whose weights and pushing it has (`shmoo_mjx.behavior.methods`)."""


def _as_they_are(generated: Generated) -> list[Status]:
    movable = generated.movable
    if generated.certificate is not None:
        movable = tuple(i in generated.certificate.pushed for i in range(len(movable)))
    return [Status.UNKNOWN if moves else Status.FIXED for moves in movable]


_ALL_MOVABLE = ObjectPlannerConfig(threshold=0.0)
POLICIES = {
    OURS: PolicyVariant(NavigatorConfig()),
    "lazy": PolicyVariant(NavigatorConfig(goes_round="always")),
    FROZEN: PolicyVariant(METHODS[FROZEN].navigator, method=FROZEN),
    "oracle": PolicyVariant(NavigatorConfig(goes_round="never"), _as_they_are),
    "always_avoid": PolicyVariant(NavigatorConfig(), lambda generated: [Status.FIXED for _ in generated.movable]),
    "always_push": PolicyVariant(NavigatorConfig(goes_round="never")),
    PAPER: PolicyVariant(METHODS[PAPER].navigator, method=PAPER),
    "geometric": PolicyVariant(NavigatorConfig(decides_by="K", planner=_ALL_MOVABLE)),
}
"""In the order in which they run: of an experiment that is stopped, ours is there first."""


@dataclass(frozen=True)
class TestedRobot:
    """With what every policy runs."""

    seed: int
    """Added to the scenario's."""
    senses: str
    """real or perfect."""
    weights: Path


def robot_of(options: ExperimentOptions) -> TestedRobot:
    """The robot that is asked for."""
    return TestedRobot(options.seed, options.senses, options.weights or asset(WEIGHTS))


@dataclass(frozen=True)
class NavigationTrials:
    """What is tried."""

    scenarios: int = 20
    """Per map; each policy runs all of them."""
    generated_scenarios: int = 4
    """Per generated building, where no maps are given."""
    policies: tuple[str, ...] = tuple(POLICIES)
    workers: int = 2
    scenario: ScenarioConfig = ScenarioConfig()


def run(options: ExperimentOptions) -> ExperimentResult:
    """Run the experiment on the maps of ``options.maps`` or on a scenario set; its files go to ``out / navigation``."""
    from shmoo_mjx.evaluation.navigation_figures import draw_figures

    folder = options.out / "navigation"
    cfg = NavigationTrials(policies=options.chosen(POLICIES, others=True))
    count = 1 if options.quick else cfg.scenarios if options.maps else cfg.generated_scenarios
    cfg = replace(cfg, scenarios=count if options.scenarios is None else options.scenarios)
    most = 2 if options.quick else None
    if options.scenario_set is None:
        places = find_places(options, folder, cfg.scenario, most)
    else:
        places, count = open_set(options.scenario_set, folder / "set")
        places = replace(places, maps=dict(list(places.maps.items())[:most]))
        cfg = replace(cfg, scenarios=1 if options.quick else count)
    store = trials_folder(options, folder, cfg.scenario)
    there = {f"{name}-{i}": (name, i) for i in range(cfg.scenarios) for name in places.maps}
    trials = {
        f"{scenario}-{custom.kept_as('policy', policy, POLICIES)}": (*place, policy)
        for policy in cfg.policies
        for scenario, place in there.items()
        if places.given is None or scenario in places.given
    }
    work = partial(_trial, places, robot_of(options), store)
    rows = run_trials(trials, work, store, options.progress, cfg.workers)
    draw_figures(folder, rows, places.maps)
    write_failures(folder, [r for r in rows if r["policy"] == OURS], store, options.progress)
    metrics = measure(rows, cfg.policies)
    about = {
        "senses": options.senses,
        "maps": list(places.maps),
        "generated_maps": options.maps is None and options.scenario_set is None,
        "scenario_set": options.scenario_set and file_id(options.scenario_set),
    }
    return make_result("navigation", options, asdict(cfg) | about, metrics, {}, [_light(row) for row in rows])


def trials_folder(options: ExperimentOptions, folder: Path, scenario: ScenarioConfig) -> Path:
    """Where runs are kept: one folder for what they all share, whichever policies and how many scenarios are asked."""
    robot = robot_of(options)
    settings: dict[str, Any] = {"seeds": [robot.seed, options.condition_seed], "senses": robot.senses}
    settings["scenario"] = asdict(scenario)
    settings["policies"] = {name: [asdict(p.config), asdict(METHODS[p.method])] for name, p in POLICIES.items()}
    given = () if options.scenario_set is None else (options.scenario_set,)
    weights = robot.weights, asset(METHODS[PAPER].weights)
    return folder / f"trials-{fingerprint(__name__, settings, *weights, *given)}"


def _trial(places: Places, robot: TestedRobot, store: Path, trial: tuple[str, int, str]) -> list[dict[str, Any]]:
    """One run: of one policy in one scenario. No row if the map has no place for that scenario."""
    map_name, number, policy = trial
    grid = load_map(places.maps[map_name])
    wanted, generated = kept_scenario(places, grid, map_name, number)
    if generated is None:
        return []
    about = {"map": map_name, "scenario": number, "policy": policy, "kind": generated.kind, "wanted": wanted}
    episode = play(robot, grid, generated, policy)
    row = about | _row(episode, generated)
    if policy == OURS and not row["success"]:
        keep_failure(store, f"{map_name}-{number}", episode)
    return [row]


def play(
    robot: TestedRobot,
    grid: OccupancyGrid,
    generated: Generated,
    policy: str,
    goals: Sequence[tuple[float, float]] = (),
) -> Episode:
    """One run of a policy (of POLICIES, or "package.module:Name") through a generated scenario.

    ``goals``, one after the other, take the place of the scenario's.
    """
    from shmoo_mjx.run.episode import run_episode

    config, first_status, method = POLICIES.get(policy, POLICIES[OURS])
    return run_episode(
        grid,
        generated.scenario.model_copy(update={"seed": generated.scenario.seed + robot.seed}),
        controller_of(asset(METHODS[method].weights) if method == PAPER else robot.weights, method),
        config=config,
        first_status=None if first_status is None else first_status(generated),
        senses=robot.senses,
        goals=goals,
        policy=None if policy in POLICIES else policy,
    )


def told_of(episode: Episode, generated: Generated) -> dict[str, Any]:
    """What a row says of a run, however many goals it had."""
    names = ("reason", "falls", "wall_contacts", "wall_parts", "time_s", "path_length_m")
    return {
        "movable": list(generated.movable),
        "blocking": list(generated.blocking),
        "success": episode.result["outcome"] == "success",
        "toppled": sum(item["toppled"] for item in episode.result["objects"]),
        "cause": cause_of(episode.result, generated),
        **{name: episode.result[name] for name in names},
    }


def _row(episode: Episode, generated: Generated) -> dict[str, Any]:
    result, trace = episode.result, episode.trace
    displaced = np.array([np.subtract(o["final_pose"], o["start_pose"])[:2] for o in result["objects"]]).reshape(-1, 2)
    return {
        **told_of(episode, generated),
        "outcome": result["outcome"],
        "shortest_m": generated.shortest,
        "detour_m": generated.detour,
        "extra_m": generated.extra,
        **choice_of(result, trace, generated),
        **scores_of(episode, generated.scenario, generated.shortest),
        "displacement_m": float(np.linalg.norm(displaced, axis=1).sum()),
        "decisions": [{k: d[k] for k in ("t", "object", "K", "manipulable")} for d in result["decisions"]],
        "objects": result["objects"],
        "driven": np.round(trace.robot_pose[::5, :2], 2).tolist(),
        "goal": list(generated.scenario.goal),
    }


def scores_of(episode: Episode, scenario: Scenario, shortest: float) -> dict[str, float]:
    """Path efficiency, both parts of effort efficiency, and the interactive navigation score of a run."""
    from shmoo_mjx.run.simulation import conditions_of

    result, trace, robot = episode.result, episode.trace, shmoobot().upper_mass + shmoobot().ball_mass
    driven = result["path_length_m"]
    efficiency = (result["outcome"] == "success") * min(shortest / max(driven, 1e-9), 1.0)
    moved = [_travelled(trace.object_pose[:, i, :2]) for i in range(len(scenario.objects))]
    by_mass = effort_by_mass(robot, driven, [c.total_mass for c in conditions_of(scenario)], moved)
    by_force = effort_by_force(robot, np.asarray(trace.force))
    score = interactive_score(efficiency, by_mass, by_force)
    return {"efficiency": efficiency, "effort": by_mass, "effort_force": by_force, "ins": score}


def _travelled(path: np.ndarray) -> float:
    """Length [m] of an object's way; what is below 1 mm in 0.1 s is settling."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    return float(steps[steps > 1e-3].sum())


def _light(row: dict[str, Any]) -> dict[str, Any]:
    """The row without what only figures need."""
    heavy = ("driven", "goal", "objects")
    return {name: value for name, value in row.items() if name not in heavy}
