"""What the page shows of the navigation experiment below its first table; everything is in the result's JSON."""

from __future__ import annotations

from collections import Counter
from typing import Any

from shmoo_mjx.evaluation.navigation_measures import COMPARED, EXTRA_BANDS, FAILURE_S, TIE_S
from shmoo_mjx.evaluation.paired import OURS
from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.evaluation.tables import differences_table, shown_name
from shmoo_mjx.report.tables import markdown_table


def navigation_tables(result: ExperimentResult) -> str:
    """Regret, differences from each baseline, scenarios by number of objects, and the causes of our failures."""
    parts = [reference_table(result), _differences(result), _objects(result), _causes(result)]
    return "\n\n".join(part for part in parts if part)


_COLUMNS = (
    ("success", ".2f", "success_rate_certified"),
    ("regret [s]", ".1f", "regret_s"),
    ("median", ".1f", "regret_s_median"),
    *zip(
        ("to 5 m", "5 to 15 m", "over 15 m", "no way round"),
        (".1f",) * len(EXTRA_BANDS),
        (f"regret_s_{band}" for band in EXTRA_BANDS),
        strict=True,
    ),
    ("right first choice", ".2f", "right_first_choice"),
    ("said blocked", ".0f", "unsolvable_called_blocked", "unsolvable"),
    ("falls", ".0f", "falls"),
    ("wall contacts", ".0f", "wall_contacts"),
    ("score", ".2f", "ins"),
)
"""Of the table of policies: head, format, and the metrics of a cell."""


def reference_table(result: ExperimentResult) -> str:
    """Every policy against the certificates of the scenarios, a row per policy; empty where there are none."""
    metrics = result.metrics

    def cell(name: str, form: str) -> str:
        value = metrics.get(name)
        return "-" if value is None else format(value, form)

    prefixes = {p: "" if p == OURS else f"baseline_{p}_" for p in result.config.get("policies", [])}
    prefixes = {policy: p for policy, p in prefixes.items() if metrics.get(f"{p}certified") is not None}
    if not prefixes:
        return ""
    lines = []
    for policy, p in prefixes.items():
        mean, low, high = (metrics.get(f"difference_{policy}_regret_s{end}") for end in ("", "_low", "_high"))
        versus = "" if mean is None or low is None or high is None else f"{mean:+.1f} ({low:.1f} to {high:.1f})"
        cells = (" / ".join(cell(p + name, form) for name in names) for _, form, *names in _COLUMNS)
        lines.append([shown_name(policy), *cells, versus])
    p = prefixes.get(OURS, next(iter(prefixes.values())))
    counts = [cell(f"{p}certified_{band}", ".0f") for band in EXTRA_BANDS]
    return (
        f"Policies against the certificates: {cell(f'{p}certified', '.0f')} scenarios that can be solved, "
        f"{', '.join(counts)} of them in the four columns by extra length of the way round. Regret is the time minus "
        f"that of the best certified option (mean {cell(f'{p}reference_s', '.1f')} s); a failure counts "
        f"{FAILURE_S:.0f} s. A first choice is right if the best option that begins so is within {TIE_S:.0f} s of the "
        "best. Said blocked: of the scenarios that no option solves.\n\n"
    ) + markdown_table(["policy", *(head for head, *_ in _COLUMNS), "regret of ours minus it [s]"], lines)


def _differences(result: ExperimentResult) -> str:
    others = [p for p in result.config.get("policies", []) if f"difference_{p}_success" in result.metrics]
    if not others:
        return ""
    measured = [n for n in COMPARED if any(f"difference_{other}_{n}" in result.metrics for other in others)]
    lines = [(COMPARED[name][0], name, COMPARED[name][1]) for name in measured]
    return differences_table(result.metrics, others, lines, method="policy", trials="scenarios")


def _objects(result: ExperimentResult) -> str:
    rows = [r for r in result.rows if r["policy"] == OURS]
    if not rows:
        return ""
    counts = sorted({len(r["movable"]) for r in rows})
    groups = {"all": lambda r: len(r["movable"]), "in the way": lambda r: sum(r["blocking"])}
    table = markdown_table(
        ["", *(f"{n} object{'s' * (n > 1)}" for n in counts)],
        [[label, *(_solved([r for r in rows if of(r) == n]) for n in counts)] for label, of in groups.items()],
    )
    return f"Scenarios by number of objects (solved by ours / there are).\n\n{table}"


def _solved(rows: list[dict[str, Any]]) -> str:
    return f"{sum(r['success'] for r in rows)} / {len(rows)}" if rows else "-"


def _causes(result: ExperimentResult) -> str:
    failed = Counter(r["cause"] for r in result.rows if r["policy"] == OURS and not r["success"])
    if not failed:
        return ""
    return "\n".join(["Failures of ours by cause:", "", *(f"- {cause}: {n}" for cause, n in failed.most_common())])
