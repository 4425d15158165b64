"""Contact parameters of the training conditions, estimated once for each data set.

On the robot, psi uses the current estimate of the contact parameters, which can be poor or good. The training therefore
uses estimates of different quality: for each condition, estimates from short and long stretches of its recording.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float, single_precision
from shmoo_mjx.base.fingerprints import fingerprint
from shmoo_mjx.dynamics import contact_model
from shmoo_mjx.learning import contact_prior, estimate, serialisation
from shmoo_mjx.learning.estimate import EstimateConfig
from shmoo_mjx.learning.samples import Samples, label_scale

STRETCHES = (0, 10, 10, 30, 30, 100, 100, 250)
"""Lengths of the S stretches from which the parameters of a training condition are estimated [samples]; 0 gives the
estimate before contact."""

_KEYS = 581
"""Seed of the estimates for training conditions. Validation conditions use the next integer."""

Contacts = tuple[Float[Array, "M p"], Float[Array, "C S p"], Float[Array, "C_validation p"]]
"""Draws from the prior, parameters of training conditions, and parameters of validation conditions."""


def estimated(
    config: EstimateConfig,
    train: Samples,
    validation: Samples,
    *,
    fit_samples: int,
    out_dir: str | Path | None = None,
) -> Contacts:
    """Contact parameters of all conditions, read from the cache in the parent of ``out_dir`` or else estimated.

    Args:
        config: settings of the estimate.
        train: C training conditions.
        validation: C' validation conditions.
        fit_samples: number of first samples of a validation condition to use, at most half of them.
        out_dir: checkpoint directory of the training; None for no cache.
    """
    measured = (train.inputs, train.labels, validation.inputs, validation.labels)
    identity = fingerprint(__name__, (config, fit_samples), *measured)
    path = None if out_dir is None else Path(out_dir).parent / f"contacts-{identity[:10]}.safetensors"
    if path is not None and path.is_file() and serialisation.read_notes(path).get("identity") == identity:
        return _single(serialisation.load_tree(path, zeros(train, validation))[0])
    scale, prior = label_scale(train), contact_prior.draws()
    contacts = from_stretches(config, prior, scale, samples=train, lengths=STRETCHES)
    of_all = _single((prior, contacts, on_first_samples(config, prior, scale, validation, fit_samples=fit_samples)))
    if path is not None:
        serialisation.save_tree(path, of_all, {"identity": identity})
    return of_all


def zeros(train: Samples, validation: Samples) -> Contacts:
    """Zeros in the shapes of `estimated`, for a psi without the contact model."""
    p, counts = len(contact_model.PARAMETERS), [samples.inputs.shape[0] for samples in (train, validation)]
    shapes = (contact_prior.COUNT, p), (counts[0], len(STRETCHES), p), (counts[1], p)
    return _single(tuple(np.zeros(shape) for shape in shapes))


@single_precision
def from_stretches(
    config: EstimateConfig,
    prior: Float[Array, "M p"],
    scale: Float[Array, "3"],
    *,
    samples: Samples,
    lengths: tuple[int, ...],
) -> Float[Array, "C S p"]:
    """Contact parameters of each condition, estimated from stretches at random places of its recording.

    Args:
        config: settings of the estimate; static.
        prior: draws from the prior.
        scale: standard deviation of the labels.
        samples: samples of C conditions.
        lengths: S numbers of samples that count; 0 gives the estimate before contact.
    """
    rows = tuple(jnp.asarray(a) for a in samples[:3])
    count, total = rows[2].shape
    starts = np.random.default_rng(0).integers(0, total, (count, len(lengths)))
    longest = min(2 * max(*lengths, 1), total)
    after = partial(estimate.after_rows, config, jnp.asarray(prior), jnp.asarray(scale))
    keys = jax.random.split(jax.random.key(_KEYS), (len(lengths), count))

    @partial(jax.jit, static_argnums=0)
    def all_of(length: int, keys: Array, starts: Array, rows: Any) -> Array:
        def one(condition: tuple[Array, Array, Any]) -> Array:
            key, start, (inputs, labels, weights) = condition
            at = (start + jnp.arange(longest)) % total
            # Select only the samples that count, in order, because most stretches are short.
            at = at[jnp.argsort(weights[at] == 0, stable=True)[: max(length, 1)]]
            own = inputs[at], labels[at], weights[at] * (length > 0)
            return estimate.mean(after(own, key=key))

        return jax.lax.map(one, (keys, starts, rows))

    return jnp.stack([all_of(n, keys[i], jnp.asarray(starts[:, i]), rows) for i, n in enumerate(lengths)], axis=1)


def on_first_samples(
    config: EstimateConfig, prior: Float[Array, "M p"], scale: Float[Array, "3"], samples: Samples, *, fit_samples: int
) -> Float[Array, "C p"]:
    """Contact parameters of each condition, estimated from its first samples.

    Args:
        config: settings of the estimate; static.
        prior: draws from the prior.
        scale: standard deviation of the labels.
        samples: samples of C conditions.
        fit_samples: number of first samples to use, at most half of all samples.
    """
    n = min(fit_samples, samples.inputs.shape[1] // 2)
    after = partial(estimate.after_rows, config, jnp.asarray(prior), jnp.asarray(scale))
    first = tuple(jnp.asarray(a[:, :n]) for a in samples[:3])
    keys = jax.random.split(jax.random.key(_KEYS + 1), len(first[0]))
    return jax.jit(lambda rows: jax.lax.map(lambda row: estimate.mean(after(row[0], key=row[1])), rows))((first, keys))


def _single(tree: Any) -> Any:
    return jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), tree)
