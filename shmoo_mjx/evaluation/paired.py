"""Comparison of methods on the same trials: metrics of each, and paired differences with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

OURS = "ours"

Row = dict[str, Any]


class PairedDifference(NamedTuple):
    """Mean of ours minus theirs with a 95 % interval."""

    mean: float
    low: float
    high: float
    pairs: int
    """Number of trials that both have run."""


def paired_difference(ours: Sequence[float], theirs: Sequence[float], resamples: int = 9999) -> PairedDifference | None:
    """Mean of ours minus theirs over the same trials with its 95 % percentile bootstrap interval.

    None for fewer than two trials. The resampling has a fixed seed.
    """
    from scipy.stats import bootstrap

    differences = np.asarray(ours, dtype=float) - np.asarray(theirs, dtype=float)
    if differences.size < 2:
        return None
    # The default interval (BCa) is undefined if all differences are equal, which is common for successes.
    interval = bootstrap(
        (differences,), np.mean, n_resamples=resamples, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    return PairedDifference(float(differences.mean()), float(interval.low), float(interval.high), int(differences.size))


def difference_metrics(key: str, name: str, pairs: Sequence[tuple[Row, Row]]) -> dict[str, float]:
    """`paired_difference` of the rows' field ``name`` as metrics KEY, KEY_low, KEY_high and KEY_pairs.

    Empty for fewer than two pairs.
    """
    difference = paired_difference([ours[name] for ours, _ in pairs], [theirs[name] for _, theirs in pairs])
    if difference is None:
        return {}
    mean, low, high, count = difference
    return {key: mean, f"{key}_low": low, f"{key}_high": high, f"{key}_pairs": count}


def metrics_by_method(
    of: Mapping[str, Mapping[Any, Row]],
    scores: Callable[[list[Row]], dict[str, Any]],
    differences: Callable[[str, list[tuple[Row, Row]]], dict[str, Any]],
) -> dict[str, Any]:
    """Metrics of all methods: ours by name, those of others as ``baseline_METHOD_*``, and the differences.

    Args:
        of: rows by method and trial.
        scores: returns the metrics of one method's rows.
        differences: returns metrics for a method and its pairs of rows (ours, its) on common trials.
    """
    metrics: dict[str, Any] = {}
    for method, mine in of.items():
        prefix = "" if method == OURS else f"baseline_{method}_"
        metrics |= {prefix + name: value for name, value in scores(list(mine.values())).items()}
        if method != OURS and OURS in of:
            metrics |= differences(method, [(row, mine[trial]) for trial, row in of[OURS].items() if trial in mine])
    return metrics
