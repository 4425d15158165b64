"""Noise of MPPI's sampled controls: coloured sequences, drawn once and reused."""

from __future__ import annotations

import math
from functools import lru_cache, singledispatch

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float, Key
from shmoo_mjx.control.mppi_config import MppiConfig

SPARE = 4096
"""Sequences in the bank beyond those of one plan, which takes a random stretch of the bank: so many plans differ."""


def draw(cfg: MppiConfig, key: Key[Array, ""], dtype: np.dtype) -> Float[jax.Array, "S T m"]:
    """Noise of one plan: a stretch of `bank` that ``key`` selects, and its mirror image.

    Without the mirror image the mean of a stretch, which is not zero, would pull every plan to one side.
    """
    half = (cfg.num_rollouts + 1) // 2
    first = jax.random.randint(key, (), 0, SPARE, dtype=jnp.int32)
    stretch = jax.lax.dynamic_slice_in_dim(jnp.asarray(bank(cfg), dtype), first, half)
    return jnp.concatenate([stretch, -stretch])[: cfg.num_rollouts]


@singledispatch
def bank(cfg: MppiConfig) -> Float[np.ndarray, "n T m"]:
    """(S + 1) // 2 + SPARE sequences of AR(1) noise with standard deviation ``cfg.sigma``.

    For another kind of noise, derive a class from MppiConfig and ``bank.register`` its function.
    """
    return _coloured(cfg)


@lru_cache(maxsize=8)
def _coloured(cfg: MppiConfig) -> np.ndarray:
    """`bank`, drawn once: drawing it anew would take a tenth of a plan's time."""
    white = np.random.default_rng(0).standard_normal(((cfg.num_rollouts + 1) // 2 + SPARE, cfg.horizon, cfg.controls))
    # The Cholesky factor of the AR(1) correlation rho^|i - j|: coloured = factor white.
    rho, steps = cfg.noise_correlation, np.arange(cfg.horizon)
    factor = np.tril(rho ** np.maximum(steps[:, None] - steps[None, :], 0)) * math.sqrt(1 - rho**2)
    factor[:, 0] = rho**steps
    return np.asarray(np.einsum("tk,skm->stm", factor, white) * cfg.sigma, dtype=np.float32)
