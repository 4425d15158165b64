"""Scores of predictors of an object's motion, which adapt on the first 25 s and are scored on later rows.

Every score is that of one condition. Experiments average over conditions, so that each object has the same weight.

* mse_x, mse_y, mse_yaw: mean squared error of the one-step acceleration in {O} [(m/s^2)^2, (rad/s^2)^2]; mse is their
  mean, the paper's measure.
* fvu: fraction of variance unexplained. Errors and labels are divided by each axis' standard deviation over the
  training set; the squared errors of all axes over the squared deviations from the condition's own mean. The
  variance has no floor, so the score of an object that hardly moves can be large.
* pos_rmse_1s_m, yaw_rmse_1s_deg and the same at 3 s: the pose is integrated open loop under the recorded wrench, from
  every fifth of the later rows that has the whole stretch before it in the same episode and half of it in contact;
  root of the mean squared error at the end.

A prediction or roll-out that diverges has an infinite error.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, single_precision
from shmoo_mjx.dynamics import features
from shmoo_mjx.evaluation.baselines.protocol import Predictor, Recordings, first_samples
from shmoo_mjx.geometry import se2
from shmoo_mjx.types import DT

FIT_SAMPLES = 250
"""Rows to adapt on: 25 s of recording, with or without contact."""

HORIZONS = {"1s": 10, "3s": 30}
"""Horizon name to steps of the open-loop roll-outs."""

_ENDS = tuple(name for h in HORIZONS for name in (f"pos_rmse_{h}_m", f"yaw_rmse_{h}_deg"))

NAMES = ("mse", "mse_x", "mse_y", "mse_yaw", "fvu", *_ENDS)
"""Scores of a condition."""

STRIDE = 5
"""Rows between the starts of two roll-outs."""


@single_precision
def score(
    predictor: Predictor,
    recorded: Recordings,
    scale: Array,
    fit_samples: int = FIT_SAMPLES,
    *,
    from_sample: int | None = None,
    roll_outs: bool = True,
) -> dict[str, np.ndarray]:
    """Adapt to each condition on its first rows and score later rows.

    Args:
        predictor: a fitted method.
        recorded: C conditions that the method was not trained on.
        scale: ``[m]`` standard deviation of the labels over the training set.
        fit_samples: rows to adapt on.
        from_sample: first row that is scored; by default the one after ``fit_samples``.
        roll_outs: measure open-loop roll-outs too, which needs the inputs that OBJECT_INPUTS lists.

    Returns:
        NAMES -> ``[C]`` (those of one step only without roll_outs); NaN where a condition has no stretch long enough
        for a roll-out.
    """
    first = fit_samples if from_sample is None else from_sample
    count = len(recorded.samples.inputs)
    states = [predictor.adapt(jax.tree.map(jnp.asarray, first_samples(recorded, i, fit_samples))) for i in range(count)]
    state = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *states)

    @jax.jit
    def measure(state: Any, recorded: Recordings) -> dict[str, Array]:
        one = jax.vmap(lambda s, r: _one_step(predictor, s, r, scale=scale, first=first))(state, recorded)
        return one | jax.vmap(lambda s, r: _ends(predictor, s, r, first))(state, recorded) if roll_outs else one

    measures = measure(state, jax.tree.map(jnp.asarray, recorded))
    return {name: np.asarray(measures[name], float) for name in NAMES if name in measures}


def roll_out(predictor: Predictor, state: Any, inputs: Array, time: Array) -> Array:
    """Roll out the object's motion open loop under the recorded wrench, starting with the twist of the first row.

    Predicted twists replace the recorded twists among the inputs. All other inputs are as recorded.

    Args:
        predictor: a fitted method.
        state: from ``predictor.adapt``.
        inputs: ``[H, n]`` recorded.
        time: ``[H]`` [s].

    Returns:
        ``[H + 1, 3]`` poses in {O} of the first row, yaw not wrapped.
    """
    memory = _twist_slices()

    def step(carry: tuple[Any, Any], row: tuple[Any, Any]) -> tuple[tuple[Any, Any], Any]:
        pose, twists = carry
        x, t = row
        for where, twist in zip(memory, twists, strict=True):
            x = x.at[where].set(twist)
        twist, a = twists[0], predictor.predict(state, x, t)
        move = twist * DT + 0.5 * a * DT**2
        following = se2.rotate(twist + a * DT, -move[2])
        pose = pose + se2.rotate(move, pose[2])
        return (pose, jnp.concatenate([following[None], twists[:-1]])), pose

    start = jnp.stack([inputs[0, where] for where in memory])
    _, poses = jax.lax.scan(step, (jnp.zeros(3), start), (inputs, time))
    return jnp.concatenate([jnp.zeros((1, 3)), poses])


def average(scores: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Mean of each score over the conditions."""
    return {name: float(np.nanmean(values)) for name, values in scores.items()}


def stretches(run: Array, weights: Array, first: int, steps: int) -> tuple[np.ndarray, Array]:
    """First rows ``[M]`` of a condition's roll-outs of ``steps`` rows, and which of them count ``[M]``.

    All begin at row ``first`` or later. A roll-out counts if it ends within the episode and at least half of its rows
    count. ``run [N]`` is the number of rows left in the episode.
    """
    starts = np.arange(first, run.shape[0] - steps, STRIDE)
    window = starts[:, None] + np.arange(steps)
    return starts, (run[starts] > steps) & (weights[window].mean(axis=1) >= 0.5)


def _one_step(predictor: Predictor, state: Any, recorded: Recordings, *, scale: Array, first: int) -> dict[str, Array]:
    x, y, w, _ = (v[first:] for v in recorded.samples)
    weight = w[:, None]
    count = jnp.maximum(jnp.sum(w), 1.0)
    square = (predictor.predict(state, x, recorded.time[first:]) - y) ** 2
    square = jnp.where(weight > 0, _no_number_is_infinite(square), 0.0)
    per_axis = jnp.sum(weight * square, axis=0) / count
    spread = jnp.sum(weight * (y - jnp.sum(weight * y, axis=0) / count) ** 2, axis=0) / count
    by_axis: dict[str, Array] = {f"mse_{axis}": per_axis[i] for i, axis in enumerate(("x", "y", "yaw"))}
    return by_axis | {"mse": jnp.mean(per_axis), "fvu": jnp.sum(per_axis / scale**2) / jnp.sum(spread / scale**2)}


def _ends(predictor: Predictor, state: Any, recorded: Recordings, first: int) -> dict[str, Array]:
    rows, ends_by_horizon = recorded.samples, dict[str, Array]()
    for name, h in HORIZONS.items():
        starts, good = stretches(rows.run, rows.weights, first, h)
        window = starts[:, None] + np.arange(h)
        ends = jax.vmap(lambda x, t: roll_out(predictor, state, x, t)[-1])(rows.inputs[window], recorded.time[window])
        truth = se2.relative(recorded.pose[starts], recorded.pose[starts + h])
        error = jnp.where(good[:, None], ends - truth, 0.0)
        turn = jnp.where(good, se2.wrap(error[:, 2]), 0.0)
        mean = jnp.stack([jnp.sum(error[:, :2] ** 2), jnp.sum(turn**2)])
        mean = jnp.where(jnp.any(good), _no_number_is_infinite(mean), jnp.nan) / jnp.sum(good)
        errors = {f"pos_rmse_{name}_m": jnp.sqrt(mean[0]), f"yaw_rmse_{name}_deg": jnp.rad2deg(jnp.sqrt(mean[1]))}
        ends_by_horizon |= errors
    return ends_by_horizon


def _no_number_is_infinite(values: Array) -> Array:
    return jnp.where(jnp.isfinite(values), values, jnp.inf)


def _twist_slices() -> list[slice]:
    """Slices of psi's inputs that hold twists of the object, newest first."""
    return [where for name, where in features.slices(features.OBJECT_INPUTS).items() if "object_twist" in name]
