"""Plain networks over all conditions: an MLP without adaptation, and a GRU that adapts."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from shmoo_mjx.learning.baselines.gradient import Layers, dense, layers, meta_train
from shmoo_mjx.learning.baselines.protocol import Context, Job, Predictor, output_scale
from shmoo_mjx.learning.baselines.sight import sight
from shmoo_mjx.types import Array

__all__ = ["gru", "mlp"]

HIDDEN = (128, 128, 50)
"""Hidden layers of every network here: those of psi."""
MEMORY = 64
"""Width of the GRU's state."""
CONTEXT_ROWS = 150
"""Most samples that the GRU reads in training; of 25 s of recording about as many count."""


class _Gru(NamedTuple):
    gates: Layers
    """Reset and update gates, from sample and memory."""
    candidate: Layers
    head: Layers


def mlp(job: Job) -> Predictor:
    """One network for all conditions; of the one at hand it knows at most the identified contact parameters
    (`sight`)."""
    sees, scale = sight(job), output_scale(job.train.samples)
    start = layers(jax.random.key(job.seed), sees.mean.shape[0], *HIDDEN, scale.shape[0])

    def predictor(params: Layers) -> Predictor:
        return Predictor(sees.contact, lambda contact, x, time: dense(params, sees(x, contact)) * scale)

    return predictor(meta_train(job, start, predictor, "mlp", sees, adapt_samples=8))


def gru(job: Job) -> Predictor:
    """A recurrent network reads inputs and labels of the context; its last memory goes into the network's inputs."""
    sees, scale = sight(job), output_scale(job.train.samples)
    n_in, n_out = sees.mean.shape[0], scale.shape[0]
    width = n_in + n_out + MEMORY
    keys = jax.random.split(jax.random.key(job.seed), 3)
    start = _Gru(
        layers(keys[0], width, 2 * MEMORY),
        layers(keys[1], width, MEMORY),
        layers(keys[2], n_in + MEMORY, *HIDDEN, n_out),
    )

    def predictor(params: _Gru) -> Predictor:
        def adapt(context: Context) -> tuple[Array, Array]:
            contact = sees.contact(context)
            samples = jnp.concatenate([sees(context.inputs, contact), context.labels / scale], axis=-1)
            memory, _ = jax.lax.scan(
                lambda m, r: (_read(params, m, *r), None), jnp.zeros(MEMORY), (samples, context.weights)
            )
            return memory, contact

        def predict(state: tuple[Array, Array], x: Array, time: Array) -> Array:
            memory, contact = state
            known = jnp.broadcast_to(memory, (*x.shape[:-1], MEMORY))
            return dense(params.head, jnp.concatenate([sees(x, contact), known], axis=-1)) * scale

        return Predictor(jax.jit(adapt), predict)

    return predictor(meta_train(job, start, predictor, "gru", sees, adapt_samples=CONTEXT_ROWS))


def _read(params: _Gru, memory: Array, sample: Array, weight: Array) -> Array:
    """One step of the GRU; a sample that does not count leaves the memory as it was."""
    reset, update = jnp.split(jax.nn.sigmoid(dense(params.gates, jnp.concatenate([sample, memory]))), 2)
    candidate = jnp.tanh(dense(params.candidate, jnp.concatenate([sample, reset * memory])))
    return memory + weight * update * (candidate - memory)
