"""The training loop of psi and R: epochs, early stopping, checkpoints and progress."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from shmoo_mjx.arrays import Scalar
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.learning.checkpoints import Checkpoints

Tree = Any


class Progress(NamedTuple):
    """Progress of a training after an epoch, the argument of progress callbacks."""

    epoch: int
    """Number of completed epochs."""
    epochs: int
    """Maximum number of epochs. Early stopping can end the training before."""
    train_loss: float
    """Mean training loss of the epoch."""
    validation: float
    """Score on the validation conditions; lower is better."""
    best: float
    """Best validation score so far."""


class Fitted(NamedTuple):
    """Result of a training."""

    best: Tree
    """Result of ``extract`` at the epoch with the best validation score."""
    score: float
    """Best validation score; lower is better."""
    history: list[tuple[float, float]]
    """(training loss, validation score) of each epoch."""


def bounded_gradient() -> optax.GradientTransformation:
    """Clip gradients to norm 1. A gradient that overflows, as in roll-outs of an untrained model, becomes zero."""
    return optax.chain(optax.clip_by_global_norm(1.0), optax.zero_nans())


def run(
    state: Tree,
    epoch: Callable[[Tree], tuple[Tree, Scalar]],
    *,
    extract: Callable[[Tree], Tree],
    evaluate: Callable[[Tree], Scalar],
    epochs: int,
    patience: int,
    identity: str = "",
    directory: str | Path | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Fitted:
    """Train until ``epochs`` are done or the validation score has not improved for ``patience`` epochs.

    Args:
        state: pytree of arrays with everything that the next epoch depends on, including random key data.
        epoch: one epoch of updates, from a state to (state, mean loss).
        extract: selects the parameters to keep from a state.
        evaluate: validation score of the result of ``extract``; lower is better.
        epochs: maximum number of epochs.
        patience: number of epochs without improvement before the training stops.
        identity: fingerprint of the training's code, config and data (`base.fingerprints`). A checkpoint with another
            identity is not used.
        directory: directory of the checkpoint, written after each epoch. An interrupted training resumes from it, with
            the same result as without the interruption.
        progress: called after each epoch.

    Raises:
        ShmooError: no epoch had a finite score.
    """
    # Python scalars give weakly typed arrays, but an epoch returns strongly typed ones. The conversion avoids a second
    # compilation.
    state = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=jnp.asarray(leaf).dtype), state)
    best = extract(state)
    score, history = float("inf"), list[tuple[float, float]]()
    with nullcontext() if directory is None else closing(Checkpoints(Path(directory), identity)) as kept:
        loaded = None if kept is None else kept.load({"state": state, "best": best})
        if loaded is not None:
            tree, notes = loaded
            state, best, score = tree["state"], tree["best"], notes["score"]
            history = [(float(a), float(b)) for a, b in notes["history"]]
        while len(history) < epochs and not _stale(history, patience):
            state, loss = epoch(state)
            candidate = extract(state)
            value = float(evaluate(candidate))
            if value < score:
                best, score = candidate, value
            history.append((float(loss), value))
            if kept is not None:
                kept.save(len(history), {"state": state, "best": best}, {"score": score, "history": history})
            if progress is not None:
                progress(Progress(len(history), epochs, float(loss), value, score))
    if not np.isfinite(score):
        raise ShmooError(
            f"training: none of {len(history)} epochs had a finite validation score; check the data for values that "
            "are not finite, or lower learning_rate or horizon."
        )
    return Fitted(jax.tree.map(np.asarray, best), score, history)


def _stale(history: list[tuple[float, float]], patience: int) -> bool:
    scores = [score if np.isfinite(score) else float("inf") for _, score in history]
    return len(scores) > patience and min(scores[-patience:]) >= min(scores[:-patience])
