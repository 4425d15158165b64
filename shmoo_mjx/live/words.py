"""Texts of the live page about a session, as Markdown."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shmoo_mjx.learning import online
from shmoo_mjx.live.session import Session
from shmoo_mjx.plant.condition import Condition
from shmoo_mjx.plant.observe import DIVERGED
from shmoo_mjx.types import DT


def state_text(session: Session, lean: float, force: float) -> str:
    """Mode and its reason, time, ``lean`` [deg], ``force`` of the hands [N], and computing time of control steps."""
    simulation, navigator, p = session.simulation, session.simulation.navigator, session.probability
    state = str(navigator.mode)
    reason = navigator.transitions[-1].reason if navigator.transitions else "it looks for a way"
    if simulation.history.ended:
        state, reason = "stopped; begin again", DIVERGED if simulation.history.diverged else "it has fallen"
    chance = "" if p is None else f", P(push frees the path) **{p:.2f}**"
    spent = 1e3 * np.array(session.spent or [0.0])
    return (
        f"### {state}\n{reason}\n\n"
        f"{simulation.time:.1f} s, lean {lean:.1f}°, force {force:.0f} N, senses {session.senses.name}{chance}\n\n"
        f"control step: median {np.median(spent):.0f} ms, worst {spent.max():.0f} ms of the last {len(spent)}; "
        f"{session.late} longer than {1e3 * DT:.0f} ms"
    )


def beliefs(session: Session) -> str:
    """The robot's estimate of each object as a list, because a table would be too wide for a phone."""
    navigator, lines = session.simulation.navigator, list[str]()
    for index, condition in enumerate(session.simulation.conditions):
        name, item = object_name(index, condition), navigator.belief.objects.get(index)
        if item is None:
            lines.append(f"- **{name}** not seen yet")
            continue
        verdicts = [d for d in navigator.decisions if d.object == index]
        last = verdicts[-1].reason if verdicts else "not touched"
        moves = {None: "not known", True: "can be moved", False: "can't be moved"}[item.manipulable]
        parts = [f"{item.status}: {moves} ({last})"]
        if item.adapt is not None:
            parts.append(_in_words(online.summary(item.adapt), session.prior))
        lines.append(f"- **{name}** {'; '.join(parts)}")
    return "\n".join(lines)


def object_name(index: int, condition: Condition) -> str:
    """Name of an object on the page: its index and family."""
    return f"{index} {Path(condition.family).stem}"


def object_index(name: str) -> int | None:
    """The index at the beginning of an object's name; None for "none"."""
    number = name.partition(" ")[0]
    return int(number) if number.isdigit() else None


def _in_words(learned: dict[str, float], prior: dict[str, float]) -> str:
    """The estimate of an object compared with its prior, in short form."""
    if "mass" not in learned:
        return "coefficients"
    units = {"friction_x": "N along", "friction_y": "N across", "mass": "kg"}
    parts = (f"{_band(learned, name)} {unit} (at first {_band(prior, name)})" for name, unit in units.items())
    return "friction {}, {}, mass {}".format(*parts)


def _band(learned: dict[str, float], name: str) -> str:
    """Median and 80 % band of one quantity."""
    low, median, high = (learned[f"{name}{end}"] for end in ("_low", "", "_high"))
    return f"{median:.0f} [{low:.0f} to {high:.0f}]"
