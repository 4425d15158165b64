"""Another list of noise reaches the plan, and the kinds that are compared differ in nothing but their shape."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.rollouts import Variant
from shmoo_mjx.control import mppi
from shmoo_mjx.control.noise import bank
from shmoo_mjx.control.presets import PushConfig


@pytest.mark.parametrize("kind", ["shipped", "white", "sobol", "spline"])
def test_every_kind_has_the_stated_deviation_and_reaches_the_plan(kind: str) -> None:
    control = Variant(kind, 64).config().control
    noise = bank(control)
    np.testing.assert_allclose(noise.std(axis=(0, 1)), control.sigma, rtol=0.03)
    np.testing.assert_allclose(noise[:, [0, 15, 29]].std(axis=0), np.tile(control.sigma, (3, 1)), rtol=0.06)
    later = np.corrcoef(noise[:, 10, 0], noise[:, 11, 0])[0, 1]
    assert abs(later) < 0.06 if kind == "white" else later > 0.9
    free = replace(control, low=(-9.0,) * 3, high=(9.0,) * 3)
    drawn = np.asarray(mppi.sample_controls(free, jax.random.key(0), jnp.zeros((30, 3))))
    assert (np.abs(noise - drawn[5]).max(axis=(1, 2)) < 1e-6).sum() == 1


def test_the_preset_changes_the_number_of_roll_outs_alone() -> None:
    base = PushConfig()
    assert base.light().control.num_rollouts == 128 and base.control.num_rollouts == 500
    assert replace(base.light(), control=base.control) == base
