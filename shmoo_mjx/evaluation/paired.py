"""Ours beside other methods on the same trials: scores of each, and paired differences with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from shmoo_mjx.report.tables import markdown_table

OURS = "ours"

Row = dict[str, Any]


def shown_name(method: str) -> str:
    """The name of a method in words; that of a user's own, "package.module:Name", stays as it is."""
    return method if ":" in method else method.replace("_", " ")


class PairedDifference(NamedTuple):
    """Mean of (ours - theirs), with a 95 % interval."""

    mean: float
    low: float
    high: float
    pairs: int
    """Trials that count."""


def paired_difference(ours: Sequence[float], theirs: Sequence[float], resamples: int = 9999) -> PairedDifference | None:
    """Mean of ours - theirs over the same trials, with its 95 % percentile bootstrap interval; None for fewer than two.

    Resamples of the trials are drawn with the same random numbers always.
    """
    from scipy.stats import bootstrap

    differences = np.asarray(ours, dtype=float) - np.asarray(theirs, dtype=float)
    if differences.size < 2:
        return None
    # The default interval (BCa) is not defined where all trials differ by the same, as successes often do.
    found = bootstrap(
        (differences,), np.mean, n_resamples=resamples, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    return PairedDifference(float(differences.mean()), float(found.low), float(found.high), int(differences.size))


def difference_metrics(key: str, name: str, pairs: Sequence[tuple[Row, Row]]) -> dict[str, float]:
    """`paired_difference` of the rows' field ``name`` as flat metrics; none for too few pairs.

    They are called ``key``, ``key_low``, ``key_high`` and ``key_pairs``.
    """
    found = paired_difference([ours[name] for ours, _ in pairs], [theirs[name] for _, theirs in pairs])
    if found is None:
        return {}
    return {key: found.mean, f"{key}_low": found.low, f"{key}_high": found.high, f"{key}_pairs": found.pairs}


def metrics_by_method(
    of: Mapping[str, Mapping[Any, Row]],
    scores: Callable[[list[Row]], dict[str, Any]],
    differences: Callable[[str, list[tuple[Row, Row]]], dict[str, Any]],
) -> dict[str, Any]:
    """Ours by their names, the other methods' as ``baseline_METHOD_*``, and what ``differences`` says of each.

    Args:
        of: method -> trial -> row.
        scores: metrics of one method's rows.
        differences: metrics of (method, rows of ours and of it on the trials that both have run).
    """
    metrics: dict[str, Any] = {}
    for method, mine in of.items():
        prefix = "" if method == OURS else f"baseline_{method}_"
        metrics |= {prefix + name: value for name, value in scores(list(mine.values())).items()}
        if method != OURS and OURS in of:
            metrics |= differences(method, [(row, mine[trial]) for trial, row in of[OURS].items() if trial in mine])
    return metrics


def differences_table(
    metrics: Mapping[str, Any],
    others: Sequence[str],
    lines: Iterable[tuple[str, str, bool]],
    method: str = "method",
    trials: str = "trials",
) -> str:
    """Ours minus each other method as Markdown, with a line for each (label, NAME, whether more of it is better).

    ``metrics`` has ``difference_METHOD_NAME`` as `difference_metrics` makes them; "-" is shown where they are absent.
    """
    return (
        f"Ours minus each other {method} over the same {trials}, with 95 % bootstrap intervals over {trials}; better "
        "and worse are said where the interval excludes zero.\n\n"
    ) + markdown_table(
        ["", *(f"- {shown_name(other)}" for other in others)],
        [
            [label, *(_cell(metrics, f"difference_{other}_{name}", more_is_better) for other in others)]
            for label, name, more_is_better in lines
        ],
    )


def _cell(metrics: Mapping[str, Any], key: str, more_is_better: bool) -> str:
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
