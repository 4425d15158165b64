"""Eq. 4 without its loss: the object's open-loop roll-out under the recorded wrench, and scores on unseen objects."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from shmoo_mjx import se2
from shmoo_mjx.dynamics import features, object_model
from shmoo_mjx.dynamics.object_model import ObjectConfig, ObjectParams
from shmoo_mjx.learning import least_squares
from shmoo_mjx.learning.rows import Rows
from shmoo_mjx.types import DT

__all__ = ["open_loop", "scores"]

Array = Any


def open_loop(
    params: ObjectParams, a: Array, inputs: Array, config: ObjectConfig, body: Array, feed_back: bool = True
) -> tuple[Array, Array]:
    """Roll the object's twist out over H steps under the recorded wrench (Eq. 4).

    Args:
        params: psi.
        a: ``[3, K]``.
        inputs: ``[B, H, 13]`` recorded inputs of B windows.
        config: of psi.
        body: ``[p]`` of `feet.PARAMETERS`.
        feed_back: feed the predicted twist back; False predicts every step from the recorded one.

    Returns:
        Predicted accelerations ``[B, H, 3]`` in {O} and the twists before each step ``[B, H, 3]`` in {O}.
    """
    where = features.slices(features.OBJECT_INPUTS)
    if not feed_back:
        return object_model.predict(params, a, inputs, config, body), inputs[..., where["object_twist"]]

    def one(carry: tuple[Array, Array], x: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        twist, last = carry
        wrench, size, last_wrench = (x[..., where[name]] for name in ("wrench", "size", "last_wrench"))
        x = features.object_inputs(twist, wrench, last, size[..., 0], last_wrench)
        acceleration = object_model.predict(params, a, x, config, body)
        turn = twist[..., 2] * DT + 0.5 * acceleration[..., 2] * DT**2
        following = se2.rotate(twist + acceleration * DT, -turn)
        return (following, twist), (acceleration, twist)

    start = (inputs[:, 0, where["object_twist"]], inputs[:, 0, where["last_object_twist"]])
    _, (accelerations, twists) = jax.lax.scan(one, start, jnp.swapaxes(inputs, 0, 1))
    return jnp.swapaxes(accelerations, 0, 1), jnp.swapaxes(twists, 0, 1)


def scores(
    rows: Rows,
    bodies: Array,
    params: ObjectParams,
    config: ObjectConfig,
    fit_one: Callable[[Array, Array, Array, Array], Array],
    fit_rows: int,
    horizon: int,
    floor: float,
) -> tuple[Array, Array]:
    """Fit each condition's coefficients on its first rows and score them on the later ones only.

    Args:
        rows: C conditions that psi was not trained on.
        bodies: ``[C, p]`` identified on the same first rows.
        params: psi.
        config: of psi.
        fit_one: (inputs, labels, weights) of some rows, body -> a ``[m, K]``.
        fit_rows: how many rows a is fitted on, at most half of them.
        horizon: steps of the open-loop roll-out; 0 leaves it out.
        floor: share of label_scale squared added to each label's variance.

    Returns:
        Fraction of variance unexplained per condition ``[C]`` of one-step accelerations; and of the twist's change
        after ``horizon`` steps (the one-step share again without a roll-out).
    """

    def one(x: Array, y: Array, w: Array, run: Array, body: Array) -> tuple[Array, Array]:
        n, h = x.shape[0], horizon
        first = min(fit_rows, n // 2)
        a = fit_one(x[:first], y[:first], w[:first], body)
        predicted = object_model.predict(params, a, x[first:], config, body)
        extra = floor * params.label_scale**2
        one_step = least_squares.fraction_unexplained(predicted, y[first:], w[first:], extra)
        if h == 0 or n - first <= h:
            return one_step, one_step
        starts = jnp.arange(first, n - h, max(1, h // 2))
        window = starts[:, None] + jnp.arange(h)
        rolled, _ = open_loop(params, a, x[window], config, body)
        good = (run[starts] >= h) * jnp.mean(w[window], axis=1)
        change, truth = jnp.mean(rolled, axis=1), jnp.mean(y[window], axis=1)
        return one_step, least_squares.fraction_unexplained(change, truth, good, extra / h)

    return jax.vmap(one)(*rows, bodies)
