"""Metrics of navigation runs: scores, differences between policies, and causes of failures."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from shmoo_mjx.evaluation.paired import OURS, difference_metrics, metrics_by_method
from shmoo_mjx.evaluation.scenarios import KINDS, Generated
from shmoo_mjx.geometry import se2
from shmoo_mjx.geometry.hands import CONTACT_FORCE

COMPARED = {
    "success": ("Success rate", True),
    "time_s": ("Time, of scenarios that both solve [s]", False),
    "efficiency": ("Path efficiency", True),
    "effort": ("Effort efficiency, by mass moved", True),
    "effort_force": ("Effort efficiency, by force", True),
    "ins": ("Interactive navigation score", True),
    "regret_s": ("Time lost [s]", False),
}
"""Measures by which policies are compared: label, and whether a larger value is better."""
FAILURE_S = 120.0
"""Regret of a failed run [s]."""
TIE_S = 3.0
"""Maximum excess of a right first choice over the reference time [s]."""
EXTRA_BANDS = {"to_5m": (0.0, 5.0), "to_15m": (5.0, 15.0), "over_15m": (15.0, 1e3), "no_way_round": None}
"""Ranges of the extra length of the way round [m]."""
_GRAVITY = 9.81


def effort_by_mass(robot_mass: float, driven: float, masses: list[float], moved: list[float]) -> float:
    """Effort efficiency m0 l0 / (m0 l0 + sum m_i l_i): 1 if nothing was moved (Interactive Gibson, Bench-NPIN).

    Args:
        robot_mass: mass m0 of the robot [kg].
        driven: length l0 of the robot's path [m].
        masses: mass m_i of each object [kg].
        moved: distance l_i that each object was moved [m].
    """
    own = robot_mass * driven
    return float(own / max(own + float(np.dot(masses, moved)), 1e-9)) if driven > 0 else 1.0


def effort_by_force(robot_mass: float, force: np.ndarray) -> float:
    """Effort efficiency G T / (G T + sum |F_t| dt) with the robot's weight G: 1 if it pushed nothing.

    Args:
        robot_mass: mass of the robot [kg].
        force: ``[T, 2]`` force of the hands on objects in equal time steps [N].
    """
    own = robot_mass * _GRAVITY * len(force)
    return float(own / (own + np.linalg.norm(force, axis=1).sum())) if len(force) else 1.0


def interactive_score(efficiency: float, by_mass: float, by_force: float) -> float:
    """Interactive navigation score INS_0.5: half path efficiency, half effort efficiency (the mean by mass and force).

    Args:
        efficiency: path efficiency.
        by_mass: effort efficiency by mass moved.
        by_force: effort efficiency by force.
    """
    return 0.5 * efficiency + 0.25 * (by_mass + by_force)


def choice_of(result: dict[str, Any], trace: Any, generated: Generated) -> dict[str, Any]:
    """Compare a run with the certificate. All values are None if there is no certificate or no option works.

    Returns:
        ``reference_s``: time of the fastest option [s]. ``regret_s``: time of the run minus the reference, or
            `FAILURE_S` for a failure [s].
        ``first_choice``: the object that was touched first, None if none was. ``right_choice``: whether the fastest
            certified option with this first choice is within `TIE_S` of the reference.
    """
    told = generated.certificate
    if told is None or told.reference_s is None:
        return dict.fromkeys(("reference_s", "regret_s", "first_choice", "right_choice"))
    success = result["outcome"] == "success"
    first = _touched_first(trace, [item["half_extents"] for item in result["objects"]])
    return {
        "reference_s": told.reference_s,
        "regret_s": result["time_s"] - told.reference_s if success else FAILURE_S,
        "first_choice": first,
        "right_choice": told.options().get(first, np.inf) <= told.reference_s + TIE_S,
    }


def _touched_first(trace: Any, half_extents: list[Any]) -> int | None:
    """The object nearest to the robot at the first contact of its hands; None without a contact."""
    felt = np.flatnonzero(np.linalg.norm(np.asarray(trace.force), axis=1) > CONTACT_FORCE)
    if not felt.size:
        return None
    robot, objects = trace.robot_pose[felt[0]], trace.object_pose[felt[0]]
    local = np.abs(se2.inverse_transform_point(objects, robot[None, :2]))
    return int(np.argmin(np.linalg.norm(np.maximum(local - np.array(half_extents), 0.0), axis=1)))


def cause_of(result: dict[str, Any], generated: Generated) -> str:
    """The cause of a failure in a few words; empty for a success."""
    outcome = result["outcome"]
    if outcome == "success":
        return ""
    if outcome == "wall contact":
        parts = sorted(p for p, count in result.get("wall_parts", {}).items() if count)
        return outcome + (f": {', '.join(parts)}" if parts else "")
    if outcome in ("fall", "diverged"):
        return outcome
    wrong = _wrong_verdict(result, generated)
    if outcome == "timeout":
        state = result["reason"].rpartition("state ")[2]
        return f"out of time in state {state}" + (f", and {wrong}" if wrong else "")
    if wrong:
        return wrong
    states = [o["status"] for o in result["objects"]]
    if any(s == "fixed" and m for s, m in zip(states, generated.movable, strict=True)):
        return "a movable object was given up"
    if "parked" in states:
        return "an object was left where it blocks the way"
    return "no way found past objects that can't be moved"


def _wrong_verdict(result: dict[str, Any], generated: Generated) -> str:
    """The first wrong decision among the last decisions on each object; empty if all are right."""
    last = {d["object"]: d["manipulable"] for d in result["decisions"]}
    for number, decided in sorted(last.items()):
        given_up = result["objects"][number]["status"] == "fixed"
        if generated.movable[number] and not decided and given_up:
            return "a movable object was judged immovable"
        if decided and not generated.movable[number] and not given_up:
            return "an immovable object was judged movable"
    return ""


def measure(rows: list[dict[str, Any]], policies: tuple[str, ...]) -> dict[str, Any]:
    """Metrics of all policies, and differences between ours and each other policy.

    ``baseline_NAME_*`` are the metrics of policy NAME. Ours have no prefix. ``difference_NAME_METRIC`` is the mean
    difference over the scenarios that both policies ran. ``_low`` and ``_high`` are its 95 % interval, and ``_pairs``
    is the number of scenarios. Times are compared on scenarios that both policies solve.
    """
    of = {policy: {(r["map"], r["scenario"]): r for r in rows if r["policy"] == policy} for policy in policies}
    metrics = metrics_by_method(of, _of_policy, _differences)
    if {OURS, "oracle"} <= set(of):
        metrics["time_over_oracle"] = _time_ratio(of[OURS], of["oracle"])
    return metrics | _what_neither_can(of) | _of_scenarios(rows)


def _of_policy(rows: list[dict[str, Any]]) -> dict[str, Any]:
    def mean(name: str, of: list[dict[str, Any]]) -> float | None:
        return float(np.mean([r[name] for r in of])) if of else None

    good = [r for r in rows if r["success"]]
    parts = {_key(kind): [r for r in rows if r["kind"] == kind] for kind in KINDS}
    metrics = {"success_rate": mean("success", rows)}
    metrics |= {f"success_rate_{name}": mean("success", of) for name, of in parts.items()}
    contacts = mean("wall_contacts", rows)
    return {
        **metrics,
        "falls": sum(r["falls"] for r in rows),
        "toppled": sum(r["toppled"] for r in rows),
        "wall_contacts": sum(r["wall_contacts"] for r in rows),
        "wall_contacts_per_100": None if contacts is None else 100.0 * contacts,
        **{name: mean(name, good) for name in ("time_s", "path_length_m")},
        **{name: mean(name, rows) for name in ("displacement_m", "efficiency", "effort", "effort_force", "ins")},
        "scenarios": len(rows),
        **_against_reference(rows),
    }


def _against_reference(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Metrics of a policy relative to the certificates; empty if no scenario has one."""
    certified = [r for r in rows if r.get("reference_s") is not None]
    if not certified:
        return {}
    unsolvable = [r for r in rows if r["kind"] == "unsolvable"]
    regret = [r["regret_s"] for r in certified]
    metrics = {
        "certified": len(certified),
        "success_rate_certified": float(np.mean([r["success"] for r in certified])),
        "reference_s": float(np.mean([r["reference_s"] for r in certified])),
        "regret_s": float(np.mean(regret)),
        "regret_s_median": float(np.median(regret)),
        "right_first_choice": float(np.mean([r["right_choice"] for r in certified])),
        "unsolvable": len(unsolvable),
        "unsolvable_called_blocked": sum(r["outcome"] == "blocked" for r in unsolvable),
    }
    for name, band in EXTRA_BANDS.items():
        here = [r["regret_s"] for r in certified if in_band(r["extra_m"], band)]
        metrics |= {f"regret_s_{name}": float(np.mean(here)) if here else None, f"certified_{name}": len(here)}
    return metrics


def in_band(extra: float | None, band: tuple[float, float] | None) -> bool:
    """Whether the extra length of a way round lies in one of `EXTRA_BANDS`."""
    return extra is None if band is None else extra is not None and band[0] <= extra < band[1]


def _differences(policy: str, pairs: list[tuple[dict[str, Any], dict[str, Any]]]) -> dict[str, Any]:
    solved = [(a, b) for a, b in pairs if a["success"] and b["success"]]
    metrics: dict[str, Any] = {}
    certified = [(a, b) for a, b in pairs if a.get("regret_s") is not None and b.get("regret_s") is not None]
    chosen = {"time_s": solved, "regret_s": certified}
    for name in COMPARED:
        metrics |= difference_metrics(f"difference_{policy}_{name}", name, chosen.get(name, pairs))
    return metrics


def _time_ratio(ours: dict[Any, Any], oracle: dict[Any, Any]) -> float | None:
    """Time of ours over that of the oracle, on the scenarios that both solve."""
    both = [key for key in ours if key in oracle and ours[key]["success"] and oracle[key]["success"]]
    return sum(ours[k]["time_s"] for k in both) / sum(oracle[k]["time_s"] for k in both) if both else None


def _what_neither_can(of: dict[str, dict[Any, Any]]) -> dict[str, int]:
    """Number of scenarios that neither always_avoid nor always_push solves, and how many of them ours solves."""
    simple = [of[p] for p in ("always_avoid", "always_push") if of.get(p)]
    if len(simple) < 2:
        return {}
    compared = set(simple[0]) & set(simple[1])
    neither = {key for key in compared if not any(p[key]["success"] for p in simple)}
    ours = {key for key, row in of.get(OURS, {}).items() if row["success"]}
    return {"neither_baseline": len(neither), "neither_baseline_but_ours": len(neither & ours)}


def _of_scenarios(rows: list[dict[str, Any]]) -> dict[str, int]:
    """Number of scenarios of each kind, and by number of objects."""
    scenarios = list({(r["map"], r["scenario"]): r for r in rows}.values())
    metrics = dict[str, int]()
    for kind in KINDS:
        metrics[f"scenarios_{_key(kind)}"] = sum(r["kind"] == kind for r in scenarios)
    for name, key in (("objects", "movable"), ("objects_in_the_way", "blocking")):
        counts = Counter(sum(r["blocking"]) if key == "blocking" else len(r["movable"]) for r in scenarios)
        metrics |= {f"scenarios_with_{n}_{name}": counts[n] for n in sorted(counts)}
    return metrics


def _key(kind: str) -> str:
    return kind.replace(" ", "_")
