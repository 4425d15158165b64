"""The loop that the object's and the robot's training share: epochs, early stopping, checkpoints, progress."""

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
    """Argument of progress callbacks after each epoch."""

    epoch: int
    """Epochs done so far."""
    epochs: int
    """Epochs planned; early stopping may end before."""
    train_loss: float
    validation: float
    """Score on the validation conditions; lower is better."""
    best: float
    """Best score so far."""


class Fitted(NamedTuple):
    """Result of a training."""

    best: Tree
    """What `extract` gave at the epoch with the best validation score."""
    score: float
    history: list[tuple[float, float]]
    """(training loss, validation score) of each epoch."""


def bounded_gradient() -> optax.GradientTransformation:
    """Gradients of norm 1 at most; one that has overflowed, as through the roll-outs of an untrained model, as none."""
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
    """Train until ``epochs`` are done or the validation score has not improved for ``patience`` of them.

    Args:
        state: pytree of arrays, all that the next epoch depends on, random key data included.
        epoch: one epoch of updates, state -> (state, mean loss).
        extract: the parameters in a state that are worth keeping.
        evaluate: validation score of what ``extract`` gave; lower is better.
        epochs: most epochs.
        patience: epochs without improvement before stopping.
        identity: what decides about the training (`base.fingerprints`): its code, config and data. A checkpoint of
            another one is not continued.
        directory: where the state is kept after each epoch; a training that was cut short goes on from it and gives
            what it would have given.
        progress: called after each epoch.

    Raises:
        ShmooError: no epoch had a finite score, so nothing has been learned.
    """
    # Python scalars leave weakly typed arrays, which an epoch returns strongly typed: without this it compiles twice.
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
