"""What users give on the command line: numbers, of which each option states its range and refuses in one sentence."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from tyro.constructors import PrimitiveConstructorSpec

from shmoo_mjx.errors import ShmooError

SensesName = Literal["real", "perfect"]
"""How the robot perceives: as a robot does, or the simulator's truth (shmoo_mjx/sensing)."""
SENSES: tuple[str, ...] = get_args(SensesName)
METHODS = ("ours", "frozen", "paper")
"""Names in `shmoo_mjx.behavior.methods`, which takes long to import."""


def option(parse: Callable[[str], Any], metavar: str) -> PrimitiveConstructorSpec[Any]:
    """How tyro reads an option by ``parse``, whose ShmooError passes through; of a ValueError it would make a page."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda texts: parse(texts[0]),
        is_instance=lambda value: isinstance(value, int | float | Path | str | range),
        str_from_instance=lambda value: [_text(value)],
    )


def _text(value: Any) -> str:
    if isinstance(value, range):
        return str(value[0]) if len(value) == 1 else f"{value[0]}..{value[-1]}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def choice(name: str, choices: Sequence[str]) -> PrimitiveConstructorSpec[Any]:
    """An option with few values, which its help names."""

    def parse(text: str) -> str:
        if text not in choices:
            *others, last = choices
            raise ShmooError(f"{name} {shortened(text)!r} is unknown; choose {', '.join(others)} or {last}.")
        return text

    return option(parse, f"{{{','.join(choices)}}}")


def whole_number(name: str, low: int, high: int, text: str) -> int:
    """The number that the text says.

    Raises:
        ShmooError: it is no whole number from ``low`` to ``high``; ``name`` says which option it was given to.
    """
    # int() also takes "1_000", " 7" and other scripts' digits, and refuses texts of thousands of digits by itself.
    plain = text.isascii() and text.isdigit() and len(text) <= 20
    if not plain or not low <= int(text) <= high:
        raise ShmooError(f"{name} {shortened(text)!r} must be a whole number from {low} to {high}.")
    return int(text)


def _whole(name: str, low: int, high: int) -> PrimitiveConstructorSpec[Any]:
    return option(partial(whole_number, name, low, high), "INT")


def _scenarios(text: str) -> int | Path:
    """A number, or the name of a file."""
    number = re.fullmatch(r"[+-]?[\d_.]+", text.strip())
    return whole_number("--scenarios", 1, 10_000, text) if number else Path(text)


def _real(name: str, low: float, high: float, unit: str = "") -> PrimitiveConstructorSpec[Any]:
    def parse(text: str) -> float:
        try:
            value = float(text) if text.isascii() and "_" not in text else None
        except ValueError:
            value = None
        # Not a number compares false.
        if value is None or not low <= value <= high:
            raise ShmooError(
                f"{name} {shortened(text)!r} must be a number from {low:g} to {high:g}{unit and f' {unit}'}."
            )
        return value

    return option(parse, "FLOAT")


def parted(assignments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Properties of an object and settings of the run among ``NAME=VALUE`` texts: names of settings have a dot."""
    settings = [text for text in assignments if "." in text.partition("=")[0]]
    return [text for text in assignments if text not in settings], settings


def shortened(text: str) -> str:
    """What was typed, as an error message quotes it."""
    return text if len(text) <= 40 else text[:40] + "..."


Senses = Annotated[SensesName, choice("--senses", SENSES)]
Method = Annotated[str, choice("--method", METHODS)]
Workers = Annotated[int, _whole("--workers", 1, 256)]
Jobs = Annotated[int, _whole("--jobs", 0, 10_000)]
Train = Annotated[int, _whole("--train", 0, 10_000_000)]
Validation = Annotated[int, _whole("--validation", 0, 10_000_000)]
Episodes = Annotated[int, _whole("--episodes", 1, 10_000)]
ScenariosOrSet = Annotated[int | Path, option(_scenarios, "INT|FILE")]
PerMap = Annotated[int, _whole("--per-map", 1, 10_000)]
Buildings = Annotated[int, _whole("--buildings", 1, 10_000)]
Runs = Annotated[int, _whole("--runs", 1, 10_000)]
Port = Annotated[int, _whole("--port", 1, 65_535)]
Seconds = Annotated[float, _real("--seconds", 1.0, 3600.0, "s")]
Minutes = Annotated[float, _real("--minutes", 0.5, 10_000.0, "min")]
GigaBytes = Annotated[float, _real("--memory-gb", 1e-6, 100_000.0, "GB")]
Radius = Annotated[float, _real("--radius", 0.0, 10.0, "m")]
Mass = Annotated[float, _real("--mass", 0.5, 500.0, "kg")]
Friction = Annotated[float, _real("--friction", 0.05, 2.0)]
WheelRadius = Annotated[float, _real("--wheel-radius", 0.01, 0.35, "m")]
Rolling = Annotated[float, _real("--rolling", 0.0, 0.5)]
SwivelFriction = Annotated[float, _real("--swivel-friction", 0.0, 5.0, "N m")]
Side = Annotated[float, _real("--size", 0.05, 5.0, "m")]
Scale = Annotated[float, _real("--scale", 1e-6, 1e3)]
