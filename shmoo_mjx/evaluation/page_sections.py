"""What the page of results says of each experiment: title, metrics by line and column, figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from statistics import fmean
from typing import Any

from shmoo_mjx.evaluation import faults, soak
from shmoo_mjx.evaluation.method_tables import ablations_table, baselines_table
from shmoo_mjx.evaluation.navigation_tables import navigation_tables
from shmoo_mjx.evaluation.outcomes_measures import outcomes_table
from shmoo_mjx.evaluation.pushing_measures import pushing_tables
from shmoo_mjx.evaluation.result import ExperimentResult, file_id
from shmoo_mjx.evaluation.scenario_set import find_set
from shmoo_mjx.evaluation.tables import (
    Line,
    Section,
    SummaryValue,
    difference,
    lines_of,
    lines_of_methods,
    measured,
    rate,
    short,
)

_FAMILIES = ("box", "cart", "wheelchair")

_OTHERS = ("",) * 7
"""Empty cells of the other policies."""

_CRITERIA = {"reach": "roll-outs", "K": "K", "impulse": "displacement and impulse", "moved_m": "displacement"}
_OF_CRITERIA = {
    "accuracy": "accuracy",
    "log_score": "log score (a coin: -0.69)",
    "calibration_error": "calibration error",
    "auc": "ROC area",
}


def _map_arguments(config: Mapping[str, Any]) -> str:
    """The maps or the scenario set; navigation goes without them as well, on floor plans of its own."""
    if (identity := config.get("scenario_set")) is not None:
        shipped = (file for file in find_set(Path("arena")).parent.glob("*.json") if file_id(file) == identity)
        return f"--scenarios {next((file.stem for file in shipped), 'FILE')}"
    return "" if config.get("generated_maps") else "--maps DIR"


def _offset(result: ExperimentResult) -> SummaryValue:
    mean, median = (100 * measured(result, name) for name in ("offset_m", "offset_median_m"))
    goals = [result.paper[name] for name in sorted(result.paper) if name.startswith("offset_goal")]
    paper = f"{short(100 * fmean(goals))} cm" if goals else ""
    return f"{short(mean)} cm (median {short(median)} cm)", round(measured(result, "trials")), paper


def _adapted(result: ExperimentResult) -> SummaryValue:
    paper, unseen = result.paper.get("ratio_after_before"), result.config.get("unseen", {})
    objects = sum(unseen.values()) if isinstance(unseen, dict) else int(unseen)
    return f"{measured(result, 'ratio_after_before'):.2f}", objects, "" if paper is None else f"{paper:.2f}"


SECTIONS = {
    "object_model": Section(
        "Predicting unseen objects (III-D, Fig. 4)",
        "psi adapts on the first 25 s of each unseen object and is scored on later rows.",
        ("prior", "after 25 s", "constant twist"),
        (
            *lines_of(
                {
                    "mse": "MSE of the acceleration",
                    "fvu_median": "variance unexplained, median object",
                },
                *("{}_before", "{}_after", "{}_constant_velocity"),
            ),
            *(
                Line(
                    f"variance unexplained, median {family}",
                    (f"fvu_median_before_{family}", f"fvu_median_after_{family}", ""),
                )
                for family in _FAMILIES
            ),
            *lines_of(
                {
                    "pos_rmse_1s_m": "position after 1 s open loop [m]",
                    "yaw_rmse_1s_deg": "yaw after 1 s [deg]",
                    "pos_rmse_3s_m": "position after 3 s [m]",
                    "yaw_rmse_3s_deg": "yaw after 3 s [deg]",
                },
                *("{}_before", "{}", "{}_constant_velocity"),
            ),
            *lines_of(
                {
                    "ratio_after_before": "MSE after / before",
                    "gap_closed_1s_median": "gap closed after 1 s of contact, median",
                    "gap_closed_1s_q25": "gap closed after 1 s, lower quartile",
                    "gap_closed_5s_median": "gap closed after 5 s, median",
                    "brake_fvu_unaware_median": "variance unexplained, a brake just put on, median",
                    "brake_fvu_known_median": "variance unexplained, a brake felt for 25 s, median",
                },
                *("", "{}", ""),
            ),
        ),
        ("roll_outs.png", "adaptation.png"),
        summary=(("Prediction error after adaptation, as a share of the error before", _adapted),),
    ),
    "estimate": Section(
        "What the estimate knows of an object",
        "Scripted operators push 20 unseen objects of each family, heavy ones and locked wheels included, with the "
        "robot's own senses. Errors are of the posterior's median; coverage is the share of true values in its 80 % "
        "band. Friction is that along the push. Roll-outs of 32 draws with psi, under the sensed force, predict the "
        "position 3 s ahead: the error is that of their mean, and the coverage is the share of x and y in their 80 % "
        "band. The prior's draws start from the same pose.",
        tuple(f"{family}, {seconds:g} s" for family in _FAMILIES for seconds in (1, 3, 10)),
        lines_of(
            {
                "friction_error": "friction, relative error, median",
                "friction_coverage": "friction, coverage",
                "mass_error": "mass, relative error, median",
                "mass_coverage": "mass, coverage",
                "ahead_error": "position 3 s ahead, error, median [m]",
                "prior_ahead_error": "position 3 s ahead, draws from the prior [m]",
                "ahead_coverage": "position 3 s ahead, coverage",
                "prior_ahead_coverage": "position 3 s ahead, coverage of the prior",
            },
            *(f"{{}}_{family}_{seconds:g}s" for family in _FAMILIES for seconds in (1, 3, 10)),
        ),
    ),
    "outcomes": Section(
        "Where pushes lead",
        "The pushing controller pushes an unseen object for 5 s of contact, with the robot's own senses. Then the "
        "object is pushed on three faces, towards goals up to 29 deg beside straight ahead, in the real plant. Samples "
        "of the posterior predict each push from where it begins, over 12 s; so do samples of the prior of the "
        "object's kind. Poses are compared after 0.8 m of the object's path, where the push and at least a quarter of "
        "the samples move it that far, and, for all pushes, after 0.8 m of path or 12 s. The same push by another "
        "robot shows how much is chance. The gate for chains of pushes, after 0.8 m: 0.10 m and 10 deg for free "
        "objects, 0.25 m and 30 deg with one locked wheel, and 70 to 90 % of ends within the 80 % region. In brackets "
        "are 95 % bootstrap intervals over objects. Condition seed 27 is a development seed: it was looked at while "
        "predictions were improved.",
        figures=("outcomes.png",),
        table=outcomes_table,
    ),
    "baselines": Section(
        "Beside other ways to predict (V-B)",
        "Every method is tuned on validation objects with the same budget.",
        figures=("baselines.png",),
        table=baselines_table,
    ),
    "ablations": Section(
        "One choice at a time",
        "Trainings that differ in one choice; a fresh probe measures how well the condition can be read from psi.",
        table=ablations_table,
    ),
    "pushing": Section(
        "Pushing to a pose (VI-A, Fig. 7)",
        "The proxy robot pushes unseen objects to three goals. Two strata: movable objects, and demanding ones (load "
        "far off the centre, 25 to 45 N of resistance, half or twice the friction, a brake from the start). "
        "Both leave out objects with a locked wheel and objects that resist with more than 32 N (demanding: 43 N). "
        "A third stratum leaves out nothing and has tables of its own. Every method runs every trial.",
        ("ours", "frozen prior", "contact model", "quasi-static", "oracle coefficients", "paper's system"),
        (
            *lines_of_methods(
                {
                    **{f"offset_goal{i}_m": f"offset, goal {i} [m]" for i in (1, 2, 3)},
                    **{f"radius_goal{i}_m": f"enclosing circle, goal {i} [m]" for i in (1, 2, 3)},
                    "success_rate": "success",
                    "success_rate_movable": "success, movable",
                    "success_rate_demanding": "success, demanding",
                    **{f"success_rate_{family}": f"success, {family}" for family in _FAMILIES},
                    "success_rate_change_brake": "success, a brake pressed on the way",
                    "offset_m": "offset, mean [m]",
                    "offset_movable_m": "offset, mean, movable [m]",
                    "offset_demanding_m": "offset, mean, demanding [m]",
                    "offset_median_m": "offset, median [m]",
                    "yaw_error_deg": "yaw error [deg]",
                    "falls": "falls",
                    "toppled": "objects toppled",
                    "worst_lean_rad": "worst lean [rad]",
                    "time_s": "time [s]",
                    "pushes": "pushes",
                    "trials": "trials",
                },
                *("frozen_prior", "contact_model", "quasi_static", "oracle_coefficients", "paper"),
            ),
            Line("way from the prior's offset to the oracle's", ("way_to_oracle", "", "", "", "", "")),
        ),
        ("pushing.png",),
        further_tables=pushing_tables,
        summary=(
            (
                "Success rate of pushing movable objects to a pose",
                rate("success_rate", lambda r: measured(r, "trials")),
            ),
            (
                "Success rate compared with no adaptation",
                difference("difference_frozen_prior_success", "points", 100.0),
            ),
            ("Mean distance from the goal after pushing", _offset),
            (
                "Distance from the goal compared with no adaptation",
                difference("difference_frozen_prior_offset_m", "cm", 100.0),
            ),
        ),
    ),
    "object_planner": Section(
        "Can it be moved? (IV-B, Algorithm 1, Fig. 5)",
        "The navigator probes unseen objects, at least half of them immovable. An object is manipulable if a steady "
        "push moves it 0.316 m along the push before it has turned by 30 deg. Objects near the border are so laden "
        "that it moves them 0.2 to 0.5 m. The decision is the share of roll-outs over the posterior in which the "
        "object comes as far. Other criteria are logistic regressions that are fitted to objects of training: on K, "
        "on displacement and impulse, and on displacement. Seconds are of contact.",
        ("as drawn", "near the border", "both"),
        lines_of(
            {
                "accuracy": "accuracy after 1 s",
                "accuracy_2s": "accuracy after 2 s",
                "accuracy_3s": "accuracy after 3 s",
                "accuracy_clear": "accuracy after 1 s, objects near the border left out",
                "near_border": "objects near the border",
                "manipulable_called_manipulable": "manipulable, called so",
                "manipulable_called_immovable": "manipulable, called immovable",
                "immovable_called_immovable": "immovable, called so",
                "immovable_called_manipulable": "immovable, called manipulable",
                "undecided": "not touched",
                **{
                    f"{measure}_{criterion}_after_1s": f"{name} after 1 s, {by}"
                    for measure, name in _OF_CRITERIA.items()
                    for criterion, by in _CRITERIA.items()
                },
            },
            *("{}", "{}_border", "{}_all"),
        ),
        ("reliability.png", "confusion.png", "planned_goals.png"),
        summary=(
            (
                "Accuracy of the decision whether an object can be moved",
                rate("accuracy", lambda r: float(r.config.get("objects", 0))),
            ),
        ),
    ),
    "navigation": Section(
        "Interactive navigation (VI-B)",
        "Generated scenarios. Effort efficiency is 1 if nothing is pushed; the interactive navigation score is that of "
        "Interactive Gibson, half path and half effort efficiency. Aims are those for ours.",
        ("ours", "lazy", "frozen", "always avoid", "always push", "paper", "geometric", "oracle"),
        (
            *lines_of_methods(
                {
                    "success_rate": "success (aim 0.96)",
                    "success_rate_push_only": "success, push only (aim 0.92)",
                    "success_rate_detour_only": "success, detour only (aim 0.92)",
                    "success_rate_either": "success, either (aim 0.92)",
                    "falls": "falls (aim 0)",
                    "toppled": "objects toppled",
                    "wall_contacts_per_100": "wall contacts in 100 runs (aim 1)",
                    "time_s": "time of successes [s]",
                    "path_length_m": "path of successes [m]",
                    "displacement_m": "objects displaced by [m]",
                    "efficiency": "path efficiency",
                    "effort": "effort efficiency, mass moved",
                    "effort_force": "effort efficiency, force",
                    "ins": "interactive navigation score",
                    "scenarios": "scenarios",
                },
                *("lazy", "frozen", "always_avoid", "always_push", "paper", "geometric", "oracle"),
            ),
            Line("time over the oracle's, where both succeed (aim 1.2)", ("time_over_oracle", *_OTHERS)),
            Line("scenarios that neither baseline can do", ("neither_baseline", *_OTHERS)),
            Line("scenarios that neither baseline can do and ours can", ("neither_baseline_but_ours", *_OTHERS)),
        ),
        ("success.png", "causes.png", "time_over_extra.png"),
        arguments=_map_arguments,
        further_tables=navigation_tables,
        summary=(
            (
                "Success rate of navigation, solvable scenarios",
                rate("success_rate_certified", lambda r: measured(r, "certified")),
            ),
            (
                "Success rate compared with never pushing",
                difference("difference_always_avoid_success", "points", 100.0),
            ),
            ("Time lost compared with going round if possible", difference("difference_lazy_regret_s", "s")),
        ),
    ),
    "lifelong": Section(
        "One goal after the other",
        "Five goals in a row in a world that stays as the robot has left it, with what it remembers of objects. A "
        "sequence ends where the robot gives up, falls or runs out of time.",
        ("ours",),
        lines_of(
            {
                "success_rate": "all goals reached",
                "goals_reached": "goals reached",
                **{f"success_rate_goal{i}": f"goal {i} reached, of those begun" for i in range(1, 6)},
                **{f"time_s_goal{i}": f"time to goal {i} [s]" for i in range(1, 6)},
                **{f"efficiency_goal{i}": f"path efficiency to goal {i}" for i in range(1, 6)},
                "falls": "falls",
                "wall_contacts_per_100_goals": "wall contacts in 100 goals",
                "effort": "effort efficiency, mass moved",
                "effort_force": "effort efficiency, force",
                "sequences": "sequences",
            }
        ),
        (),
        arguments=_map_arguments,
    ),
}

RELIABILITY = {
    "faults": Section(
        "Faults",
        "One fault in each run of the demo, judged by the true state.",
        arguments=lambda config: f"--runs {config.get('runs')}",
        command="shmoo faults",
        table=faults.summary,
    ),
    "soak": Section(
        "Soak",
        "Errand after errand in one building while others move objects.",
        arguments=lambda config: f"--minutes {config.get('minutes', 0):g} --buildings {config.get('buildings')}",
        command="shmoo soak",
        table=soak.summary,
    ),
}
"""Of what ``shmoo faults`` and ``shmoo soak`` write."""
