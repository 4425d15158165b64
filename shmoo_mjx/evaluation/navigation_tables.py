"""Tables of the navigation experiment, made from its result."""

from __future__ import annotations

from collections import Counter
from typing import Any

from shmoo_mjx.evaluation.navigation_measures import COMPARED, EXTRA_BANDS, FAILURE_S, TIE_S
from shmoo_mjx.evaluation.paired import OURS
from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.evaluation.tables import differences_table, number, shown_name
from shmoo_mjx.report.tables import markdown_table

_BANDS = ("to 5 m", "5 to 15 m", "over 15 m", "no way round")
_COLUMNS = (
    ("success rate", ".2f", "success_rate_certified"),
    ("mean time lost [s]", ".1f", "regret_s"),
    ("median", ".1f", "regret_s_median"),
    *((label, ".1f", f"regret_s_{band}") for label, band in zip(_BANDS, EXTRA_BANDS, strict=True)),
    ("right first option", ".2f", "right_first_choice"),
    ("reported as blocked", ".0f", "unsolvable_called_blocked", "unsolvable"),
    ("falls", ".0f", "falls"),
    ("wall contacts", ".0f", "wall_contacts"),
    ("navigation score", ".2f", "ins"),
)
"""Columns of the table of policies: head, format, and the metrics of a cell."""
_MAIN = ("success rate", "mean time lost [s]", "median", "right first option", "wall contacts")


def policies_table(result: ExperimentResult) -> str:
    """The main columns of `reference_table`."""
    return _policies(result, _MAIN)


def reference_table(result: ExperimentResult) -> str:
    """Every policy compared with the certificates of the scenarios. Empty if no scenario has a certificate."""
    table = _policies(result, tuple(head for head, *_ in _COLUMNS))
    if not table:
        return ""
    ours = _prefixes(result)[0][1]
    counts = [_cell(result, f"{ours}certified_{band}", ".0f") for band in EXTRA_BANDS]
    solvable = _cell(result, f"{ours}certified", ".0f")
    reference = _cell(result, f"{ours}reference_s", ".1f")
    return (
        f"{solvable} scenarios can be solved. In {', '.join(counts)} of them the way round is longer by up to 5 m, by "
        "5 to 15 m, by more, or there is none; these columns show the mean time lost. Time lost is the time minus "
        f"that of the best certified option, which takes {reference} s on average. A failure counts "
        f"{FAILURE_S:.0f} s. A first option is right if the best option that begins with it is within {TIE_S:.0f} s of "
        f"the best. Reported as blocked: of the scenarios that no option solves.\n\n{table}"
    )


def navigation_tables(result: ExperimentResult) -> str:
    """Differences from each other policy, scenarios by number of objects, and the causes of our failures."""
    return "\n\n".join(part for part in (_differences(result), _objects(result), _causes(result)) if part)


def _prefixes(result: ExperimentResult) -> list[tuple[str, str]]:
    """(policy, prefix of its metrics) of the policies that ran on scenarios with certificates, ours first."""
    policies = sorted(result.config.get("policies", []), key=lambda policy: policy != OURS)
    prefixes = [(policy, "" if policy == OURS else f"baseline_{policy}_") for policy in policies]
    return [(policy, p) for policy, p in prefixes if result.metrics.get(f"{p}certified") is not None]


def _cell(result: ExperimentResult, name: str, form: str) -> str:
    value = result.metrics.get(name)
    return "-" if value is None else format(value, form)


def _policies(result: ExperimentResult, heads: tuple[str, ...]) -> str:
    """A row per policy; the last column compares the time lost with ours."""
    columns = [column for column in _COLUMNS if column[0] in heads]
    rows = []
    for policy, p in _prefixes(result):
        key = f"difference_{policy}_regret_s"
        mean, low, high = (result.metrics.get(key + end) for end in ("", "_low", "_high"))
        versus = ""
        if mean is not None and low is not None and high is not None:
            versus = f"{number(mean, '+')} ({number(low)} to {number(high)})"
        cells = (" / ".join(_cell(result, p + name, form) for name in names) for _, form, *names in columns)
        rows.append([shown_name(policy), *cells, versus])
    head = ["policy", *(head for head, *_ in columns), "time lost by ours minus by it [s]"]
    return markdown_table(head, rows) if rows else ""


def _differences(result: ExperimentResult) -> str:
    others = [p for p in result.config.get("policies", []) if f"difference_{p}_success" in result.metrics]
    if not others:
        return ""
    measured = [n for n in COMPARED if any(f"difference_{other}_{n}" in result.metrics for other in others)]
    lines = [(COMPARED[name][0], name, COMPARED[name][1]) for name in measured]
    return differences_table(result.metrics, others, lines, trials="scenarios")


def _objects(result: ExperimentResult) -> str:
    rows = [r for r in result.rows if r["policy"] == OURS]
    if not rows:
        return ""
    counts = sorted({len(r["movable"]) for r in rows})
    groups = {
        "Objects in the scenario": lambda r: len(r["movable"]),
        "Objects in the way": lambda r: sum(r["blocking"]),
    }
    table = markdown_table(
        ["", *map(str, counts)],
        [[label, *(_solved([r for r in rows if of(r) == n]) for n in counts)] for label, of in groups.items()],
    )
    return f"Scenarios solved by ours, by number of objects:\n\n{table}"


def _solved(rows: list[dict[str, Any]]) -> str:
    return f"{sum(r['success'] for r in rows)} of {len(rows)}" if rows else "-"


def _causes(result: ExperimentResult) -> str:
    failed = Counter(r["cause"] for r in result.rows if r["policy"] == OURS and not r["success"])
    if not failed:
        return ""
    return "\n".join(["Failures of ours by cause:", "", *(f"- {cause}: {n}" for cause, n in failed.most_common())])
