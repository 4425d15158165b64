"""The tables of `baselines` and `ablations` in docs/results.md, made from their JSON; none is typed by hand."""

from __future__ import annotations

import math

from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.report.tables import markdown_table

_NAMES = {
    "ours": "ours",
    "ours_paper": "ours, the paper's printed form",
    "trigonometric": "trigonometric functions of time",
    "residual": "adaptive residual, with contact model",
    "gru": "GRU, with contact model",
    "mlp": "one MLP, no adaptation",
    "prior": "ours, before contact (prior)",
    "constant_velocity": "constant twist in {O}",
    "replay": "simulator with true parameters, mean wrench",
}

_AFTER_3S = ("3 s position [m]", "3 s yaw [deg]")


def baselines_table(result: ExperimentResult) -> str:
    """One line per method, the least MSE first: errors after adapting, spread over seeds, ratios to ours."""
    found = result.metrics
    names = [name for name in _NAMES if f"mse_{name}" in found]
    head = ("method", "MSE", "MSE / ours", "paper", "FVU", "FVU, median object", *_AFTER_3S, "setting")
    rows = []
    settings = {row["method"]: row["setting"] for row in result.rows if "method" in row}
    for name in sorted(names, key=lambda n: math.inf if (mse := found[f"mse_{n}"]) is None else mse):
        paper = result.paper.get(f"ratio_{name}")
        row = [
            _NAMES[name],
            _spread(found, "mse", name),
            _number(1.0 if name == "ours" else found.get(f"ratio_{name}")),
            "" if paper is None else f"{paper:g}",
            _spread(found, "fvu", name),
            _number(found.get(f"fvu_median_{name}")),
            _spread(found, "pos_rmse_3s_m", name),
            _spread(found, "yaw_rmse_3s_deg", name),
            ", ".join(f"{key} {value}" for key, value in settings.get(name, {}).items()) or "default",
        ]
        rows.append(row)
    return f"{markdown_table(head, rows)}\n\n{_source(result)}"


def ablations_table(result: ExperimentResult) -> str:
    """One line per variant: error on unseen objects, and how well a fresh probe tells the condition from psi."""
    found = result.metrics
    names = [key.removeprefix("mse_") for key in found if key.startswith("mse_") and not key.startswith("mse_std_")]
    head = ("variant", "MSE", "FVU", "FVU, median object", *_AFTER_3S, "probe on psi")
    measures = ("mse", "fvu", "fvu_median", "pos_rmse_3s_m", "yaw_rmse_3s_deg", "probe_psi")
    rows = [[name, *(_spread(found, measure, name) for measure in measures)] for name in names]
    probes = (
        f"The same probe on the raw inputs: {_number(found['probe_inputs'])}; without the size: "
        f"{_number(found['probe_inputs_without_size'])}; chance: {_number(found['chance'])}."
    )
    return f"{markdown_table(head, rows)}\n\n{probes}\n\n{_source(result)}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _spread(found: dict[str, float | None], measure: str, name: str) -> str:
    """Mean and, where there is more than one seed, the standard deviation over seeds.

    A measure that is there without a number is infinite (`result.over_seeds`): some object's roll-out diverged.
    """
    if found.get(f"{measure}_{name}", 0.0) is None:
        return "diverges"
    std = found.get(f"{measure}_std_{name}")
    return _number(found.get(f"{measure}_{name}")) + (f"±{std:.2g}" if std else "")


def _source(result: ExperimentResult) -> str:
    config = result.config
    objects = sum(config["unseen"].values())
    return f"{objects} unseen objects, {config['seeds']} seeds."
