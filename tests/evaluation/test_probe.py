"""The probe tells conditions that can be told, and guesses where there is nothing to tell."""

import numpy as np

from shmoo_mjx.evaluation import probe


def test_the_probe_finds_what_is_there_and_no_more() -> None:
    rng = np.random.default_rng(0)
    conditions, rows = 8, 200
    noise = rng.normal(size=(conditions, rows, 3))
    told = noise.copy()
    told[..., 0] += 6.0 * np.arange(conditions)[:, None]
    weights = np.ones((conditions, rows))
    assert probe.accuracy(told, weights, seed=0, updates=300) > 0.95
    assert probe.accuracy(noise, weights, seed=0, updates=300) < 2 / conditions


def test_rows_that_do_not_count_are_left_out() -> None:
    """The giveaway lies in rows of weight 0 only."""
    rng = np.random.default_rng(1)
    values = rng.normal(size=(4, 300, 2))
    weights = np.ones((4, 300))
    weights[:, ::2] = 0.0
    values[:, ::2, 0] = 10.0 * np.arange(4)[:, None]
    assert probe.accuracy(values, weights, seed=0, updates=200) < 0.45
