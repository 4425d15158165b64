"""What the page of results says of each experiment: title, metrics by line and column, figures."""

from __future__ import annotations

from shmoo_mjx.evaluation import faults, soak
from shmoo_mjx.evaluation.navigation import map_arguments
from shmoo_mjx.evaluation.tables import Section, lines_of

SECTIONS = {
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
