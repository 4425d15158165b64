"""Eq. 4 for any predictor: open-loop roll-outs of the object, their loss, and scores on held-out objects."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from shmoo_mjx.arrays import Array, Float, Scalar
from shmoo_mjx.dynamics import features
from shmoo_mjx.geometry import se2
from shmoo_mjx.learning import least_squares
from shmoo_mjx.learning.samples import Samples
from shmoo_mjx.types import DT

Predict = Callable[[Float[Array, "... 13"]], Float[Array, "... 3"]]
"""A predictor adapted to one object: from inputs to accelerations in {O}."""

WHERE = features.slices(features.OBJECT_INPUTS)
"""Slice of each entry of OBJECT_INPUTS, by name."""


def open_loop(predict: Predict, inputs: Float[Array, "B H 13"]) -> tuple[Float[Array, "B H 3"], Float[Array, "B H 3"]]:
    """Roll out the object's twist over H steps under the recorded wrench, feeding back the predicted twist (Eq. 4).

    Args:
        predict: predictor of the object.
        inputs: recorded inputs of B windows.

    Returns:
        Predicted accelerations in {O}, and the twist before each step in {O}.
    """

    def one(carry: tuple[Array, Array], x: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        twist, last = carry
        wrench, size, last_wrench = (x[..., WHERE[name]] for name in ("wrench", "size", "last_wrench"))
        acceleration = predict(
            features.object_inputs(twist, wrench, last_twist=last, size=size[..., 0], last_wrench=last_wrench)
        )
        turn = twist[..., 2] * DT + 0.5 * acceleration[..., 2] * DT**2
        following = se2.rotate(twist + acceleration * DT, -turn)
        return (following, twist), (acceleration, twist)

    start = (inputs[:, 0, WHERE["object_twist"]], inputs[:, 0, WHERE["last_object_twist"]])
    _, (accelerations, twists) = jax.lax.scan(one, start, jnp.swapaxes(inputs, 0, 1))
    return jnp.swapaxes(accelerations, 0, 1), jnp.swapaxes(twists, 0, 1)


def loss(
    predict: Predict,
    windows: tuple[Float[Array, "B H n"], Float[Array, "B H m"], Float[Array, "B H n"]],
    *,
    precision: Float[Array, "m m"],
    scale: Float[Array, "m"],
    feed_back: bool = True,
    one_step: float = 1.0,
    on_twist: bool = True,
) -> Scalar:
    """Eq. 4 on B windows of H steps of one condition: the fraction of the labels' variance left unexplained.

    Args:
        predict: predictor of the object, after adaptation.
        windows: inputs, labels, and the inputs one sample later.
        precision: inverse of Sigma_C in units of ``scale``.
        scale: scale of the labels.
        feed_back: feed back the predicted twist. If False, predict every step from the recorded twist.
        one_step: weight of the one-step error from recorded twists, added to the open-loop error.
        on_twist: compute the open-loop error on the twist after each step. If False, on the acceleration of each step.
    """
    x, y, following = windows

    def share(error: Array) -> Array:
        return jnp.mean(jnp.einsum("bha,ac,bhc->bh", error, precision, error)) / error.shape[-1]

    def forced() -> Array:
        return share((y - predict(x)) / scale)

    if not feed_back:
        return forced()
    predicted, twists = open_loop(predict, x)
    error = (y - predicted) / scale
    if on_twist:
        # With independent errors, the covariance of the twist after h steps is h times that of one step.
        steps = jnp.arange(1, x.shape[1] + 1)[:, None]
        drift = (following[:, :-1, WHERE["object_twist"]] - twists[:, 1:]) / (DT * scale)
        error = jnp.concatenate([drift, error[:, -1:] * steps[-1] ** 0.5], axis=1) / steps**0.5
    return share(error) + (one_step * forced() if one_step > 0 else 0.0)


def scores(
    samples: Samples,
    contacts: Any,
    adapted: Callable[[Float[Array, "N n"], Float[Array, "N m"], Float[Array, "N"], Any], Predict],
    *,
    scale: Float[Array, "m"],
    fit_samples: int,
    horizon: int,
    floor: float,
) -> tuple[Float[Array, "C"], Float[Array, "C"]]:
    """Scores of the predictions for each condition: adapt on its first samples, score on the later ones.

    Args:
        samples: C held-out conditions.
        contacts: contact parameters of each condition, a tree of ``[C, ...]``.
        adapted: function from (inputs, labels, weights, contact parameters) to the predictor of the object.
        scale: scale of the labels.
        fit_samples: number of samples for the adaptation, at most half of all samples.
        horizon: number of steps of the open-loop roll-out; 0 for none.
        floor: fraction of scale squared that is added to the variance of each label.

    Returns:
        The fraction of variance unexplained per condition, first of one-step accelerations, then of the change of
        twist over ``horizon`` steps. Without a roll-out the second equals the first.
    """
    extra = floor * jnp.asarray(scale) ** 2

    def one(rows: Samples, contact: Any) -> tuple[Scalar, Scalar]:
        x, y, w, run = rows
        n, h = x.shape[0], horizon
        first = min(fit_samples, n // 2)
        predict = adapted(x[:first], y[:first], w[:first], contact)
        one_step = least_squares.fraction_unexplained(predict(x[first:]), y[first:], w[first:], extra)
        if h == 0 or n - first <= h:
            return one_step, one_step
        starts = jnp.arange(first, n - h, max(1, h // 2))
        window = starts[:, None] + jnp.arange(h)
        rolled, _ = open_loop(predict, x[window])
        good = (run[starts] >= h) * jnp.mean(w[window], axis=1)
        change, truth = jnp.mean(rolled, axis=1), jnp.mean(y[window], axis=1)
        return one_step, least_squares.fraction_unexplained(change, truth, good, extra / h)

    one_step, rolled_out = jax.vmap(one)(samples, contacts)
    return jnp.asarray(one_step), jnp.asarray(rolled_out)
