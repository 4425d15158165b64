"""How experiments are shown: sections, tables of metrics, differences with intervals, and sentences made from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.report.tables import markdown_table

Metrics = Mapping[str, float | None]
SummaryValue = tuple[str, int, str]
"""Value with unit and 95 % interval, number of trials, and the paper's value ("" if it has none)."""
Show = Callable[[ExperimentResult], str]
"""Makes Markdown from a result; "" if the result has nothing to show."""


SNAPSHOT = "Measured with a development snapshot of code and weights; not repeated for this version."
"""Said of a result that the shipped code and weights have not made."""


class Line(NamedTuple):
    """One line of a table of metrics."""

    label: str
    metrics: tuple[str, ...]
    """Name of the metric of each column; "" leaves the cell empty."""


@dataclass(frozen=True)
class Table:
    """A table of metrics: one line per quantity, one column per method. Calling it renders it."""

    columns: tuple[str, ...]
    """Column heads."""
    lines: tuple[Line, ...]
    about: str = ""
    """Text above the table."""

    def __call__(self, result: ExperimentResult) -> str:
        """The table with a column of the paper's values, as Markdown. Lines and columns without values are left out."""
        lines = [line for line in self.lines if any(name in result.metrics for name in line.metrics)]
        shown = [i for i in range(len(self.columns)) if any(line.metrics[i] in result.metrics for line in lines)]
        if not shown:
            return ""
        paper = [" / ".join(f"{result.paper[n]:.3g}" for n in line.metrics if n in result.paper) for line in lines]
        head = ["", *(self.columns[i] for i in shown), *(["paper"] if any(paper) else [])]
        rows = [
            [line.label, *(cell(result.metrics, line.metrics[i]) for i in shown), *([value] if any(paper) else [])]
            for line, value in zip(lines, paper, strict=True)
        ]
        return f"{self.about}\n\n{markdown_table(head, rows)}".strip()


@dataclass(frozen=True)
class Section:
    """How the results page shows an experiment. docs/protocols.md says how it is measured."""

    title: str
    question: str
    """One sentence."""
    tables: tuple[Show, ...]
    """The first one stands on the results page. The experiment's own page shows all."""
    shows: Show
    """One paragraph: what the numbers say."""
    figures: Mapping[str, str] = field(default_factory=dict)
    """File in the experiment's folder to caption. The first one stands on the results page."""
    arguments: Callable[[Mapping[str, Any]], str] = lambda config: ""
    """What the command needs besides seeds, given a result's config (empty if there is no result)."""
    draws_conditions: bool = True
    """Whether the condition seed decides about the trials."""
    without_weights: bool = False
    """Whether the experiment uses no trained weights."""
    summary: tuple[tuple[str, Callable[[ExperimentResult], SummaryValue]], ...] = ()
    """(label, value) of the numbers at the top of the results page."""


def lines_of(labels: Mapping[str, str], *columns: str) -> tuple[Line, ...]:
    """A line for each metric in ``labels``. A column is a pattern such as "{}_after" that the metric is put into."""
    return tuple(Line(label, tuple(c.format(metric) for c in columns or ("{}",))) for metric, label in labels.items())


def lines_of_methods(labels: Mapping[str, str], *methods: str) -> tuple[Line, ...]:
    """Lines with a column for ours and one for each other method."""
    return lines_of(labels, "{}", *(f"baseline_{method}_{{}}" for method in methods))


def number(value: float, sign: str = "") -> str:
    """A number with two significant digits, or all digits before the point if it has more. Counts have no point."""
    value += 0.0
    if abs(value) >= 99.5 or value == round(value):
        return f"{value:{sign}.0f}"
    # Halves are rounded away from zero, as `percent` does.
    return f"{value * (1.0 + 1e-9):{sign}#.2g}".rstrip(".")


def cell(metrics: Metrics, name: str, std: str = "", *, infinite: str = "-", absent: str = "") -> str:
    """A metric with its interval NAME_low to NAME_high or its standard deviation, where it has one.

    Args:
        metrics: of a result.
        name: of the metric.
        std: name of its standard deviation (default: NAME_std).
        infinite: text for a metric without a finite value.
        absent: text for a metric that does not exist.
    """
    if name not in metrics:
        return absent
    value, spread = metrics[name], metrics.get(std or f"{name}_std")
    if value is None:
        return infinite
    if metrics.get(f"{name}_low") is not None:
        return f"{number(value)} ({_interval(metrics, name)})"
    return number(value) + (f" ± {number(spread)}" if spread else "")


def over_seeds_cell(metrics: Metrics, measure: str, name: str) -> str:
    """Mean and standard deviation from `result.over_seeds`. A measure without a finite value has diverged."""
    return cell(metrics, f"{measure}_{name}", f"{measure}_std_{name}", infinite="diverges", absent="-")


def shown_name(method: str) -> str:
    """The name of a method in words. A user's own method, "package.module:Name", keeps its name."""
    return method if ":" in method else METHOD_LABELS.get(method, method.replace("_", " "))


METHOD_LABELS = {
    "frozen_prior": "no adaptation",
    "frozen": "no adaptation",
    "contact_model": "contact model without psi",
    "quasi_static": "quasi-static rule",
    "oracle_coefficients": "known object parameters",
    "paper": "the paper's system",
    "lazy": "goes round where possible",
    "always_avoid": "never pushes",
    "always_push": "always pushes",
    "geometric": "pushes first, immovable if it does not move",
    "oracle": "knows what to push",
}
"""Method or policy to its name on pages and in figures."""


def differences_table(
    metrics: Metrics, others: Sequence[str], lines: Iterable[tuple[str, str, bool]], *, trials: str = "trials"
) -> str:
    """Mean difference between ours and each other method as Markdown.

    Args:
        metrics: with ``difference_METHOD_NAME`` from `paired.difference_metrics`.
        others: methods, one column each.
        lines: (label, NAME, whether more of it is better).
        trials: what the intervals are taken over.
    """
    rows = [
        [label, *(_difference(metrics, f"difference_{other}_{name}", more_is_better) for other in others)]
        for label, name, more_is_better in lines
    ]
    return (
        f"Mean difference (ours minus the other) over the same {trials}, with 95 % bootstrap intervals. Better and "
        "worse are stated where the interval excludes zero.\n\n"
    ) + markdown_table(["", *(f"compared with: {shown_name(other)}" for other in others)], rows)


def _difference(metrics: Metrics, key: str, more_is_better: bool) -> str:
    mean, low, high, pairs = (metrics.get(key + end) for end in ("", "_low", "_high", "_pairs"))
    if mean is None or low is None or high is None:
        return "-"
    judged = verdict(low, high, more_is_better)
    return f"{number(mean, '+')} ({_interval(metrics, key)}; n = {pairs:.0f})" + (f" **{judged}**" if judged else "")


def _interval(metrics: Metrics, name: str, scale: float = 1.0) -> str:
    return " to ".join(number(scale * (metrics[name + end] or 0.0)) for end in ("_low", "_high"))


def verdict(low: float, high: float, more_is_better: bool) -> str:
    """Better or worse if the interval excludes zero, otherwise empty."""
    if low <= 0.0 <= high:
        return ""
    return "better" if (low > 0.0) == more_is_better else "worse"


class Effect(NamedTuple):
    """A quantity that two methods are compared by."""

    noun: str
    name: str
    """Of the metric behind ``difference_METHOD_``."""
    unit: str
    scale: float = 1.0


def effects(result: ExperimentResult, subject: str, key: str, measures: Sequence[Effect]) -> str:
    """A sentence on what ``subject`` changes: clear effects by size, then those whose interval includes zero.

    ``key`` is the start of the metrics' names, for example "difference_frozen_prior_". Empty if nothing was measured.
    """
    clear, unclear = [], []
    for noun, name, unit, scale in measures:
        metric = result.metrics.get(key + name)
        low, high = (result.metrics.get(f"{key}{name}{end}") for end in ("_low", "_high"))
        if metric is None or low is None or high is None:
            continue
        if low <= 0.0 <= high:
            size = f"{number(scale * metric, '+')} {unit}".strip()
            unclear.append(f"{noun} ({size}, {_interval(result.metrics, key + name, scale)})")
        else:
            bounds = sorted(scale * abs(bound) for bound in (low, high))
            size = f"{number(scale * abs(metric))} {unit}".strip()
            verb = "raises" if metric > 0 else "lowers"
            clear.append(f"{verb} {noun} by {size} ({number(bounds[0])} to {number(bounds[1])})")
    sentences = [f"{subject} {_listed(clear)}."] if clear else []
    if unclear:
        sentences.append(f"{'It' if clear else subject} has no clear effect on {_listed(unclear)}.")
    return " ".join(sentences)


def _listed(items: Sequence[str]) -> str:
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"


class NotMeasured(Exception):
    """The result lacks a number that is to be shown."""


def measured(result: ExperimentResult, name: str) -> float:
    """The value of a metric.

    Raises:
        NotMeasured: the result has no value for it.
    """
    value = result.metrics.get(name)
    if value is None:
        raise NotMeasured
    return value


def percent(share: float) -> str:
    """A share in per cent."""
    return f"{100 * share + 1e-9:.0f} %"


def _short(value: float, sign: str = "") -> str:
    """A number with one decimal, or none from 10 on."""
    return f"{value + 0.0:{sign}.{0 if abs(value) >= 10 else 1}f}"


def rate(name: str, trials: Callable[[ExperimentResult], float]) -> Callable[[ExperimentResult], SummaryValue]:
    """The share of successful trials in per cent with its Wilson interval."""

    def value(result: ExperimentResult) -> SummaryValue:
        from scipy.stats import binomtest

        share, n = measured(result, name), round(trials(result))
        if n < 1:
            raise NotMeasured
        low, high = binomtest(round(share * n), n).proportion_ci(method="wilson")
        return f"{percent(share)} ({100 * low:.0f} to {100 * high:.0f})", n, ""

    return value


def difference(name: str, unit: str, scale: float = 1.0) -> Callable[[ExperimentResult], SummaryValue]:
    """A mean difference over the same trials with its bootstrap interval."""

    def value(result: ExperimentResult) -> SummaryValue:
        mean, low, high = (scale * measured(result, name + end) for end in ("", "_low", "_high"))
        return (
            f"{_short(mean, '+')} {unit} ({_short(low)} to {_short(high)})",
            round(measured(result, f"{name}_pairs")),
            "",
        )

    return value
