"""Plain networks over all conditions: an MLP without adaptation, and a GRU that adapts."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn

from shmoo_mjx.arrays import Array, Float
from shmoo_mjx.dynamics.networks import MLP
from shmoo_mjx.evaluation.baselines.gradient import meta_train
from shmoo_mjx.evaluation.baselines.protocol import Context, Job, Predictor, output_scale
from shmoo_mjx.evaluation.baselines.sight import sight

HIDDEN = (128, 128, 50)
"""Widths of the hidden layers of every network here, the same as those of psi."""
MEMORY = 64
"""Width of the GRU's state."""
CONTEXT_ROWS = 150
"""Maximum number of samples that the GRU reads in training. About as many samples count in 25 s of recording."""


def mlp(job: Job, contact_model: bool = False) -> Predictor:
    """One network for all conditions, without adaptation.

    Args:
        job: data, budget, seed and settings.
        contact_model: whether the network sees the contact model with the estimated contact parameters (`sight`).
    """
    sees, scale = sight(job, contact_model), output_scale(job.train.samples)
    network = MLP((*HIDDEN, scale.shape[0]), "relu")
    start = network.init(jax.random.key(job.seed), sees.mean)

    def predictor(params: Any) -> Predictor:
        return Predictor(
            sees.contact, lambda contact, x, time: jnp.asarray(network.apply(params, sees(x, contact))) * scale
        )

    return predictor(meta_train(job, start, predictor, name="mlp", sees=sees, adapt_samples=8))


def gru(job: Job) -> Predictor:
    """A recurrent network that reads the inputs and labels of the context. Its final memory is an input of an MLP."""
    sees, scale = sight(job), output_scale(job.train.samples)
    cell, head = nn.GRUCell(MEMORY), MLP((*HIDDEN, scale.shape[0]), "relu")
    # The key folds in 0, because `meta_train` folds 1 into the same key.
    cell_key, head_key = jax.random.split(jax.random.fold_in(jax.random.key(job.seed), 0))
    empty = jnp.zeros(MEMORY)
    start = {
        "cell": cell.init(cell_key, empty, jnp.concatenate([sees.mean, scale])),
        "head": head.init(head_key, jnp.concatenate([sees.mean, empty])),
    }

    def predictor(params: Any) -> Predictor:
        def read(memory: jax.Array, sample: Any) -> tuple[jax.Array, None]:
            inputs, weight = sample
            # A sample that does not count leaves the memory unchanged.
            return memory + weight * (jnp.asarray(cell.apply(params["cell"], memory, inputs)[0]) - memory), None

        def adapt(context: Context) -> tuple[Float[Array, "M"], Float[Array, "p"]]:
            contact = sees.contact(context)
            samples = jnp.concatenate([sees(context.inputs, contact), context.labels / scale], axis=-1)
            return jax.lax.scan(read, empty, (samples, context.weights))[0], contact

        def predict(
            state: tuple[Float[Array, "M"], Float[Array, "p"]],
            x: Float[Array, "*batch n"],
            time: Float[Array, "*batch"],
        ) -> Float[Array, "*batch m"]:
            memory, contact = state
            context = jnp.broadcast_to(memory, (*x.shape[:-1], MEMORY))
            inputs = jnp.concatenate([sees(x, contact), context], axis=-1)
            return jnp.asarray(head.apply(params["head"], inputs)) * scale

        return Predictor(jax.jit(adapt), predict)

    return predictor(meta_train(job, start, predictor, name="gru", sees=sees, adapt_samples=CONTEXT_ROWS))
