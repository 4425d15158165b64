"""The demo: one generated scenario per seed, each with its own folder, and a summary of the outcomes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from shmoo_mjx.base.options import SensesName
from shmoo_mjx.planning.floorplan import SCENES
from shmoo_mjx.report.words import evidence, object_name


def run_demo(
    seeds: Sequence[int],
    out: Path,
    weights: Path | None = None,
    *,
    video: bool = True,
    senses: SensesName = "real",
    scene: str = "generated",
    method: str = "ours",
    settings: Sequence[str] = (),
) -> int:
    """Runs the demo for each seed, each in its own folder ``out / demo-SEED``.

    It prints the outcome and decisions of each run, the success rate, and the path of the last report.

    Args:
        seeds: seeds of the scenes.
        out: folder of the runs' folders.
        weights: trained weights; those of the method if not given.
        video: whether to render videos.
        senses: sensing, "real" or "perfect".
        scene: one of `SCENES`. The folders of scenes other than "generated" are called SCENE-SEED.
        method: a method of `shmoo_mjx.behavior.methods`. The folders of methods other than "ours" are called
            SCENE-SEED-METHOD.
        settings: replace settings of the method (`shmoo_mjx.behavior.settings`).

    Returns:
        0 if all runs succeeded, 1 otherwise.
    """
    from shmoo_mjx.base import progress
    from shmoo_mjx.run.scenario_run import run_scenario

    results: list[dict[str, Any]] = []
    prefix = "demo" if scene == "generated" else scene
    folders = [out / f"{prefix}-{seed}{'' if method == 'ours' else f'-{method}'}" for seed in seeds]
    for seed, folder in zip(seeds, folders, strict=True):
        grid, scenario = SCENES[scene](seed)
        with progress.stages() as report:
            result = run_scenario(
                grid,
                scenario,
                folder,
                weights=weights,
                video=video,
                name=f"{prefix} seed {seed}",
                progress=report,
                senses=senses,
                method=method,
                settings=settings,
            )
        results.append(result)
        print(_line(seed, result), flush=True)
    good = sum(r["outcome"] == "success" for r in results)
    if len(seeds) > 1:
        print(f"success rate {good}/{len(seeds)}")
    print(f"report: {folders[-1] / 'report.html'}")
    return 0 if good == len(seeds) else 1


def _line(seed: int, result: dict[str, Any]) -> str:
    verdicts = {True: "can be moved", False: "can't be moved"}
    told = "; ".join(
        f"{object_name(result, d['object'])} at {d['t']:.0f} s: {verdicts[d['manipulable']]} ({evidence(d)})"
        for d in result["decisions"]
    )
    measured = f"{result['time_s']:.0f} s, {result['path_length_m']:.1f} m, wall contacts {result['wall_contacts']}"
    return f"seed {seed}: {result['outcome']} ({result['reason']}; {measured})\n  decisions: {told or 'none'}"
