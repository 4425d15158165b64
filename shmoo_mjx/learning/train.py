"""Training of one part of the model into a weights file: the function behind ``shmoo train``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from shmoo_mjx.base.files import claimed
from shmoo_mjx.base.versions import versions
from shmoo_mjx.data import store
from shmoo_mjx.dynamics.object_model import ObjectConfig
from shmoo_mjx.dynamics.robot_model import RobotConfig
from shmoo_mjx.learning import daiml, robot_fit, weights
from shmoo_mjx.learning.estimate import EstimateConfig
from shmoo_mjx.learning.training import Progress

_QUICK: dict[str, Any] = {"epochs": 3, "epoch_updates": 50}
_QUICK_OBJECT: dict[str, Any] = _QUICK | {"contact_fit": EstimateConfig(particles=128)}
Form = Literal["ours", "paper"]
"""Structure of the trained network: the default of this package, or the one printed in the paper."""
_QUICK_CONDITIONS = {"train": 12, "validation": 3}
"""Number of conditions of each split in a quick training."""


def train_part(
    what: Literal["object", "robot"],
    data: Path,
    out: Path,
    *,
    seed: int = 0,
    progress: Callable[[Progress], None] | None = None,
    quick: bool = False,
    form: Form = "ours",
) -> float:
    """Train psi or R with the default settings and write it to ``out``, keeping the other part of an existing file.

    The info of the file records the origin of the trained part under ``made_by`` (see `origin`). Checkpoints are in
    ``OUT.training/``; an interrupted training resumes from them.

    Args:
        what: "object" (psi, prior and noise, Eq. 4 to 6) or "robot" (R, Eq. 7).
        data: data set directory.
        out: weights file.
        seed: seed of the initial weights and of the batches.
        progress: called after each epoch.
        quick: train a few updates on a few conditions, to test the pipeline. The recorded command includes ``--quick``.
        form: structure of the network; "paper" trains `ObjectConfig.paper` or `RobotConfig.paper`.

    Returns:
        The score on the validation conditions; lower is better.
    """
    kept = out.with_name(f"{out.name}.training")
    # Each variant has its own checkpoint, so a quick training does not replace that of an interrupted full one.
    checkpoints = kept / "-".join([what, *([form] if form != "ours" else []), *(["quick"] if quick else [])])
    with claimed(kept):
        dataset = _few(store.read(data, splits=("train", "validation"))) if quick else data
        old = weights.load_weights(out) if out.exists() else None
        if what == "object":
            shape = ObjectConfig.paper() if form == "paper" else ObjectConfig()
            config = daiml.DaimlConfig(shape, seed=seed, **(_QUICK_OBJECT if quick else {}))
            fit = daiml.train_object(dataset, checkpoints, config, progress)
            new = weights.with_object(old or weights.untrained(), fit)
            score = float(fit.score)
        else:
            widths = RobotConfig.paper() if form == "paper" else RobotConfig()
            settings = robot_fit.RobotFitConfig(widths, seed=seed, **(_QUICK if quick else {}))
            robot = robot_fit.train_robot(dataset, checkpoints, settings, progress=progress)
            new = weights.with_robot(old or weights.untrained(), robot, settings.robot)
            score = float(robot.score)
        made_by = new.info.get("made_by", {}) | {what: origin(what, data, seed, score=score, quick=quick, form=form)}
        weights.save_weights(out, new._replace(info=new.info | {"made_by": made_by}))
        return score


def origin(
    what: str, data: Path, seed: int, *, score: float, quick: bool = False, form: Form = "ours"
) -> dict[str, Any]:
    """Origin of a trained part: command, data set, seed, versions and score. It does not depend on file locations.

    Args:
        what: "object" or "robot".
        data: data set directory.
        seed: seed of the training.
        score: score on the validation conditions.
        quick: True for a quick training, whose weights are only for tests of the pipeline.
        form: structure of the network.
    """
    manifest = store.read_manifest(data)
    shape = "" if form == "ours" else f" --form {form}"
    collected = {"collected_with": manifest["schema"], "versions": manifest["versions"]}
    return {
        "command": f"shmoo train {what} DATA --seed {seed}{shape}" + (" --quick" if quick else ""),
        "data": {"sha256": store.fingerprint_of(data), "conditions": len(manifest["conditions"]), **collected},
        "seed": seed,
        "score": score,
        "versions": versions(),
    }


def _few(dataset: store.Dataset) -> store.Dataset:
    """Some conditions of each split, evenly spaced. Names begin with the family, so every family is included."""
    chosen: list[int] = []
    for split, most in _QUICK_CONDITIONS.items():
        places = [i for i, condition in enumerate(dataset.conditions) if condition["split"] == split]
        chosen += places[:: -(-len(places) // most) or 1]
    return dataset.chosen(chosen)
