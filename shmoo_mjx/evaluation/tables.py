"""Tables and summary numbers of experiments, made from their results: a line per metric, a column per method."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.report.tables import markdown_table

Metrics = Mapping[str, float | None]
SummaryValue = tuple[str, int, str]
"""The value with its unit and 95 % interval, the number of trials, and the paper's number ("" without one)."""


class Line(NamedTuple):
    """One line of an experiment's table."""

    label: str
    metrics: tuple[str, ...]
    """Name of the metric of each column; "" leaves the cell empty."""


@dataclass(frozen=True)
class Section:
    """How the page of results shows an experiment."""

    title: str
    what: str
    """What was measured on what, in a few sentences."""
    columns: tuple[str, ...] = ()
    """Heads of the table."""
    lines: tuple[Line, ...] = ()
    figures: tuple[str, ...] = ()
    """Files in the experiment's folder."""
    arguments: Callable[[Mapping[str, Any]], str] = lambda config: ""
    """What the command needs besides seeds, of a result's config (empty if there is no result)."""
    command: str = ""
    """Command that makes the result, where that is not ``shmoo experiment NAME``."""
    without_psi: bool = False
    """No weights play a part in it."""
    table: Callable[[ExperimentResult], str] | None = None
    """Makes the table, in the place of ``columns`` and ``lines``."""
    further_tables: Callable[[ExperimentResult], str] | None = None
    """Makes the tables after the first."""
    summary: tuple[tuple[str, Callable[[ExperimentResult], SummaryValue]], ...] = ()
    """(label, value) of the numbers that the page begins with."""

    def body(self, result: ExperimentResult) -> str:
        """The tables as Markdown."""
        first = metrics_table(result, self.columns, self.lines) if self.table is None else self.table(result)
        return first if self.further_tables is None else f"{first}\n\n{self.further_tables(result)}"


def lines_of(labels: Mapping[str, str], *columns: str) -> tuple[Line, ...]:
    """A line for each metric of ``labels``, which every column names in its own way, "{}_after" for example."""
    return tuple(Line(label, tuple(c.format(metric) for c in columns or ("{}",))) for metric, label in labels.items())


def lines_of_methods(labels: Mapping[str, str], *methods: str) -> tuple[Line, ...]:
    """Lines whose columns are ours and the other ``methods``."""
    return lines_of(labels, "{}", *(f"baseline_{method}_{{}}" for method in methods))


def metrics_table(result: ExperimentResult, columns: Sequence[str], lines: Sequence[Line]) -> str:
    """The lines with the paper's numbers behind them, as Markdown; what was not measured has no line or column."""
    lines = [line for line in lines if any(name in result.metrics for name in line.metrics)]
    shown = [i for i in range(len(columns)) if any(line.metrics[i] in result.metrics for line in lines)]
    rows = []
    for label, names in lines:
        cells = (cell(result.metrics, names[i], f"{names[i]}_std") for i in shown)
        rows.append([label, *cells, " / ".join(f"{result.paper[n]:.3g}" for n in names if n in result.paper)])
    return markdown_table(["", *(columns[i] for i in shown), "paper"], rows)


def cell(metrics: Metrics, name: str, std: str = "", *, infinite: str = "-", absent: str = "") -> str:
    """A metric with its standard deviation ``std``, where it has one; ``infinite`` where it has no number."""
    if name not in metrics:
        return absent
    value, spread = metrics[name], metrics.get(std)
    return infinite if value is None else f"{value:.3g}" + (f"±{spread:.2g}" if spread else "")


def over_seeds_cell(metrics: Metrics, measure: str, name: str) -> str:
    """Mean and standard deviation of what `result.over_seeds` has put into the metrics.

    A measure that is there without a number is infinite: some object's roll-out diverged.
    """
    return cell(metrics, f"{measure}_{name}", f"{measure}_std_{name}", infinite="diverges", absent="-")


def shown_name(method: str) -> str:
    """The name of a method in words; that of a user's own, "package.module:Name", stays as it is."""
    return method if ":" in method else method.replace("_", " ")


def differences_table(
    metrics: Metrics,
    others: Sequence[str],
    lines: Iterable[tuple[str, str, bool]],
    *,
    method: str = "method",
    trials: str = "trials",
) -> str:
    """Ours minus each other method as Markdown, with a line for each (label, NAME, whether more of it is better).

    ``metrics`` has ``difference_METHOD_NAME`` as `paired.difference_metrics` makes them; absent ones are shown as "-".
    """
    return (
        f"Ours minus each other {method} over the same {trials}, with 95 % bootstrap intervals over {trials}; better "
        "and worse are said where the interval excludes zero.\n\n"
    ) + markdown_table(
        ["", *(f"- {shown_name(other)}" for other in others)],
        [
            [label, *(_difference(metrics, f"difference_{other}_{name}", more_is_better) for other in others)]
            for label, name, more_is_better in lines
        ],
    )


def _difference(metrics: Metrics, key: str, more_is_better: bool) -> str:
    mean, low, high, pairs = (metrics.get(key + end) for end in ("", "_low", "_high", "_pairs"))
    if mean is None or low is None or high is None:
        return "-"
    judged = verdict(low, high, more_is_better)
    return f"{mean:+.3g} ({low:.3g} to {high:.3g}, {pairs:.0f} pairs)" + (f" **{judged}**" if judged else "")


def verdict(low: float, high: float, more_is_better: bool) -> str:
    """Better or worse where the interval excludes zero; empty where it does not."""
    if low <= 0.0 <= high:
        return ""
    return "better" if (low > 0.0) == more_is_better else "worse"


class NotMeasured(Exception):
    """The result lacks a number that the summary shows."""


def measured(result: ExperimentResult, name: str) -> float:
    """A metric.

    Raises:
        NotMeasured: the result has no number for it.
    """
    value = result.metrics.get(name)
    if value is None:
        raise NotMeasured
    return value


def short(value: float, sign: str = "") -> str:
    """A number with one decimal, or none from 10 on."""
    return f"{value + 0.0:{sign}.{0 if abs(value) >= 10 else 1}f}"


def rate(name: str, trials: Callable[[ExperimentResult], float]) -> Callable[[ExperimentResult], SummaryValue]:
    """A share of independent trials in per cent, with its Wilson interval."""

    def value(result: ExperimentResult) -> SummaryValue:
        from scipy.stats import binomtest

        share, n = measured(result, name), round(trials(result))
        if n < 1:
            raise NotMeasured
        low, high = binomtest(round(share * n), n).proportion_ci(method="wilson")
        return f"{100 * share:.0f} % ({100 * low:.0f} to {100 * high:.0f})", n, ""

    return value


def difference(name: str, unit: str, scale: float = 1.0) -> Callable[[ExperimentResult], SummaryValue]:
    """A mean difference over the same trials, with its bootstrap interval."""

    def value(result: ExperimentResult) -> SummaryValue:
        mean, low, high = (scale * measured(result, name + end) for end in ("", "_low", "_high"))
        interval = f"{short(low)} to {short(high)}"
        return f"{short(mean, '+')} {unit} ({interval})", round(measured(result, f"{name}_pairs")), ""

    return value
