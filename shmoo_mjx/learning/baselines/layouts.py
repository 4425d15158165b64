"""Other inputs for psi, to see what each brings: fewer, more of the past, or told in the world's frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from shmoo_mjx import se2
from shmoo_mjx.dynamics import features
from shmoo_mjx.learning.baselines.protocol import Context, Predictor, Recordings
from shmoo_mjx.learning.rows import Rows

__all__ = ["LAYOUTS", "from_world", "in_world"]

Array = Any


def chosen(rows: Rows, *names: str) -> Rows:
    """Only the named inputs of psi."""
    where = features.slices(features.OBJECT_INPUTS)
    return rows._replace(inputs=np.concatenate([rows.inputs[..., where[name]] for name in names], axis=-1))


def with_past(rows: Rows, samples: int) -> Rows:
    """The inputs of psi, and twist and wrench up to so many samples ago; zeros before an episode's start."""
    where = features.slices(features.OBJECT_INPUTS)
    moving = np.concatenate([rows.inputs[..., where[name]] for name in ("object_twist", "wrench")], axis=-1)
    parts = [rows.inputs, *(_before(moving, rows.run, lag) for lag in range(2, samples + 1))]
    return rows._replace(inputs=np.concatenate(parts, axis=-1))


LAYOUTS: dict[str, Callable[[Rows], Rows]] = {
    "twist_wrench": lambda rows: chosen(rows, "object_twist", "wrench"),
    "no_past": lambda rows: chosen(rows, "object_twist", "wrench", "size"),
    "last_twist": lambda rows: chosen(rows, "object_twist", "wrench", "last_object_twist", "size"),
    "default": lambda rows: rows,
    "past_2": lambda rows: with_past(rows, 2),
    "past_3": lambda rows: with_past(rows, 3),
    "past_6": lambda rows: with_past(rows, 6),
}
"""Layouts in {O} by name."""


def in_world(recorded: Recordings) -> Recordings:
    """Twists, wrench and labels turned into {W}, and the yaw's cosine and sine as two more inputs."""
    yaw, rows = recorded.pose[..., 2], recorded.rows
    inputs = np.array(rows.inputs)
    for entry, where in zip(features.OBJECT_INPUTS, features.slices(features.OBJECT_INPUTS).values(), strict=True):
        if entry.width == 3:
            inputs[..., where] = se2.rotate(inputs[..., where], yaw)
    inputs = np.concatenate([inputs, np.cos(yaw)[..., None], np.sin(yaw)[..., None]], axis=-1)
    return recorded._replace(rows=rows._replace(inputs=inputs, labels=se2.rotate(rows.labels, yaw)))


def from_world(predictor: Predictor) -> Predictor:
    """What was trained `in_world`, for labels and predictions in {O}; its inputs stay those in {W}."""

    def yaw_of(x: Array) -> Array:
        return jnp.arctan2(x[..., -1], x[..., -2])

    def adapt(context: Context) -> Any:
        return predictor.adapt(context._replace(labels=se2.rotate(context.labels, yaw_of(context.inputs))))

    def predict(state: Any, x: Array, time: Array) -> Array:
        return se2.rotate(predictor.predict(state, x, time), -yaw_of(x))

    return Predictor(adapt, predict)


def _before(values: np.ndarray, run: np.ndarray, lag: int) -> np.ndarray:
    """``values [C, N, f]`` of the row ``lag`` earlier; zeros where that is of another episode."""
    moved, then = np.zeros_like(values), np.zeros_like(run)
    moved[:, lag:], then[:, lag:] = values[:, :-lag], run[:, :-lag]
    return moved * (then == run + lag)[..., None]
