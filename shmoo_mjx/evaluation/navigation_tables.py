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


def reference_table(result: ExperimentResult) -> str:
    """Every policy against the certificates of the scenarios, a row per policy; empty where there are none."""
    metrics, lines = result.metrics, []
    for policy in result.config.get("policies", []):
        prefix = "" if policy == OURS else f"baseline_{policy}_"
        if metrics.get(f"{prefix}certified") is None:
            continue

        def shown(name: str, form: str, prefix: str = prefix) -> str:
            value = metrics.get(prefix + name)
            return "-" if value is None else format(value, form)

        difference = [metrics.get(f"difference_{policy}_regret_s{end}") for end in ("", "_low", "_high")]
        mean, low, high = difference
        versus = "" if mean is None or low is None or high is None else f"{mean:+.1f} ({low:.1f} to {high:.1f})"
        regrets = [shown(f"regret_s_{band}", ".1f") for band in EXTRA_BANDS]
        called = f"{shown('unsolvable_called_blocked', '.0f')} / {shown('unsolvable', '.0f')}"
        row = [shown_name(policy), shown("success_rate_certified", ".2f"), shown("regret_s", ".1f")]
        row += [shown("regret_s_median", ".1f"), *regrets, shown("right_first_choice", ".2f"), called]
        row += [shown("falls", ".0f"), shown("wall_contacts", ".0f"), shown("ins", ".2f"), versus]
        lines.append(row)
    if not lines:
        return ""
    prefix = "" if "certified" in metrics else next(k for k in metrics if k.endswith("_certified"))[: -len("certified")]
    counts = [f"{metrics.get(f'{prefix}certified_{band}') or 0:.0f}" for band in EXTRA_BANDS]
    head = ["policy", "success", "regret [s]", "median", "to 5 m", "5 to 15 m", "over 15 m", "no way round"]
    head += ["right first choice", "said blocked", "falls", "wall contacts", "score", "regret of ours minus it [s]"]
    return (
        f"Policies against the certificates: {metrics.get(f'{prefix}certified') or 0:.0f} scenarios that can be "
        f"solved, {', '.join(counts)} of them in the four columns by extra length of the way round. Regret is the time "
        f"minus that of the best certified option (mean {metrics.get(f'{prefix}reference_s') or 0:.1f} s); a failure "
        f"counts {FAILURE_S:.0f} s. A first choice is right if the best option that begins so is within {TIE_S:.0f} s "
        "of the best. Said blocked: of the scenarios that no option solves.\n\n"
    ) + markdown_table(head, lines)


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
