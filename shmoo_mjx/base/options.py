"""Types of command line options: each checks its range and reports errors in one sentence."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from tyro.constructors import PrimitiveConstructorSpec

from shmoo_mjx.errors import ShmooError

SensesName = Literal["real", "perfect"]
"""Sensing of the robot: realistic, or ground truth from the simulator (shmoo_mjx/sensing)."""
SENSES: tuple[str, ...] = get_args(SensesName)
METHODS = ("ours", "frozen", "paper")
"""Names of the methods in `shmoo_mjx.behavior.methods`, repeated here because that module imports slowly."""


def option(parse: Callable[[str], Any], metavar: str) -> PrimitiveConstructorSpec[Any]:
    """Specification for tyro of an option that ``parse`` reads.

    A ShmooError from ``parse`` passes through tyro unchanged, while a ValueError would print a whole help page.
    """
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
    """An option with a fixed set of values, which its help lists."""

    def parse(text: str) -> str:
        if text not in choices:
            *others, last = choices
            raise ShmooError(f"{name} {shortened(text)!r} is unknown; choose {', '.join(others)} or {last}.")
        return text

    return option(parse, f"{{{','.join(choices)}}}")


def whole_number(name: str, low: int, high: int, text: str) -> int:
    """Parse a whole number.

    Args:
        name: name of the option, for the error message.
        low: smallest allowed number.
        high: largest allowed number.
        text: text to parse.

    Raises:
        ShmooError: the text is not a whole number from ``low`` to ``high``.
    """
    # int() would also accept "1_000", " 7" and digits of other scripts, and it fails for thousands of digits.
    plain = text.isascii() and text.isdigit() and len(text) <= 20
    if not plain or not low <= int(text) <= high:
        raise ShmooError(f"{name} {shortened(text)!r} must be a whole number from {low} to {high}.")
    return int(text)


def _whole(name: str, low: int, high: int) -> PrimitiveConstructorSpec[Any]:
    return option(partial(whole_number, name, low, high), "INT")


def _scenarios(text: str) -> int | Path:
    """Parse a number of scenarios or a file name."""
    number = re.fullmatch(r"[+-]?[\d_.]+", text.strip())
    return whole_number("--scenarios", 1, 10_000, text) if number else Path(text)


def _real(name: str, low: float, high: float, unit: str = "") -> PrimitiveConstructorSpec[Any]:
    def parse(text: str) -> float:
        try:
            value = float(text) if text.isascii() and "_" not in text else None
        except ValueError:
            value = None
        # A comparison with NaN is false, so NaN is rejected too.
        if value is None or not low <= value <= high:
            raise ShmooError(
                f"{name} {shortened(text)!r} must be a number from {low:g} to {high:g}{unit and f' {unit}'}."
            )
        return value

    return option(parse, "FLOAT")


def parted(assignments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split ``NAME=VALUE`` texts into object properties and run settings. Names of settings contain a dot."""
    settings = [text for text in assignments if "." in text.partition("=")[0]]
    return [text for text in assignments if text not in settings], settings


def shortened(text: str) -> str:
    """User input, shortened to 40 characters for an error message."""
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
