"""Names and sentences of the report and the film, from ``result.json``."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from shmoo_mjx.report.trace import is_number, object_index

_SUCCESS = ("success", "reached", "goal_reached", "goal reached", "done")
_WITH_OBJECT = ("approach", "make contact", "probe", "push")
"""Modes in which the robot deals with an object."""
_MOVED = 0.05
"""Distance from which on an object counts as moved [m]."""
OBSTACLE = "registered as an obstacle"
"""Words with which the navigator reports that it gives an object up."""
GO_ROUND = "go round"
"""Text of the option that pushes nothing."""
_NO_OBSTACLE = (f"{OBSTACLE}, is looked at again", "somebody has moved it")
"""Words with which the navigator reports that an object counts as unknown again."""


def object_name(result: dict[str, Any], name: Any) -> str:
    """Name of the object whose ``id`` is ``name``: its family, with a number if there are several of that family."""
    index = object_index(result, name)
    if index is None:
        return f"object {name}"
    families = [item["family"] for item in result["objects"]]
    family = str(families[index])
    return family if families.count(family) == 1 else f"{family} {families[: index + 1].count(family)}"


def the_object(result: dict[str, Any], name: Any) -> str:
    """The object's name in a sentence: "the box", or "box 2" if there are several boxes."""
    plain = object_name(result, name)
    index = object_index(result, name)
    return f"the {plain}" if index is not None and plain == str(result["objects"][index]["family"]) else plain


def by_name(result: dict[str, Any], text: Any) -> str:
    """A reason of the navigator with the objects' names in place of "object 0"."""
    named = re.sub(r"\bobject (\d+)", lambda match: the_object(result, int(match[1])), str(text))
    if result.get("push_to") is not None:
        named = re.sub(r"\bthe object\b", the_object(result, result["objects"][0]["id"]), named)
    return re.sub(r"(\d)%", "\\1\N{NO-BREAK SPACE}%", named.replace(f"; {OBSTACLE}", "; it now counts as an obstacle"))


def percent(probability: float) -> str:
    """A probability in whole per cent."""
    return f"{probability:.0%}".replace("%", "\N{NO-BREAK SPACE}%")


def evidence(decision: dict[str, Any]) -> str:
    """The evidence for a decision: the probability, or the paper's criterion K if there is no probability."""
    return percent(decision["probability"]) if is_number(decision.get("probability")) else f"K = {decision['K']:.2f} m²"


def succeeded(result: dict[str, Any]) -> bool:
    """True if the outcome is one of the words for success."""
    return str(result["outcome"]).lower() in _SUCCESS


def moved(item: dict[str, Any]) -> float:
    """Distance between an object's first and last position [m]."""
    start, final = np.asarray(item["start_pose"], dtype=float), np.asarray(item["final_pose"], dtype=float)
    return float(np.linalg.norm(final[:2] - start[:2]))


def registered_at(result: dict[str, Any], name: Any, t: float) -> bool:
    """Whether the object whose ``id`` is ``name`` counts as an obstacle at time ``t`` [s].

    The navigator says when it gives an object up and when it looks at it again. A result without these words has only
    the state at the end. The object then counts as an obstacle from the decision on after which none calls it movable.
    """
    index = object_index(result, name)
    told = [(step["t"], str(step.get("reason"))) for step in result["transitions"]]
    told += [(event["t"], str(event["what"])) for event in result.get("events", ())]
    about = re.compile(rf"\bobject {re.escape(str(name))}\b")
    mine = sorted((time, text) for time, text in told if about.search(text))
    changes = [
        (time, not any(words in text for words in _NO_OBSTACLE))
        for time, text in mine
        if OBSTACLE in text or any(words in text for words in _NO_OBSTACLE)
    ]
    if any(on for _, on in changes):
        return next((on for time, on in reversed(changes) if time <= t + 1e-6), False)
    if index is None or not result["objects"][index].get("registered"):
        return False
    since = -np.inf
    for decision in reversed([d for d in result["decisions"] if d["object"] == name]):
        if decision["manipulable"]:
            break
        since = float(decision["t"])
    return t + 1e-6 >= since


def belief_at(result: dict[str, Any], name: Any, t: float) -> str:
    """What the robot believes at time ``t`` [s] about whether it can move the object whose ``id`` is ``name``."""
    if registered_at(result, name, t):
        return "can't be moved"
    past = [d for d in result["decisions"] if d["object"] == name and float(d["t"]) <= t + 1e-6]
    if not past:
        return ""
    last = past[-1]
    if is_number(last.get("probability")):
        return f"{percent(last['probability'])} sure it moves"
    if is_number(last.get("K")):
        return "can be moved" if last["manipulable"] else "can't be moved"
    return ""


def caption_at(result: dict[str, Any], t: float) -> tuple[str, str]:
    """Caption (what the robot does, why) at time ``t`` [s]."""
    past = [step for step in result["transitions"] if float(step["t"]) <= t + 1e-6]
    if not past and result["transitions"]:
        past = [{"to": result["transitions"][0]["from"], "reason": ""}]
    if not past:
        return "", ""
    mode, why = str(past[-1]["to"]).replace("_", " "), by_name(result, past[-1].get("reason") or "")
    object_ = _object_in_hand(result, past)
    what = "the object" if object_ is None else the_object(result, object_)
    sure = "" if object_ is None else belief_at(result, object_, t)
    pushing = result.get("push_to") is not None
    does = {
        "follow path": "drives to the goal",
        "approach": f"drives up to {what}",
        "make contact": f"reaches for {what}",
        "probe": f"pushes {what} for a second, to feel how it moves",
        "push": f"pushes {what} to its goal" if pushing else f"pushes {what} aside",
        "retreat": f"backs away from {what}",
        "replan": f"looks at {what}" if pushing else "looks for a path",
        "done": f"has brought {what} to its goal" if pushing else "has reached the goal",
        "failed": "gives up",
    }.get(mode, mode)
    if mode in ("push", "approach") and sure and not pushing:
        does += f": {sure}"
    if mode in _WITH_OBJECT and not pushing:
        past = [d for d in result["decisions"] if d["object"] == object_ and float(d["t"]) <= t + 1e-6]
        why = options_text(past[-1]) if past and past[-1].get("options") else why
    return does, re.sub(r"^path of ([\d.]+) m found$", r"along a path of \1 m", why)


def options_text(decision: dict[str, Any]) -> str:
    """The options of a decision with the expected time of each."""
    options = decision["options"]
    # Without a way round the mean contains the assumed cost of giving up, which says little.
    time = "mean_s" if any(option["text"] == GO_ROUND for option in options) else "works_s"
    told = ", ".join(f"{option['text']} {option[time]:.0f} s" for option in options)
    return f"expected time to the goal: {told}{'' if time == 'mean_s' else ' if it works; there is no way round'}"


def _object_in_hand(result: dict[str, Any], transitions: list[dict[str, Any]]) -> Any:
    """The ``id`` of the object that the last of ``transitions`` is about, or None."""
    if result.get("push_to") is not None and result["objects"]:
        return result["objects"][0]["id"]
    for step in reversed(transitions):
        if found := re.search(r"\bobject (\d+)", str(step.get("reason"))):
            return int(found[1])
        named = [item["id"] for item in result["objects"] if str(item["id"]) in str(step.get("reason")).split()]
        if named:
            return named[0]
    return None


def summary(result: dict[str, Any]) -> str:
    """Summary of the run in one paragraph."""
    pushed = result.get("push_to") is not None
    what = the_object(result, result["objects"][0]["id"]) if pushed else ""
    took = f"{result['time_s']:.0f} s" if is_number(result.get("time_s")) else ""
    if succeeded(result):
        first = f"The robot brought {what} to its goal" if pushed else "The robot reached the goal"
        first += f" in {took}." if took else "."
    else:
        why = by_name(result, result.get("reason") or result["outcome"]).replace("_", " ").rstrip(".")
        goal = f"did not bring {what} to its goal" if pushed else "did not reach the goal"
        first = f"The robot {goal}: {why}."
    sentences = [first, *(_object_sentence(result, item) for item in result["objects"])]
    drove = []
    if is_number(result.get("path_length_m")):
        drove.append(f"drove {result['path_length_m']:.1f} m")
    if is_number(result.get("goal_distance_m")):
        left = f"left {what}" if pushed else "stopped"
        drove.append(f"{left} {result['goal_distance_m']:.2f} m from the goal")
    if drove:
        sentences.append(f"The robot {' and '.join(drove)}{'' if succeeded(result) or not took else f', in {took}'}.")
    falls, contacts = result.get("falls"), result.get("wall_contacts")
    if is_number(falls) and is_number(contacts):
        sentences.append(f"It {_times('fell', falls)} and {_times('touched a wall', contacts)}.")
    return " ".join(sentence for sentence in sentences if sentence)


def _object_sentence(result: dict[str, Any], item: dict[str, Any]) -> str:
    what = the_object(result, item["id"])
    mine = [d for d in result["decisions"] if d["object"] == item["id"]]
    chances = [d["probability"] for d in mine if is_number(d.get("probability"))]
    by_k = [d["K"] for d in mine if is_number(d.get("K"))]
    if item.get("toppled"):
        return f"It knocked {what} over."
    if item.get("registered"):
        told = f" (criterion K = {by_k[-1]:.2f} m²)" if by_k and not chances else ""
        told = f": it gave a push a {percent(chances[-1])} chance" if chances else told
        return f"It concluded that {what} can't be moved{told}, and treated it as an obstacle."
    if moved(item) <= _MOVED and not mine and result.get("push_to") is None:
        return f"It made no decision about {what}, which never stood in its way."
    if moved(item) <= _MOVED:
        told = f": it estimated a {percent(chances[-1])} chance that it can be moved out of the way" if chances else ""
        return f"It left {what} where it was{told}."
    if result.get("push_to") is not None:
        return ""
    pushed = f"It pushed {what} {moved(item):.1f} m out of its way"
    if chances and len(chances) > 1:
        return (
            f"{pushed}. Before the push it estimated a {percent(chances[0])} chance that {what} can be moved out of "
            f"the way, at its end {percent(chances[-1])}."
        )
    if chances:
        return f"{pushed}. It estimated a {percent(chances[0])} chance that {what} can be moved out of the way."
    return f"{pushed} (criterion K = {by_k[0]:.2f} m²)." if by_k else f"{pushed}."


def _times(verb: str, count: Any) -> str:
    words = {0: f"never {verb}", 1: f"{verb} once", 2: f"{verb} twice"}
    return words.get(int(count), f"{verb} {count:.0f} times")
