"""Runs all experiments and writes the page of their results."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from shmoo_mjx.base.guard import EXPERIMENT, check_output
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.evaluation import page
from shmoo_mjx.evaluation.registry import EXPERIMENTS, run_experiment
from shmoo_mjx.evaluation.result import ExperimentOptions, write_result


def run_all(options: ExperimentOptions, pushes: Path | None) -> tuple[Path, dict[str, str]]:
    """Run every experiment and write its JSON into ``options.out``. The page is rewritten after each experiment.

    An experiment without its inputs (maps, the folder ``pushes`` of recorded pushes) is skipped.

    Returns:
        The page, and the reason for each experiment that was skipped.
    """
    target, left_out = options.out / "results.md", dict[str, str]()
    done = dict[str, page.ExperimentResult]()
    for name in EXPERIMENTS:
        check_output(options.out / f"{name}.json", EXPERIMENT)
    for i, name in enumerate(EXPERIMENTS):

        def report(stage: str, fraction: float, name: str = name, i: int = i) -> None:
            options.progress(f"{name}: {stage}", (i + fraction) / len(EXPERIMENTS))

        own = replace(options, progress=report, data=pushes if name == "real_pushing" else options.data)
        # The names of pushing controllers differ from those of navigation policies.
        own = replace(own, policies=() if name == "pushing" else options.policies)
        try:
            done[name] = run_experiment(name, own)
        except ShmooError as error:
            left_out[name] = str(error)
            continue
        write_result(options.out / f"{name}.json", done[name])
        page.write_page(done, options.out, target)
    if not done:
        raise ShmooError("experiment all: nothing could be run. " + " ".join(left_out.values()))
    return target, left_out
