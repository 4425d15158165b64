"""Differences between two methods over the trials that both have run, with bootstrap intervals over trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

__all__ = ["Difference", "difference_cell", "difference_metrics", "paired_difference", "verdict"]


class Difference(NamedTuple):
    """Mean of (ours - theirs), with a 95 % interval."""

    mean: float
    low: float
    high: float
    pairs: int
    """Trials that count."""


def paired_difference(ours: Sequence[float], theirs: Sequence[float], resamples: int = 9999) -> Difference | None:
    """Mean difference over pairs of trials and its 95 % percentile bootstrap interval; None for fewer than two pairs.

    Args:
        ours: one value per trial.
        theirs: of the same trials, in the same order.
        resamples: of the trials, always with the same random numbers.
    """
    from scipy.stats import bootstrap

    differences = np.asarray(ours, dtype=float) - np.asarray(theirs, dtype=float)
    if differences.size < 2:
        return None
    # The default interval (BCa) is not defined where all trials differ by the same, as successes often do.
    found = bootstrap(
        (differences,), np.mean, n_resamples=resamples, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    return Difference(float(differences.mean()), float(found.low), float(found.high), int(differences.size))


def difference_metrics(key: str, ours: Sequence[float], theirs: Sequence[float]) -> dict[str, float]:
    """`paired_difference` as flat metrics ``key``, ``key_low``, ``key_high``, ``key_pairs``; none for too few pairs."""
    found = paired_difference(ours, theirs)
    if found is None:
        return {}
    return {key: found.mean, f"{key}_low": found.low, f"{key}_high": found.high, f"{key}_pairs": found.pairs}


def difference_cell(metrics: Mapping[str, Any], key: str, more_is_better: bool) -> str:
    """What a table shows of `difference_metrics`; "-" where there are none."""
    mean, low, high = (metrics.get(key + end) for end in ("", "_low", "_high"))
    if mean is None or low is None or high is None:
        return "-"
    said = verdict(low, high, more_is_better)
    pairs = f", {metrics[f'{key}_pairs']:.0f} pairs"
    return f"{mean:+.3g} ({low:.3g} to {high:.3g}{pairs})" + (f" **{said}**" if said else "")


def verdict(low: float, high: float, more_is_better: bool) -> str:
    """Better or worse where the interval excludes zero; empty where it does not."""
    if low <= 0.0 <= high:
        return ""
    return "better" if (low > 0.0) == more_is_better else "worse"
