"""Contact parameters of the conditions of a training, identified once for each data set.

psi works with parameters that a robot has identified online. So in training it meets some that are known badly and
well: each training condition's are identified on short and long stretches of its recording.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.dynamics import contact_model
from shmoo_mjx.fingerprints import fingerprint
from shmoo_mjx.learning import identification, serialisation
from shmoo_mjx.learning.identification import ContactPrior, IdentificationConfig
from shmoo_mjx.learning.samples import Samples, label_scale

STRETCHES = (0, 10, 10, 30, 30, 100, 100, 250)
"""Samples that a training condition's parameters are identified on, M numbers; 0 is the object not yet touched."""

Found = tuple[ContactPrior, Float[Array, "C M p"], Float[Array, "C_validation p"]]
"""The prior, the parameters of training conditions and those of validation conditions."""


def identified(
    config: IdentificationConfig,
    train: Samples,
    validation: Samples,
    fit_samples: int,
    out_dir: str | Path | None = None,
) -> Found:
    """Identify the parameters, or take them from beside ``out_dir`` where another training on these samples has left
    them.

    Args:
        config: of the identification.
        train: C conditions.
        validation: C' conditions.
        fit_samples: first samples of a validation condition that count, at most half of them.
        out_dir: of the training; None keeps nothing.
    """
    measured = (train.inputs, train.labels, validation.inputs, validation.labels)
    identity = fingerprint(__name__, (config, fit_samples), *measured)
    path = None if out_dir is None else Path(out_dir).parent / f"contacts-{identity[:10]}.safetensors"
    if path is not None and path.is_file() and serialisation.read_notes(path).get("identity") == identity:
        return _single(serialisation.load_tree(path, _empty(config, train, validation))[0])
    scale = label_scale(train)
    prior, _ = identification.learn_prior(config, scale, train.inputs, train.labels, train.weights)
    prior = _single(prior)
    contacts = identification.from_stretches(config, prior, scale, tuple(train[:3]), STRETCHES)
    found = prior, contacts, on_first_samples(config, prior, scale, validation, fit_samples)
    if path is not None:
        serialisation.save_tree(path, found, {"identity": identity})
    return found


def nothing(config: IdentificationConfig, train: Samples, validation: Samples, *_: Any) -> Found:
    """`identified` for a psi without contact model: zeros of the same shapes."""
    return _single(_empty(config, train, validation))


def on_first_samples(
    config: IdentificationConfig, prior: ContactPrior, scale: Float[Array, "3"], samples: Samples, fit_samples: int
) -> Float[Array, "C p"]:
    """The parameters of conditions by their first ``fit_samples`` samples, at most half of them."""
    n = min(fit_samples, samples.inputs.shape[1] // 2)
    identify = partial(identification.identify, config, prior, jnp.asarray(scale))
    first = tuple(jnp.asarray(a[:, :n]) for a in samples[:3])
    return jax.jit(lambda r: jax.lax.map(lambda c: identify(*c), r))(first)


def _empty(config: IdentificationConfig, train: Samples, validation: Samples) -> Found:
    p, groups = len(contact_model.PARAMETERS), config.groups
    prior = ContactPrior(np.zeros((groups, p)), np.zeros((groups, p, p)), np.zeros(groups))
    counts = [samples.inputs.shape[0] for samples in (train, validation)]
    return prior, np.zeros((counts[0], len(STRETCHES), p)), np.zeros((counts[1], p))


def _single(tree: Any) -> Any:
    return jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), tree)
