"""Noise of MPPI's sampled controls: coloured sequences that are drawn once and reused."""

from __future__ import annotations

import math
from functools import lru_cache, singledispatch

import jax
import jax.numpy as jnp
import numpy as np

from shmoo_mjx.arrays import Array, Float, Key
from shmoo_mjx.control.mppi_config import MppiConfig

SPARE = 4096
"""Extra noise sequences. Each plan uses a random contiguous slice of the bank, with this many possible starts."""


def draw(cfg: MppiConfig, key: Key[Array, ""], dtype: np.dtype) -> Float[jax.Array, "S T m"]:
    """Noise of one plan: a random slice of `bank`, and the same slice with opposite sign.

    The mean of a slice is not zero and would bias the plan. The sequences with opposite sign cancel it.
    """
    half = (cfg.num_rollouts + 1) // 2
    first = jax.random.randint(key, (), 0, SPARE, dtype=jnp.int32)
    stretch = jax.lax.dynamic_slice_in_dim(jnp.asarray(bank(cfg), dtype), first, half)
    return jnp.concatenate([stretch, -stretch])[: cfg.num_rollouts]


@singledispatch
def bank(cfg: MppiConfig) -> Float[np.ndarray, "n T m"]:
    """(S + 1) // 2 + SPARE sequences of AR(1) noise with standard deviation ``cfg.sigma``.

    To use another kind of noise, derive a class from MppiConfig and register its function with ``bank.register``.
    """
    return _coloured(cfg)


@lru_cache(maxsize=8)
def _coloured(cfg: MppiConfig) -> np.ndarray:
    """`bank`, cached because drawing it takes a tenth of the time of a plan."""
    white = np.random.default_rng(0).standard_normal(((cfg.num_rollouts + 1) // 2 + SPARE, cfg.horizon, cfg.controls))
    # Cholesky factor of the AR(1) correlation rho^|i - j|, with coloured = factor white.
    rho, steps = cfg.noise_correlation, np.arange(cfg.horizon)
    factor = np.tril(rho ** np.maximum(steps[:, None] - steps[None, :], 0)) * math.sqrt(1 - rho**2)
    factor[:, 0] = rho**steps
    return np.asarray(np.einsum("tk,skm->stm", factor, white) * cfg.sigma, dtype=np.float32)
