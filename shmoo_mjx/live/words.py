"""Texts of the live page about a session, as Markdown."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from shmoo_mjx.behavior.path_decisions import first_block
from shmoo_mjx.behavior.routes import PACE
from shmoo_mjx.behavior.state import Decision, Mode, Option
from shmoo_mjx.learning import online
from shmoo_mjx.live.session import Session
from shmoo_mjx.planning.paths import project
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.observe import DIVERGED
from shmoo_mjx.types import DT

_DOES = {
    Mode.REPLAN: "plans a path",
    Mode.FOLLOW: "drives to the goal",
    Mode.APPROACH: "drives up to {}",
    Mode.CONTACT: "reaches for {}",
    Mode.PROBE: "starts to push {}",
    Mode.PUSH: "pushes {}",
    Mode.RETREAT: "backs away from {}",
    Mode.DONE: "is at the goal",
    Mode.FAILED: "has given up",
}
"""What the robot does in each mode; {} is the object."""
_THEN = {
    Mode.APPROACH: "push {}",
    Mode.CONTACT: "push {}",
    Mode.PROBE: "push on, or take a quicker option",
    Mode.PUSH: "push until the path is free, then drive to the goal",
    Mode.RETREAT: "plan a path to the goal",
}
"""What it does next in each mode."""
_MOVABLE = {None: "not pushed yet", True: "movable", False: "immovable"}
_SHOWN = 5
"""Number of options in the table."""


def state_text(session: Session) -> str:
    """What the robot does, why, and what it does next with the expected time of every option."""
    simulation, navigator = session.simulation, session.simulation.navigator
    heading = f"The robot {_with_object(session, _DOES[navigator.mode])}"
    reason = navigator.transitions[-1].reason if navigator.transitions else "it looks for a path"
    if simulation.history.ended:
        heading, reason = "The run is over", DIVERGED if simulation.history.diverged else "the robot has fallen"
        return f"### {heading}\n{reason}. Restart it."
    # The table below shows what a reason quotes from a decision.
    for decision in navigator.decisions[-3:]:
        if decision.options:
            reason = reason.removesuffix(decision.reason).rstrip(": ")
    told = "" if re.fullmatch(r"object \d+", reason) else f"\n{_capital(with_names(session, reason))}."
    parts = [f"### {heading}{told}"]
    if following := next_step(session):
        parts.append(f"**Next:** {following}.")
    if last := current_decision(session):
        parts.append(_options_table(session, last))
    return "\n\n".join(parts)


def numbers_text(session: Session) -> str:
    """Time, lean, force, senses, and computing time of control steps."""
    true, spent = session.simulation.true, 1e3 * np.array(session.spent or [0.0])
    lean = float(np.rad2deg(np.linalg.norm(true.lean[0])))
    return (
        f"{session.simulation.time:.1f} s, lean {lean:.1f}°, force {session.force:.0f} N, senses {session.senses.name}."
        " "
        f"Control step: median {np.median(spent):.0f} ms, longest {spent.max():.0f} ms of the last {len(spent)}; "
        f"{session.late} longer than {1e3 * DT:.0f} ms."
    )


def past_text(session: Session, row: int) -> str:
    """What the robot did in the sample ``row`` of the history."""
    sample = session.simulation.history.rows[row]
    mode = list(Mode)[sample.state]
    return f"### Looking back to {sample.t:.1f} s\nMode: {mode}. Lines and numbers below are those of the present."


def next_step(session: Session) -> str:
    """What the robot intends to do after its current action; empty if nothing."""
    navigator, obs = session.simulation.navigator, session.simulation.observation
    state = navigator.state
    if state.mode is not Mode.FOLLOW or state.path is None:
        return _with_object(session, _THEN.get(state.mode, ""))
    left = state.path.length - project(state.path, obs.robot_pose[0, :2])
    drive = f"{left:.1f} m to the goal, about {left / PACE:.0f} s"
    blocked = first_block(navigator.setup, state, obs)
    if blocked is None:
        return drive
    name = object_name(blocked[0], session.simulation.conditions[blocked[0]])
    decision = current_decision(session)
    best = ""
    if decision is not None and decision.object == blocked[0] and decision.options:
        best = f": {_chosen(decision).text}, unless it learns more until then"
    return f"{name} blocks the path in {max(blocked[1], 0.0):.1f} m{best}"


def current_decision(session: Session) -> Decision | None:
    """The last decision that compared options on the way to the current goal; None before, and after the arrival."""
    navigator = session.simulation.navigator
    if navigator.finished or not navigator.decisions:
        return None
    last: Decision = navigator.decisions[-1]
    return last if last.options and last.t >= session.goal_since else None


def _chosen(decision: Decision) -> Option:
    """The option that a decision takes."""
    return min(decision.options, key=lambda option: option.seconds)


def _options_table(session: Session, decision: Decision) -> str:
    """The options of a decision with their expected times; the chosen one is bold."""
    chosen, name = _chosen(decision), object_name(decision.object, session.simulation.conditions[decision.object])
    detour = any(option.text == "go round" for option in decision.options)
    # Without a detour the mean contains the assumed cost of giving up, which says little.
    rows = [f"| option for {name} | works | {'expected' if detour else 'time if it works'} |", "|:---|---:|---:|"]
    ranked = sorted(decision.options, key=lambda option: option.seconds)
    for option in ranked[:_SHOWN]:
        mark = "**" if option is chosen else ""
        seconds = option.seconds if detour else option.works
        rows.append(f"| {mark}{option.text}{mark} | {option.probability:.0%} | {seconds:.0f} s |")
    end = "" if detour else " There is no way round."
    return "\n".join(rows) + f"\n\nTimes to the goal, as estimated at {decision.t:.1f} s.{end}"


def beliefs(session: Session) -> str:
    """The robot's estimate of each object and the truth, as a list, because a table would be too wide for a phone."""
    navigator, lines = session.simulation.navigator, list[str]()
    for index, condition in enumerate(session.simulation.conditions):
        name, item = object_name(index, condition), navigator.belief.objects.get(index)
        if item is None:
            lines.append(f"- **{name}**: not seen yet")
            continue
        chances = [d.probability for d in navigator.decisions if d.object == index and d.probability is not None]
        moves = _MOVABLE[item.manipulable]
        if chances and item.manipulable is not None:
            moves += f" (the push frees the path: {chances[-1]:.0%})"
        status = {"unknown": "", "parked": "pushed aside; ", "fixed": "registered as an obstacle; "}[str(item.status)]
        parts = [f"{status}{moves}"]
        if item.adapt is not None:
            parts.append(_in_words(online.summary(item.adapt), session.true_values(index)))
        lines.append(f"- **{name}**: {'. '.join(parts)}")
    return "\n".join(["**Estimates** (80 % interval)", "", *lines]) if lines else ""


def object_name(index: int, condition: Condition) -> str:
    """Name of an object on the page: its family and index."""
    return f"{Path(condition.family).stem} {index}"


def object_index(name: str) -> int | None:
    """The index at the end of an object's name; None for "none"."""
    number = name.rpartition(" ")[2]
    return int(number) if number.isdigit() else None


def with_names(session: Session, text: str) -> str:
    """``text`` with the name of each object in place of "object INDEX"."""
    conditions = session.simulation.conditions

    def name(match: re.Match[str]) -> str:
        index = int(match[1])
        return object_name(index, conditions[index]) if index < len(conditions) else match[0]

    return re.sub(r"\bobject (\d+)\b", name, text)


def _with_object(session: Session, text: str) -> str:
    """``text`` with the name of the object of the current push in place of {}."""
    segment = session.simulation.navigator.segment
    if segment is None:
        return text.format("an object")
    return text.format(object_name(segment.object, session.simulation.conditions[segment.object]))


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _in_words(learned: dict[str, float], true: dict[str, float]) -> str:
    """The estimate of an object beside the truth, in short form."""
    if "mass" not in learned:
        return "Its coefficients are learned"
    units = {"mass": ("mass", "kg"), "friction_x": ("friction along", "N"), "friction_y": ("across", "N")}
    parts = []
    for name, (label, unit) in units.items():
        low, median, high = (learned[f"{name}{end}"] for end in ("_low", "", "_high"))
        parts.append(f"{label} {median:.0f} {unit} ({low:.0f} to {high:.0f}; true {true[name]:.0f})")
    return _capital(", ".join(parts))
