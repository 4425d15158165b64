"""Experiment navigation: our policy and seven others on the same generated scenarios.

* lazy goes round whenever there is a way round, and pushes otherwise.
* frozen does not adapt: it keeps the prior of each object's family.
* oracle pushes the objects that the best option of the certificate pushes, and goes round all others. Without a
  certificate it knows which objects can be moved. It adapts as ours does.
* always_avoid treats every object as a wall.
* always_push pushes whatever is in the way and never goes round.
* paper is the paper's system (`behavior.methods`): its weights, its cost, and K < 0.3 m^2 after 1 s of contact.
* geometric assumes that every object is movable, as planners after Stilman do. It pushes where that shortens the path,
  and registers objects that a push has not moved.

The reference is the best option of each certificate. It is not run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shmoo_mjx.arrays import Array
from shmoo_mjx.base import custom
from shmoo_mjx.base.assets import asset
from shmoo_mjx.behavior.belief import Status
from shmoo_mjx.behavior.methods import FROZEN, METHODS, PAPER
from shmoo_mjx.behavior.state import NavigatorConfig
from shmoo_mjx.evaluation.experiment import Experiment, ExperimentConfig, Prepared, Setup
from shmoo_mjx.evaluation.navigation_failures import keep_failure, write_failures
from shmoo_mjx.evaluation.navigation_figures import draw_figures
from shmoo_mjx.evaluation.navigation_measures import (
    cause_of,
    choice_of,
    effort_by_force,
    effort_by_mass,
    interactive_score,
    measure,
)
from shmoo_mjx.evaluation.navigation_places import find_places, kept_scenario
from shmoo_mjx.evaluation.navigation_tables import navigation_tables, policies_table, reference_table
from shmoo_mjx.evaluation.paired import OURS
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult, file_id
from shmoo_mjx.evaluation.scenario_set import find_set, open_set
from shmoo_mjx.evaluation.scenarios import Generated, ScenarioConfig
from shmoo_mjx.evaluation.tables import (
    Effect,
    Line,
    Section,
    Table,
    difference,
    effects,
    lines_of_methods,
    measured,
    rate,
    shown_name,
)
from shmoo_mjx.evaluation.trials import controller_of
from shmoo_mjx.planning.maps import OccupancyGrid, load_map
from shmoo_mjx.planning.object_planner import ObjectPlannerConfig
from shmoo_mjx.planning.scenario import Scenario
from shmoo_mjx.plant.robot import shmoobot

if TYPE_CHECKING:
    from shmoo_mjx.run.episode import Episode


class PolicyVariant(NamedTuple):
    """A policy: settings of the navigator, initial beliefs, and the method behind it."""

    config: NavigatorConfig
    first_status: Callable[[Generated], list[Status]] | None = None
    """Initial status of each object, given the scenario."""
    method: str = OURS
    """Method whose weights and pushing it uses (`shmoo_mjx.behavior.methods`)."""


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
"""Policies in the order in which they run. Ours comes first, for experiments that are stopped."""


@dataclass(frozen=True)
class NavigationTrials(ExperimentConfig):
    """What is tried."""

    scenarios: int = 20
    """Scenarios per map. Each policy runs all of them."""
    generated_scenarios: int = 4
    """Scenarios per generated building, if no maps are given."""
    policies: tuple[str, ...] = tuple(POLICIES)
    scenario: ScenarioConfig = ScenarioConfig()


def _adjust(options: ExperimentOptions, config: NavigationTrials) -> NavigationTrials:
    count = config.scenarios if options.quick or options.maps else config.generated_scenarios
    count = count if options.scenarios is None else options.scenarios
    return replace(config, scenarios=count, policies=options.chosen(POLICIES, others=True))


def _prepare(options: ExperimentOptions, config: NavigationTrials, folder: Path) -> Prepared:
    """Places and number of scenarios per map, from ``options.maps``, generated buildings or a scenario set."""
    most, count = 2 if options.quick else None, config.scenarios
    if options.scenario_set is None:
        places = find_places(options, folder, config.scenario, most)
    else:
        places, count = open_set(options.scenario_set, folder / "set")
        places, count = replace(places, maps=dict(list(places.maps.items())[:most])), 1 if options.quick else count
    return Prepared((places, count), *deciding(options))


def deciding(options: ExperimentOptions) -> tuple[tuple[Path, ...], tuple[Any, ...]]:
    """Files and settings that decide about every run, independent of the requested policies and scenarios."""
    policies = {name: [asdict(p.config), asdict(METHODS[p.method])] for name, p in POLICIES.items()}
    sets = () if options.scenario_set is None else (options.scenario_set,)
    return (options.weights_file, asset(METHODS[PAPER].weights), *sets), (policies,)


def _trials(setup: Setup[NavigationTrials]) -> dict[str, tuple[str, int, str]]:
    places, count = setup.data
    scenarios = {f"{name}-{i}": (name, i) for i in range(count) for name in places.maps}
    return {
        f"{scenario}-{custom.kept_as('policy', policy, POLICIES)}": (*place, policy)
        for policy in setup.config.policies
        for scenario, place in scenarios.items()
        if places.entries is None or scenario in places.entries
    }


def _trial(setup: Setup[NavigationTrials], trial: tuple[str, int, str]) -> list[dict[str, Any]]:
    """Run one policy in one scenario. No row if the map has no place for the scenario."""
    places, _ = setup.data
    map_name, number, policy = trial
    grid = load_map(places.maps[map_name])
    wanted, generated = kept_scenario(places, grid, map_name, number)
    if generated is None:
        return []
    about = {"map": map_name, "scenario": number, "policy": policy, "kind": generated.kind, "wanted": wanted}
    episode = play(setup.options, grid, generated, policy)
    row = about | _row(episode, generated)
    if policy == OURS and not row["success"]:
        keep_failure(setup.store, f"{map_name}-{number}", episode)
    return [row]


def _draw(setup: Setup[NavigationTrials], rows: list[dict[str, Any]]) -> None:
    places, _ = setup.data
    draw_figures(setup.folder, rows, places.maps)
    write_failures(setup.folder, [r for r in rows if r["policy"] == OURS], setup.store, setup.options.progress)


def _about(setup: Setup[NavigationTrials]) -> dict[str, Any]:
    options, (places, count) = setup.options, setup.data
    return {
        "scenarios": count,
        "maps": list(places.maps),
        "generated_maps": options.maps is None and options.scenario_set is None,
        "scenario_set": options.scenario_set and file_id(options.scenario_set),
    }


def play(
    options: ExperimentOptions,
    grid: OccupancyGrid,
    generated: Generated,
    policy: str,
    *,
    goals: Sequence[tuple[float, float]] = (),
) -> Episode:
    """Run a policy (of POLICIES, or "package.module:Name") in a generated scenario.

    ``goals`` are reached one after the other in place of the scenario's goal.
    """
    from shmoo_mjx.run.episode import run_episode

    config, first_status, method = POLICIES.get(policy, POLICIES[OURS])
    return run_episode(
        grid,
        generated.scenario.model_copy(update={"seed": generated.scenario.seed + options.seed}),
        controller_of(asset(METHODS[method].weights) if method == PAPER else options.weights_file, method),
        config=config,
        first_status=None if first_status is None else first_status(generated),
        senses=options.senses,
        goals=goals,
        policy=None if policy in POLICIES else policy,
    )


def told_of(episode: Episode, generated: Generated) -> dict[str, Any]:
    """Fields of a row that do not depend on the number of goals."""
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
    """Path efficiency, both effort efficiencies, and the interactive navigation score of a run."""
    from shmoo_mjx.run.simulation import conditions_of

    result, trace, robot = episode.result, episode.trace, shmoobot().upper_mass + shmoobot().ball_mass
    driven = result["path_length_m"]
    efficiency = (result["outcome"] == "success") * min(shortest / max(driven, 1e-9), 1.0)
    moved = [_travelled(trace.object_pose[:, i, :2]) for i in range(len(scenario.objects))]
    by_mass = effort_by_mass(robot, driven, [c.total_mass for c in conditions_of(scenario)], moved)
    by_force = effort_by_force(robot, np.asarray(trace.force))
    score = interactive_score(efficiency, by_mass, by_force)
    return {"efficiency": efficiency, "effort": by_mass, "effort_force": by_force, "ins": score}


def _travelled(path: Array) -> float:
    """Length of an object's path [m]. Steps below 1 mm in 0.1 s are settling and do not count."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    return float(steps[steps > 1e-3].sum())


def map_arguments(config: Mapping[str, Any]) -> str:
    """Arguments for the maps or the scenario set; empty for generated floor plans."""
    if (identity := config.get("scenario_set")) is not None:
        shipped = (file for file in find_set(Path("arena")).parent.glob("*.json") if file_id(file) == identity)
        return f"--scenarios {next((file.stem for file in shipped), 'FILE')}"
    return "" if config.get("generated_maps") else "--maps DIR"


EFFECTS = Effect("the success rate", "success", "points", 100.0), Effect("the time lost", "regret_s", "s")
"""What the page compares policies by."""


def _shows(result: ExperimentResult) -> str:
    subjects = {
        "lazy": "Compared with going round wherever possible, ours",
        "frozen": "Compared with no adaptation, ours",
        "always_avoid": "Compared with never pushing, ours",
        PAPER: "Compared with the paper's system, ours",
    }
    told = (effects(result, subject, f"difference_{policy}_", EFFECTS) for policy, subject in subjects.items())
    return " ".join(sentence for sentence in told if sentence)


_OTHERS = ("lazy", FROZEN, "always_avoid", "always_push", PAPER, "geometric", "oracle")

EXPERIMENT = Experiment(
    Section(
        "Interactive navigation",
        "Does the robot reach its goal past objects in its way? Does deciding between pushing and going round pay? "
        "(Sec. VI-B of the paper)",
        (
            policies_table,
            reference_table,
            Table(
                ("ours", *(shown_name(policy) for policy in _OTHERS)),
                (
                    *lines_of_methods(
                        {
                            "success_rate": "Success rate, all scenarios",
                            "success_rate_push_only": "Success rate, push only",
                            "success_rate_detour_only": "Success rate, detour only",
                            "success_rate_either": "Success rate, either",
                            "falls": "Falls",
                            "toppled": "Objects toppled",
                            "wall_contacts_per_100": "Wall contacts in 100 runs",
                            "time_s": "Mean time of successes [s]",
                            "path_length_m": "Mean path of successes [m]",
                            "displacement_m": "Mean displacement of objects [m]",
                            "efficiency": "Path efficiency",
                            "effort": "Effort efficiency, by mass moved",
                            "effort_force": "Effort efficiency, by force",
                            "ins": "Interactive navigation score",
                            "scenarios": "Scenarios",
                        },
                        *_OTHERS,
                    ),
                    *(
                        Line(label, (name, *[""] * len(_OTHERS)))
                        for name, label in {
                            "time_over_oracle": "Time divided by that of the policy that knows what to push",
                            "neither_baseline": "Scenarios that neither always nor never pushing solves",
                            "neither_baseline_but_ours": "Of these, solved by ours",
                        }.items()
                    ),
                ),
            ),
            navigation_tables,
        ),
        _shows,
        {
            "time_over_extra.png": "Time over the extra length of the way round, for each policy. "
            "Failures (x) count 120 s more than the best option",
            "success.png": "Success rate of each policy by kind of scenario",
            "causes.png": "Causes of failures",
        },
        arguments=map_arguments,
        summary=(
            (
                "Success rate of navigation, solvable scenarios",
                rate("success_rate_certified", lambda r: measured(r, "certified")),
            ),
            (
                "Success rate of navigation, compared with never pushing",
                difference("difference_always_avoid_success", "points", 100.0),
            ),
            (
                "Time lost compared with going round wherever possible",
                difference("difference_lazy_regret_s", "s"),
            ),
        ),
    ),
    NavigationTrials(),
    quick=NavigationTrials(scenarios=1),
    trials=_trials,
    trial=_trial,
    metrics=lambda setup, rows: measure(rows, setup.config.policies),
    draw=_draw,
    prepare=_prepare,
    adjust=_adjust,
    printed=reference_table,
    neutral=("scenarios", "generated_scenarios", "policies"),
    about=_about,
    only_drawn=("driven", "goal", "objects"),
)
