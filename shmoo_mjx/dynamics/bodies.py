"""Trial bodies: how J rigid bodies with dry friction would answer the same push, as further inputs of psi's network.

Dry friction decides within a sample whether an object stops, sticks or slides, and the border between these depends on
mass and friction. No sum of a few smooth functions of twist and wrench can follow a border that moves with c. A sum
over trial bodies can: each has its own border, and a mixes their answers. What the bodies are like (mass, friction,
where the centre of mass lies) is learned with psi; what they answer is Newton's law with one implicit step of Coulomb
friction.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.dynamics import features
from shmoo_mjx.types import DT

__all__ = ["Bodies", "answers", "init"]

Array = Any


class Bodies(NamedTuple):
    """J trial bodies."""

    log_inverse_mass: Array
    """``[J, 3]`` for x, y [log 1/kg] and yaw (inertia over squared radius of gyration, so [log 1/kg] as well)."""
    log_metric: Array
    """``[J, 3]`` how much each component of the twist counts against the limit of friction; its mean is taken off."""
    log_friction: Array
    """``[J]`` deceleration by friction [log m/s^2]."""
    centre: Array
    """``[J, 2]`` centre of mass in {O}, over half the diagonal of the footprint [-]."""


def init(key: Array, count: int) -> Bodies:
    """``count`` bodies on a grid of masses and frictions, from rolling to rough."""
    mass, friction = np.meshgrid([3.0, 7.0, 15.0, 40.0], [0.3, 2.5, 4.0, 6.0])
    index = np.resize(np.arange(mass.size), count)
    mass_key, centre_key = jax.random.split(key)
    inverse = jnp.asarray(1.0 / mass.ravel()[index])[:, None] * jnp.array([1.0, 1.0, 0.75])
    return Bodies(
        jnp.log(inverse) + 0.1 * jax.random.normal(mass_key, (count, 3)),
        jnp.zeros((count, 3)),
        jnp.log(jnp.asarray(friction.ravel()[index], jnp.float32)),
        0.05 * jax.random.normal(centre_key, (count, 2)),
    )


def answers(bodies: Bodies, inputs: Array) -> Array:
    """Mean acceleration over the sample of each trial body under the inputs' wrench ``[3 J, ...]``.

    The x, y and yaw accelerations of all bodies in turn, in {O}; yaw times half of `size` so that all are in m/s^2.

    Args:
        bodies: J of them.
        inputs: ``[10, ...]`` as OBJECT_INPUTS lists them, channels first.
    """
    where = features.slices(features.OBJECT_INPUTS)
    vx, vy, spin = inputs[where["object_twist"]][:, None]
    fx, fy, torque = inputs[where["wrench"]][:, None]
    size = inputs[where["size"]]
    radius = jnp.maximum(0.5 * size, 0.05)

    def each(values: Array) -> Array:
        return values.reshape(-1, *(1,) * (inputs.ndim - 1))

    x, y = each(bodies.centre[:, 0]) * size, each(bodies.centre[:, 1]) * size
    inverse = jnp.exp(bodies.log_inverse_mass)
    metric = jnp.exp(bodies.log_metric - jnp.mean(bodies.log_metric, axis=1, keepdims=True))
    limit = each(DT * jnp.exp(bodies.log_friction))
    # Twist of the centre of mass after the push alone, then friction takes off at most `limit` of its length.
    before = (vx - spin * y, vy + spin * x, radius * spin)
    wrench = (fx, fy, (torque - (x * fy - y * fx)) / radius)
    free = [
        (v + DT * each(inverse[:, i]) * w) * each(metric[:, i])
        for i, (v, w) in enumerate(zip(before, wrench, strict=True))
    ]
    length = jnp.sqrt(free[0] ** 2 + free[1] ** 2 + free[2] ** 2 + 1e-5)
    left = jnp.maximum(1.0 - limit / length, 0.0)
    after = [u * left / each(metric[:, i]) for i, u in enumerate(free)]
    turned = after[2] / radius
    change = (after[0] + turned * y - vx, after[1] - turned * x - vy, after[2] - before[2])
    return jnp.concatenate(change) / DT
