"""What is measured of runs of the experiment navigation: scores, differences between policies, causes of failures."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from shmoo_mjx.evaluation.paired import difference_metrics
from shmoo_mjx.evaluation.scenarios import KINDS, Generated

__all__ = [
    "COMPARED",
    "OURS",
    "cause_of",
    "effort_by_force",
    "effort_by_mass",
    "interactive_score",
    "measure",
]

OURS = "ours"
COMPARED = {
    "success": True,
    "time_s": False,
    "efficiency": True,
    "effort": True,
    "effort_force": True,
    "ins": True,
}
"""What policies are compared by, scenario by scenario, and whether more of it is better."""
_GRAVITY = 9.81


def effort_by_mass(robot_mass: float, driven: float, masses: list[float], moved: list[float]) -> float:
    """m0 l0 / (m0 l0 + sum m_i l_i): 1 if nothing was moved (Interactive Gibson, kinematic; Bench-NPIN)."""
    own = robot_mass * driven
    return float(own / max(own + float(np.dot(masses, moved)), 1e-9)) if driven > 0 else 1.0


def effort_by_force(robot_mass: float, force: np.ndarray) -> float:
    """G T / (G T + sum |F_t| dt), G the robot's weight: 1 if it pushed nothing (Interactive Gibson, dynamic).

    Args:
        robot_mass: [kg].
        force: ``[T, 2]`` of the hands on objects, in equal steps of time [N].
    """
    own = robot_mass * _GRAVITY * len(force)
    return float(own / (own + np.linalg.norm(force, axis=1).sum())) if len(force) else 1.0


def interactive_score(efficiency: float, by_mass: float, by_force: float) -> float:
    """The interactive navigation score INS_0.5: half path, half effort efficiency (the mean of its parts)."""
    return 0.5 * efficiency + 0.25 * (by_mass + by_force)


def cause_of(result: dict[str, Any], generated: Generated) -> str:
    """Why a run failed, in a few words that failures can be sorted by; empty for a success."""
    outcome = result["outcome"]
    if outcome == "success":
        return ""
    if outcome == "wall contact":
        parts = sorted(p for p, count in result.get("wall_parts", {}).items() if count)
        return outcome + (f": {', '.join(parts)}" if parts else "")
    if outcome == "fall":
        return outcome
    wrong = _wrong_verdict(result, generated)
    if outcome == "timeout":
        state = result["reason"].rpartition("state ")[2]
        return f"out of time while to {state}" + (f", and {wrong}" if wrong else "")
    if wrong:
        return wrong
    states = [o["status"] for o in result["objects"]]
    if any(s == "fixed" and m for s, m in zip(states, generated.movable, strict=True)):
        return "a movable object was given up"
    if "parked" in states:
        return "an object was left where it blocks the way"
    return "no way found past objects that can't be moved"


def _wrong_verdict(result: dict[str, Any], generated: Generated) -> str:
    """The first wrong verdict that still held at the end: the last one on its object."""
    last = {d["object"]: d["manipulable"] for d in result["decisions"]}
    for number, decided in sorted(last.items()):
        given_up = result["objects"][number]["status"] == "fixed"
        if generated.movable[number] and not decided and given_up:
            return "a movable object was judged immovable"
        if decided and not generated.movable[number] and not given_up:
            return "an immovable object was judged movable"
    return ""


def measure(rows: list[dict[str, Any]], policies: tuple[str, ...]) -> dict[str, Any]:
    """Metrics of every policy, ours without a prefix, and of ours - each other one on the scenarios that both ran.

    ``baseline_NAME_*`` is what policy NAME reaches; ``difference_NAME_METRIC`` with ``_low``, ``_high`` and ``_pairs``
    the mean difference with its 95 % interval and the number of scenarios, for time those that both solve.
    """
    metrics: dict[str, Any] = {}
    of = {policy: {(r["map"], r["scenario"]): r for r in rows if r["policy"] == policy} for policy in policies}
    for policy in policies:
        prefix = "" if policy == OURS else f"baseline_{policy}_"
        metrics |= {prefix + name: value for name, value in _of_policy(list(of[policy].values())).items()}
        if policy != OURS and OURS in of:
            metrics |= _differences(policy, of[OURS], of[policy])
    if {OURS, "oracle"} <= set(of):
        metrics["time_over_oracle"] = _time_ratio(of[OURS], of["oracle"])
    return metrics | _what_neither_can(of) | _of_scenarios(rows)


def _of_policy(rows: list[dict[str, Any]]) -> dict[str, Any]:
    def mean(name: str, of: list[dict[str, Any]]) -> float | None:
        return float(np.mean([r[name] for r in of])) if of else None

    good = [r for r in rows if r["success"]]
    metrics = {"success_rate": mean("success", rows)}
    for kind in KINDS:
        metrics[f"success_rate_{_key(kind)}"] = mean("success", [r for r in rows if r["kind"] == kind])
    for name, near in (("border", True), ("clear", False)):
        metrics[f"success_rate_{name}"] = mean("success", [r for r in rows if r["border"] is near])
    contacts = mean("wall_contacts", rows)
    return metrics | {
        "falls": sum(r["falls"] for r in rows),
        "wall_contacts": sum(r["wall_contacts"] for r in rows),
        "wall_contacts_per_100": None if contacts is None else 100.0 * contacts,
        "time_s": mean("time_s", good),
        "path_length_m": mean("path_length_m", good),
        "displacement_m": mean("displacement_m", rows),
        "efficiency": mean("efficiency", rows),
        "effort": mean("effort", rows),
        "effort_force": mean("effort_force", rows),
        "ins": mean("ins", rows),
        "scenarios": len(rows),
    }


def _differences(policy: str, ours: dict[Any, Any], theirs: dict[Any, Any]) -> dict[str, Any]:
    both = [(ours[key], theirs[key]) for key in ours if key in theirs]
    solved = [(a, b) for a, b in both if a["success"] and b["success"]]
    metrics: dict[str, Any] = {}
    for name in COMPARED:
        pairs = solved if name == "time_s" else both
        key = f"difference_{policy}_{name}"
        metrics |= difference_metrics(key, [a[name] for a, _ in pairs], [b[name] for _, b in pairs])
    return metrics


def _time_ratio(ours: dict[Any, Any], oracle: dict[Any, Any]) -> float | None:
    """Time of ours over that of the oracle, on the scenarios that both solve."""
    both = [key for key in ours if key in oracle and ours[key]["success"] and oracle[key]["success"]]
    return sum(ours[k]["time_s"] for k in both) / sum(oracle[k]["time_s"] for k in both) if both else None


def _what_neither_can(of: dict[str, dict[Any, Any]]) -> dict[str, int]:
    """Scenarios that neither simple policy can do, and those of them that we can."""
    simple = [of[p] for p in ("always_avoid", "always_push") if of.get(p)]
    if len(simple) < 2:
        return {}
    compared = set(simple[0]) & set(simple[1])
    neither = {key for key in compared if not any(p[key]["success"] for p in simple)}
    ours = {key for key, row in of.get(OURS, {}).items() if row["success"]}
    return {"neither_baseline": len(neither), "neither_baseline_but_ours": len(neither & ours)}


def _of_scenarios(rows: list[dict[str, Any]]) -> dict[str, int]:
    """How many scenarios there are of each kind, by map as well, and with how many objects."""
    scenarios = list({(r["map"], r["scenario"]): r for r in rows}.values())
    metrics = {"scenarios_border": sum(r["border"] for r in scenarios)}
    for kind in KINDS:
        metrics[f"scenarios_{_key(kind)}"] = sum(r["kind"] == kind for r in scenarios)
        for name in sorted({r["map"] for r in scenarios}):
            here = [r for r in scenarios if r["map"] == name]
            metrics[f"scenarios_{_key(kind)}_{name}"] = sum(r["kind"] == kind for r in here)
            metrics[f"wanted_{_key(kind)}_{name}"] = sum(r["wanted"] == kind for r in here)
    for name, key in (("objects", "movable"), ("objects_in_the_way", "blocking")):
        counts = Counter(sum(r["blocking"]) if key == "blocking" else len(r["movable"]) for r in scenarios)
        metrics |= {f"scenarios_with_{n}_{name}": counts[n] for n in sorted(counts)}
    return metrics


def _key(kind: str) -> str:
    return kind.replace(" ", "_")
