"""What the page shows of the navigation experiment below its first table; everything is in the result's JSON."""

from __future__ import annotations

from collections import Counter
from typing import Any

from shmoo_mjx.evaluation.navigation_measures import COMPARED, OURS
from shmoo_mjx.evaluation.paired import difference_cell
from shmoo_mjx.evaluation.result import ExperimentResult
from shmoo_mjx.evaluation.scenarios import KINDS

__all__ = ["navigation_tables"]

_LABELS = {
    "success": "success",
    "time_s": "time, of scenarios that both solve [s]",
    "efficiency": "path efficiency",
    "effort": "effort efficiency, mass moved",
    "effort_force": "effort efficiency, force",
    "ins": "interactive navigation score",
}


def navigation_tables(result: ExperimentResult) -> str:
    """Differences from each baseline, scenarios by map and by number of objects, and the causes of our failures."""
    parts = [_differences(result), _maps(result), _objects(result), _causes(result)]
    return "\n\n".join(part for part in parts if part)


def _differences(result: ExperimentResult) -> str:
    others = [p for p in result.config.get("policies", []) if f"difference_{p}_success" in result.metrics]
    if not others:
        return ""
    lines = [
        "Ours minus each other policy over the same scenarios, with 95 % bootstrap intervals over scenarios; better "
        "and worse are said where the interval excludes zero.",
        "",
        f"| | {' | '.join('- ' + p.replace('_', ' ') for p in others)} |",
        "|---" * (len(others) + 1) + "|",
    ]
    for name, more_is_better in COMPARED.items():
        cells = [difference_cell(result.metrics, f"difference_{p}_{name}", more_is_better) for p in others]
        lines.append(f"| {_LABELS[name]} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _maps(result: ExperimentResult) -> str:
    """How many scenarios of each kind each map has, and how many of each ours solves."""
    rows = [r for r in result.rows if r["policy"] == OURS and "wanted" in r]
    if not rows:
        return ""
    lines = [
        "Scenarios by map (solved by ours / there are). A map that has no place for a kind gets others in its stead.",
        "",
        f"| map | {' | '.join(KINDS)} | no place for |",
        "|---" * (len(KINDS) + 2) + "|",
    ]
    for name in dict.fromkeys(r["map"] for r in rows):
        here = [r for r in rows if r["map"] == name]
        lacking = [f"{kind}: {_lacking(here, kind)}" for kind in KINDS if _lacking(here, kind)]
        cells = [_solved([r for r in here if r["kind"] == kind]) for kind in KINDS]
        lines.append(f"| {name} | {' | '.join(cells)} | {', '.join(lacking)} |")
    return "\n".join(lines)


def _lacking(rows: list[dict[str, Any]], kind: str) -> int:
    """Scenarios that were to be of this kind and are not."""
    return sum(r["wanted"] == kind != r["kind"] for r in rows)


def _objects(result: ExperimentResult) -> str:
    rows = [r for r in result.rows if r["policy"] == OURS]
    if not rows:
        return ""
    counts = sorted({len(r["movable"]) for r in rows})
    head = " | ".join(f"{n} object{'s' * (n > 1)}" for n in counts)
    groups = {
        "all": lambda r, n: len(r["movable"]) == n,
        "in the way": lambda r, n: sum(r["blocking"]) == n,
    }
    lines = ["Scenarios by number of objects (solved by ours / there are).", "", f"| | {head} |"]
    lines.append("|---" * (len(counts) + 1) + "|")
    for label, belongs in groups.items():
        cells = [_solved([r for r in rows if belongs(r, n)]) for n in counts]
        lines.append(f"| {label} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _solved(rows: list[dict[str, Any]]) -> str:
    return f"{sum(r['success'] for r in rows)} / {len(rows)}" if rows else "-"


def _causes(result: ExperimentResult) -> str:
    failed = Counter(r["cause"] for r in result.rows if r["policy"] == OURS and not r["success"])
    if not failed:
        return ""
    return "\n".join(["Failures of ours by cause:", "", *(f"- {cause}: {n}" for cause, n in failed.most_common())])
