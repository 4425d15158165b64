"""What the page shows of the navigation experiment below its first table; everything is in the result's JSON."""

from __future__ import annotations

from collections import Counter
from typing import Any

from shmoo_mjx.evaluation.navigation_measures import COMPARED
from shmoo_mjx.evaluation.paired import OURS, differences_table
from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.evaluation.scenarios import KINDS
from shmoo_mjx.report.tables import markdown_table


def navigation_tables(result: ExperimentResult) -> str:
    """Differences from each baseline, scenarios by map and by number of objects, and the causes of our failures."""
    parts = [_differences(result), _maps(result), _objects(result), _causes(result)]
    return "\n\n".join(part for part in parts if part)


def _differences(result: ExperimentResult) -> str:
    others = [p for p in result.config.get("policies", []) if f"difference_{p}_success" in result.metrics]
    if not others:
        return ""
    lines = [(label, name, more) for name, (label, more) in COMPARED.items()]
    return differences_table(result.metrics, others, lines, "policy", "scenarios")


def _maps(result: ExperimentResult) -> str:
    """How many scenarios of each kind each map has, and how many of each ours solves."""
    rows = [r for r in result.rows if r["policy"] == OURS and "wanted" in r]
    if not rows:
        return ""
    lines = []
    for name in dict.fromkeys(r["map"] for r in rows):
        here = [r for r in rows if r["map"] == name]
        lacking = [f"{kind}: {_lacking(here, kind)}" for kind in KINDS if _lacking(here, kind)]
        cells = [_solved([r for r in here if r["kind"] == kind]) for kind in KINDS]
        lines.append([name, *cells, ", ".join(lacking)])
    return (
        "Scenarios by map (solved by ours / there are). A map that has no place for a kind gets others in its stead."
        f"\n\n{markdown_table(['map', *KINDS, 'no place for'], lines)}"
    )


def _lacking(rows: list[dict[str, Any]], kind: str) -> int:
    """Scenarios that were to be of this kind and are not."""
    return sum(r["wanted"] == kind != r["kind"] for r in rows)


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
