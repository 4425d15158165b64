"""Training of one part of the model into a weights file, as ``shmoo train`` runs it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from shmoo_mjx.files import claimed
from shmoo_mjx.learning import daiml, robot_fit, weights
from shmoo_mjx.learning.training import Progress

__all__ = ["train_part"]


def train_part(
    what: Literal["object", "robot"],
    data: Path,
    out: Path,
    seed: int = 0,
    progress: Callable[[Progress], None] | None = None,
) -> float:
    """Train psi or R with the default settings and write it into ``out``, keeping that file's other part.

    Checkpoints go to ``OUT.training/``; a training that was stopped goes on from there.

    Args:
        what: "object" (psi, prior and noise, Eq. 4 to 6) or "robot" (R, Eq. 7).
        data: data set directory.
        out: weights file.
        seed: of initialisation and batches.
        progress: called after each epoch of training.

    Returns:
        The score on the validation conditions.
    """
    kept = out.with_name(f"{out.name}.training")
    checkpoints = kept / what
    with claimed(kept):
        old = weights.load_weights(out) if out.exists() else None
        if what == "object":
            config = daiml.DaimlConfig(seed=seed)
            fit = daiml.train_object(data, checkpoints, config, progress)
            new = weights.with_object(old or weights.untrained(), fit)
            score = float(fit.score)
        else:
            settings = robot_fit.RobotFitConfig(seed=seed)
            robot = robot_fit.train_robot(data, checkpoints, settings, progress)
            new = weights.with_robot(old or weights.untrained(), robot, settings.robot)
            score = float(robot.score)
        weights.save_weights(out, new)
        return score
