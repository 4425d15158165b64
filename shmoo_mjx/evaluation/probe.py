"""Measures how well a fresh network can read the condition from one sample of psi (Eq. 6).

The adversary's loss in training is no such measure, because the adversary may be weak. The probe is trained on the
final psi and tested on later rows.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from shmoo_mjx.arrays import Array
from shmoo_mjx.dynamics import features, object_model
from shmoo_mjx.dynamics.networks import MLP
from shmoo_mjx.learning import daiml
from shmoo_mjx.learning.daiml import DaimlConfig, ObjectFit
from shmoo_mjx.learning.samples import Samples

HIDDEN = (64, 64)
BATCH = 1024
TRAINING_SHARE = 0.6
"""Share of each condition's rows, from the start, that the probe is trained on."""


def accuracy(values: Array, weights: Array, seed: int, updates: int = 1500) -> float:
    """Share of later rows whose condition a fresh probe identifies, mean over conditions. Chance is 1 / C.

    The probe is trained by Adam on batches of 1024 rows. It sees ``values [C, N, f]`` of each row; rows with 0 among
    ``weights [C, N]`` are left out.
    """
    values, weights = np.asarray(values, np.float32), np.asarray(weights) > 0
    early = np.cumsum(weights, axis=1) <= TRAINING_SHARE * weights.sum(axis=1, keepdims=True)
    train, test = np.nonzero(weights & early), np.nonzero(weights & ~early)
    used = values[train]
    values = (values - used.mean(axis=0)) / np.maximum(used.std(axis=0), 1e-6)
    probe, keys = MLP((*HIDDEN, len(values)), "relu"), (jax.random.key(seed), jax.random.key(seed + 1))
    start = probe.init(keys[0], values[0, 0])
    fitted = _fit(probe, start, jnp.asarray(values[train]), jnp.asarray(train[0]), key=keys[1], updates=updates)
    right = np.argmax(np.asarray(probe.apply(fitted, values[test])), axis=-1) == test[0]
    return float(np.mean([right[test[0] == c].mean() for c in np.unique(test[0])]))


def psi_of(fitted: ObjectFit, config: DaimlConfig, rows: Samples) -> Array:
    """psi ``[C, N, n]`` of every row, its distinct functions side by side.

    The inputs of psi depend on the contact parameters estimated from a condition's first rows, which by itself
    distinguishes conditions.
    """
    params = jax.tree.map(jnp.asarray, fitted.params)
    contacts = daiml.contacts_seen(config, fitted, rows)
    see = jax.jit(jax.vmap(lambda x, contact: object_model.basis(params, x, config.object, contact)))
    psi = see(jnp.asarray(rows.inputs), contacts)
    return psi.reshape(*psi.shape[:-2], -1) if config.object.per_axis else psi[..., 0, :]


def raw_without_size(rows: Samples) -> Array:
    """The inputs of psi without the size, which is constant in a condition and would identify it."""
    where = features.slices(features.OBJECT_INPUTS)["size"]
    return np.delete(np.asarray(rows.inputs), np.arange(where.start, where.stop), axis=-1)


@partial(jax.jit, static_argnames=("probe", "updates"))
def _fit(probe: MLP, start: Any, values: Array, condition: Array, *, key: Array, updates: int) -> Any:
    optimiser = optax.adam(optax.cosine_decay_schedule(3e-3, updates))

    def loss(params: Any, rows: Array) -> Array:
        logits: Any = probe.apply(params, values[rows])
        return jnp.mean(optax.softmax_cross_entropy_with_integer_labels(logits, condition[rows]))

    def update(carry: tuple[Any, Any], key: Array) -> tuple[tuple[Any, Any], None]:
        params, state = carry
        gradient = jax.grad(loss)(params, jax.random.randint(key, (BATCH,), 0, values.shape[0]))
        change, state = optimiser.update(gradient, state)
        return (optax.apply_updates(params, change), state), None

    return jax.lax.scan(update, (start, optimiser.init(start)), jax.random.split(key, updates))[0][0]
