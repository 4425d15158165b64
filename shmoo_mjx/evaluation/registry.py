"""The experiments by name. Each module has ``run(options) -> ExperimentResult`` and is imported only when asked for."""

from __future__ import annotations

from importlib import import_module

from shmoo_mjx.arrays import single_precision
from shmoo_mjx.base.files import claimed
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult

EXPERIMENTS = {
    "object_model": "shmoo_mjx.evaluation.object_model",
    "estimate": "shmoo_mjx.evaluation.estimate",
    "outcomes": "shmoo_mjx.evaluation.outcomes",
    "baselines": "shmoo_mjx.evaluation.baselines",
    "ablations": "shmoo_mjx.evaluation.ablations",
    "robot_finetune": "shmoo_mjx.evaluation.robot_finetune",
    "pushing": "shmoo_mjx.evaluation.pushing",
    "object_planner": "shmoo_mjx.evaluation.object_planner",
    "navigation": "shmoo_mjx.evaluation.navigation",
    "lifelong": "shmoo_mjx.evaluation.lifelong",
    "real_pushing": "shmoo_mjx.evaluation.real_pushing",
}
"""Name to module."""


@single_precision
def run_experiment(name: str, options: ExperimentOptions) -> ExperimentResult:
    """Run one experiment, in a folder of its own below ``options.out``."""
    if name not in EXPERIMENTS:
        raise ShmooError(f"experiment {name!r} is not known; choose one of {', '.join(EXPERIMENTS)}.")
    with claimed(options.out / name):
        result: ExperimentResult = import_module(EXPERIMENTS[name]).run(options)
    return result
