"""What the page of results says of each experiment: title, metrics by line and column, figures."""

from __future__ import annotations

from shmoo_mjx.evaluation import faults, soak
from shmoo_mjx.evaluation.method_tables import ablations_table, baselines_table
from shmoo_mjx.evaluation.navigation import map_arguments
from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.evaluation.tables import (
    Line,
    Section,
    SummaryValue,
    lines_of,
    measured,
)

_FAMILIES = ("box", "cart", "wheelchair")


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
        arguments=map_arguments,
    ),
}

RELIABILITY = {"faults": faults.EXPERIMENT.section, "soak": soak.EXPERIMENT.section}
"""Of what ``shmoo faults`` and ``shmoo soak`` write."""
