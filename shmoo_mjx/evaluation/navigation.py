"""Experiment navigation: generated scenarios on any maps, our policy against three others on the same scenarios.

*always_avoid* takes every object for a wall. *always_push* pushes whatever is in the way and never goes round. *oracle*
is told of each object whether it can be moved and needs no planning stage to find out; coefficients it learns as we do.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.assets import asset
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.manipulable import manipulable
from shmoo_mjx.evaluation.result import Ask, ExperimentResult, make_result
from shmoo_mjx.evaluation.scenarios import KINDS, Generated, ScenarioConfig, draw_scenario
from shmoo_mjx.evaluation.trials import fingerprint, run_trials
from shmoo_mjx.navigation.belief import Status
from shmoo_mjx.navigation.maps import OccupancyGrid, load_map
from shmoo_mjx.navigation.object_planner import ObjectPlannerConfig
from shmoo_mjx.navigation.records import NavigatorConfig
from shmoo_mjx.navigation.yaml_input import write_whole
from shmoo_mjx.plant.robot import ROBOT
from shmoo_mjx.run import DEMO_WEIGHTS

__all__ = ["OURS", "POLICIES", "NavigationTrials", "Policy", "cause_of", "find_maps", "measure", "run"]

OURS = "ours"


@dataclass(frozen=True)
class Policy:
    """How objects are dealt with."""

    config: NavigatorConfig
    first_status: Callable[[Generated], list[Status]] | None = None
    """What the robot takes each object to be from the start."""


def _all_fixed(generated: Generated) -> list[Status]:
    return [Status.FIXED for _ in generated.movable]


def _as_they_are(generated: Generated) -> list[Status]:
    return [Status.UNKNOWN if movable else Status.FIXED for movable in generated.movable]


_ALL_MOVABLE = ObjectPlannerConfig(threshold=0.0)
POLICIES = {
    OURS: Policy(NavigatorConfig()),
    "always_avoid": Policy(NavigatorConfig(second_chance=False), _all_fixed),
    "always_push": Policy(NavigatorConfig(goes_round=False, planner=_ALL_MOVABLE)),
    "oracle": Policy(NavigatorConfig(planner=_ALL_MOVABLE), _as_they_are),
}


@dataclass(frozen=True)
class NavigationTrials:
    """What is tried."""

    scenarios: int = 20
    """Per map."""
    baseline_scenarios: int = 4
    """Of these the other policies run the first ones only."""
    policies: tuple[str, ...] = tuple(POLICIES)
    workers: int = 2
    scenario: ScenarioConfig = ScenarioConfig()


def run(ask: Ask) -> ExperimentResult:
    """Run the experiment on the maps of ``ask.maps``; scenarios, trials and figures go to ``ask.out / navigation``."""
    from shmoo_mjx.evaluation.navigation_figures import draw_figures

    cfg = NavigationTrials(scenarios=1 if ask.quick else NavigationTrials().scenarios)
    if ask.scenarios is not None:
        cfg = replace(cfg, scenarios=ask.scenarios)
    maps = find_maps(ask.maps)
    if ask.quick:
        maps = dict(list(maps.items())[:2])
    weights = ask.weights or asset(DEMO_WEIGHTS)
    folder = ask.out / "navigation"
    settings = asdict(replace(cfg, scenarios=0, baseline_scenarios=0)) | {"seeds": [ask.seed, ask.condition_seed]}
    settings["policies"] = {name: asdict(POLICIES[name].config) for name in cfg.policies}
    store = folder / f"trials-{fingerprint(settings, weights)}"
    names = [f"{name}-{i}" for i in range(cfg.scenarios) for name in maps]
    work = partial(_trials, cfg, maps, ask.seed, ask.first_unseen, weights, store)
    rows = run_trials(names, work, store, ask.progress, cfg.workers)
    metrics = measure(rows, cfg.policies)
    draw_figures(folder, rows, maps)
    light = [{k: v for k, v in row.items() if k not in ("driven", "scenario_file", "transitions")} for row in rows]
    return make_result("navigation", ask, cfg, metrics, {}, light)


def find_maps(folder: Path | None) -> dict[str, Path]:
    """Name to YAML of every map_server map below ``folder``.

    Raises:
        ShmooError: there is none.
    """
    if folder is None:
        raise ShmooError("experiment navigation needs --maps DIR, a folder with map_server maps (YAML and image).")
    found = sorted(p for p in folder.rglob("*.yaml") if "image:" in p.read_text(errors="replace"))
    if not found:
        raise ShmooError(f"--maps {folder}: holds no map_server YAML with the field 'image'; give a folder of maps.")
    return {"_".join(p.relative_to(folder).with_suffix("").parts): p for p in found}


def _trials(
    cfg: NavigationTrials, maps: dict[str, Path], seed: int, first_unseen: int, weights: Path, store: Path, name: str
) -> list[dict[str, Any]]:
    """Our policy, and of the first scenarios every policy. Each run is kept as soon as it ends."""
    map_name, _, number = name.rpartition("-")
    grid = load_map(maps[map_name])
    index = list(maps).index(map_name)
    generated = _scenario(cfg, grid, store / "scenarios" / f"{name}.json", int(number), index, first_unseen)
    if generated is None:
        return []
    rows = []
    for policy in cfg.policies if int(number) < cfg.baseline_scenarios else (OURS,):
        file = store / "runs" / f"{name}-{policy}.json"
        if not file.is_file():
            row = _run_one(grid, generated, policy, seed, weights)
            _keep(file, {"map": map_name, "scenario": int(number), "policy": policy} | row)
        rows.append(json.loads(file.read_text()))
    return rows


def _keep(file: Path, data: Any) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    write_whole(file, (json.dumps(data) + "\n").encode())


def _scenario(
    cfg: NavigationTrials, grid: OccupancyGrid, file: Path, number: int, index: int, first_unseen: int
) -> Generated | None:
    """Scenario ``number`` of a map: the kinds take turns, and a map that has no place for one gets the next kind."""
    from shmoo_mjx.navigation.scenario import Scenario

    if file.is_file():
        data = json.loads(file.read_text())
        return None if data is None else Generated(**data | {"scenario": Scenario.model_validate(data["scenario"])})
    found = None
    for turn in range(len(KINDS)):
        kind = KINDS[(number + index + turn) % len(KINDS)]
        rng = np.random.default_rng([first_unseen, index, number, turn])
        try:
            found = draw_scenario(grid, kind, rng, first_unseen, manipulable, cfg.scenario)
            break
        except ShmooError:
            continue
    _keep(file, None if found is None else found._asdict() | {"scenario": found.scenario.model_dump(mode="json")})
    return found


def _run_one(grid: OccupancyGrid, generated: Generated, policy: str, seed: int, weights: Path) -> dict[str, Any]:
    from shmoo_mjx.episode import conditions_of, run_episode

    chosen = POLICIES[policy]
    scenario = generated.scenario.model_copy(update={"seed": generated.scenario.seed + seed})
    first = None if chosen.first_status is None else chosen.first_status(generated)
    episode = run_episode(grid, scenario, _controller(weights), chosen.config, first_status=first)
    result, trace = episode.result, episode.trace
    moved = [_travelled(trace.object_pose[:, i, :2]) for i in range(len(scenario.objects))]
    masses = [c.total_mass for c in conditions_of(scenario)]
    driven = result["path_length_m"]
    success = result["outcome"] == "success"
    return {
        "kind": generated.kind,
        "movable": list(generated.movable),
        "blocking": list(generated.blocking),
        "success": success,
        "outcome": result["outcome"],
        "cause": cause_of(result, generated),
        "reason": result["reason"],
        "falls": result["falls"],
        "wall_contacts": result["wall_contacts"],
        "time_s": result["time_s"],
        "path_length_m": driven,
        "shortest_m": generated.shortest,
        "detour_m": generated.detour,
        "efficiency": success * min(generated.shortest / max(driven, 1e-9), 1.0),
        "effort": effort(ROBOT.upper_mass + ROBOT.ball_mass, driven, masses, moved),
        "displacement_m": float(sum(map(_displacement, result["objects"]))),
        "decisions": [{k: d[k] for k in ("t", "object", "K", "manipulable")} for d in result["decisions"]],
        "transitions": result["transitions"],
        "events": result["events"],
        "objects": result["objects"],
        "driven": np.round(trace.robot_pose[::5, :2], 2).tolist(),
        "scenario_file": scenario.model_dump(mode="json"),
    }


def _displacement(item: dict[str, Any]) -> float:
    return float(np.linalg.norm(np.subtract(item["final_pose"], item["start_pose"])[:2]))


def _travelled(path: np.ndarray) -> float:
    """Length [m] of an object's way; what is below 1 mm in 0.1 s is settling."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    return float(steps[steps > 1e-3].sum())


def effort(robot_mass: float, driven: float, masses: list[float], moved: list[float]) -> float:
    """m0 l0 / (m0 l0 + sum m_i l_i): 1 if nothing was moved (Interactive Gibson, Bench-NPIN)."""
    own = robot_mass * driven
    return float(own / max(own + float(np.dot(masses, moved)), 1e-9)) if driven > 0 else 1.0


def cause_of(result: dict[str, Any], generated: Generated) -> str:
    """Why a run failed, in a few words that failures can be sorted by; empty for a success."""
    outcome = result["outcome"]
    if outcome == "success":
        return ""
    if outcome in ("fall", "wall contact"):
        return outcome
    states = [o["status"] for o in result["objects"]]
    wrong = [s == "fixed" and m for s, m in zip(states, generated.movable, strict=True)]
    if outcome == "timeout":
        return f"out of time while to {result['reason'].rpartition('state ')[2]}"
    if any(wrong):
        decided = {d["object"] for d in result["decisions"] if not d["manipulable"]}
        judged = any(w and i in decided for i, w in enumerate(wrong))
        return "a movable object was judged immovable" if judged else "a movable object was given up"
    if "parked" in states:
        return "an object was left where it blocks the way"
    return "no way found past objects that can't be moved"


def measure(rows: list[dict[str, Any]], policies: tuple[str, ...]) -> dict[str, Any]:
    """Metrics of every policy, ours without a prefix; ``baseline_<name>_ours_*`` is ours on that one's scenarios."""
    metrics: dict[str, Any] = {}
    ran = {p: {(r["map"], r["scenario"]) for r in rows if r["policy"] == p} for p in policies}
    for policy in policies:
        prefix = "" if policy == OURS else f"baseline_{policy}_"
        mine = [r for r in rows if r["policy"] == policy]
        metrics |= {prefix + name: value for name, value in _of_policy(mine).items()}
        if policy != OURS:
            same = [r for r in rows if r["policy"] == OURS and (r["map"], r["scenario"]) in ran[policy]]
            ours = _of_policy(same)
            metrics |= {f"{prefix}ours_{name}": ours[name] for name in ("success_rate", "time_s", "efficiency")}
    solved = {p: {(r["map"], r["scenario"]) for r in rows if r["policy"] == p and r["success"]} for p in policies}
    everything = {(r["map"], r["scenario"]) for r in rows}
    simple = [p for p in ("always_avoid", "always_push") if p in policies]
    compared = set.intersection(*(ran[p] for p in simple)) if simple else set()
    neither = compared - set().union(*(solved[p] for p in simple))
    metrics["scenarios"] = len(everything)
    metrics["scenarios_compared"] = len(compared)
    metrics["neither_baseline"] = len(neither)
    metrics["neither_baseline_but_ours"] = len(neither & solved.get(OURS, set()))
    for kind in KINDS:
        metrics[f"scenarios_{kind.replace(' ', '_')}"] = len(
            {(r["map"], r["scenario"]) for r in rows if r["kind"] == kind}
        )
    return metrics


def _of_policy(rows: list[dict[str, Any]]) -> dict[str, Any]:
    def mean(name: str, of: list[dict[str, Any]]) -> float | None:
        return float(np.mean([r[name] for r in of])) if of else None

    good = [r for r in rows if r["success"]]
    metrics = {
        "success_rate": mean("success", rows),
        "falls": sum(r["falls"] for r in rows),
        "wall_contacts": sum(r["wall_contacts"] for r in rows),
        "time_s": mean("time_s", good),
        "path_length_m": mean("path_length_m", good),
        "efficiency": mean("efficiency", rows),
        "effort": mean("effort", rows),
        "displacement_m": mean("displacement_m", rows),
    }
    for kind in KINDS:
        of = [r for r in rows if r["kind"] == kind]
        metrics[f"success_rate_{kind.replace(' ', '_')}"] = mean("success", of)
    return metrics


@cache
def _controller(weights: Path) -> Any:
    from shmoo_mjx.control.pushing import PushController
    from shmoo_mjx.learning.weights import load_weights

    return PushController(load_weights(weights))
