"""The experiments by name. Each module defines EXPERIMENT and is imported when the experiment is needed."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib import import_module
from typing import Any

from shmoo_mjx.arrays import single_precision
from shmoo_mjx.base.files import claimed
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation.experiment import Experiment, run
from shmoo_mjx.evaluation.result import ExperimentOptions, ExperimentResult

EXPERIMENTS = {
    "navigation": "shmoo_mjx.evaluation.navigation",
    "lifelong": "shmoo_mjx.evaluation.lifelong",
    "pushing": "shmoo_mjx.evaluation.pushing",
    "object_planner": "shmoo_mjx.evaluation.object_planner",
    "outcomes": "shmoo_mjx.evaluation.outcomes",
    "estimate": "shmoo_mjx.evaluation.estimate",
    "object_model": "shmoo_mjx.evaluation.object_model",
    "baselines": "shmoo_mjx.evaluation.baselines.experiment",
    "ablations": "shmoo_mjx.evaluation.ablations",
    "robot_finetune": "shmoo_mjx.evaluation.robot_finetune",
    "real_pushing": "shmoo_mjx.evaluation.real_pushing",
}
"""Name to module, in the order of the page."""
RELIABILITY = {"faults": "shmoo_mjx.evaluation.faults", "soak": "shmoo_mjx.evaluation.soak"}
"""Experiments for developers. ``shmoo experiment all`` does not run them."""
_SENSING = ("navigation", "lifelong", "pushing", "object_planner", "outcomes", "estimate", "robot_finetune")
"""Experiments that run the trained weights with simulated sensing."""
OPTIONS = {
    "weights": (*_SENSING, *RELIABILITY),
    "senses": _SENSING,
    "data": ("object_model", "baselines", "ablations", "real_pushing"),
    "maps": ("navigation", "lifelong"),
    "scenarios": ("navigation", "lifelong"),
    "policies": ("navigation", "lifelong", "pushing"),
    "pushes": ("all",),
    "runs": ("faults",),
    "only": ("faults",),
    "minutes": ("soak",),
    "buildings": ("soak",),
}
"""Options that only some experiments take, and these experiments. ``all`` also takes those of what it runs."""


@cache
def experiment_named(name: str) -> Experiment[Any]:
    """The experiment of this name.

    Raises:
        ShmooError: there is no experiment of this name.
    """
    modules = EXPERIMENTS | RELIABILITY
    if name not in modules:
        raise ShmooError(f"experiment {name!r} is not known; choose one of {', '.join(modules)}.")
    experiment: Experiment[Any] = import_module(modules[name]).EXPERIMENT
    return experiment


def check_options(name: str, given: Iterable[str]) -> None:
    """Check that the experiment, or ``all``, takes the ``given`` ones of `OPTIONS`.

    Raises:
        ShmooError: it does not take one of them.
    """
    for option in given:
        users = OPTIONS[option]
        if name not in users and not (name == "all" and set(users) & set(EXPERIMENTS)):
            raise ShmooError(f"--{option} is for shmoo experiment {' or '.join(users)} alone; leave it out.")


@single_precision
def run_experiment(name: str, options: ExperimentOptions, config: Any = None) -> ExperimentResult:
    """Run one experiment in its folder below ``options.out``, or resume it there.

    ``config`` replaces the experiment's own config, its short form and the options that adjust it.
    """
    experiment = experiment_named(name)
    with claimed(options.out / name):
        return run(name, experiment, options, config)
