"""Figure of the experiment real_pushing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.report.style import SERIES, blank_figure, save_figure

__all__ = ["draw_figure"]

_BARS = (
    ("pair_out", "ours", "ours, pair left out", SERIES[0]),
    ("shape_out", "ours", "ours, shape left out", SERIES[4]),
    ("pair_out", "poly4", "published 4th-order polynomial", SERIES[1]),
    ("pair_out", "quadratic", "published quadratic", SERIES[7]),
)


def draw_figure(path: Path, rows: list[dict[str, Any]]) -> None:
    """Bars of the mean error by condition, with the range over the seeds."""
    conditions = list(dict.fromkeys(row["condition"] for row in rows))
    figure = blank_figure(10.0, 6.0)
    panels = figure.subplots(2, 1, sharex=True)
    for axes, unit, label in zip(
        panels, ("pos_error_mm", "angle_error_deg"), ("position error [mm]", "angle error [deg]"), strict=True
    ):
        for j, (protocol, predictor, name, colour) in enumerate(_BARS):
            key = f"{predictor}_{unit}"
            values = [
                [r[key] for r in rows if r["condition"] == c and r["trial"].endswith(protocol) and key in r]
                for c in conditions
            ]
            place = [i for i, v in enumerate(values) if v]
            means = np.array([np.mean(values[i]) for i in place])
            reach = np.array([[means[k] - min(values[i]), max(values[i]) - means[k]] for k, i in enumerate(place)])
            where = np.array(place) + 0.2 * (j - 1.5)
            axes.bar(
                where, means, 0.19, yerr=reach.T if place else None, color=colour, label=name, error_kw={"lw": 0.8}
            )
        axes.set_ylabel(label)
    panels[1].set_xticks(range(len(conditions)), conditions, rotation=45, ha="right", fontsize=8)
    panels[0].legend(fontsize=8, ncols=2)
    save_figure(path, figure)
