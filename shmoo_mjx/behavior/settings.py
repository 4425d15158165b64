"""Settings of the pushing controller and the navigator by name, for example ``control.num_rollouts=128``."""

from __future__ import annotations

import math
import typing
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from difflib import get_close_matches
from typing import Any

from pydantic import TypeAdapter, ValidationError

from shmoo_mjx.base.options import shortened
from shmoo_mjx.base.yaml_input import value_of
from shmoo_mjx.behavior.methods import Method
from shmoo_mjx.errors import ShmooError

NAVIGATOR, PUSHING = "navigator.", "pushing."
"""Prefixes of the navigator's settings, and of the `PushConfig` settings that belong to no group."""


def settings_of(method: Method) -> dict[str, Any]:
    """Every setting of the method by name, with its value for navigation."""
    pushing = {name if "." in name else PUSHING + name: value for name, value in _leaves(method.pushing)}
    return pushing | {NAVIGATOR + name: value for name, value in _leaves(method.navigator)}


def with_settings(method: Method, settings: Sequence[str]) -> Method:
    """The method with the settings that texts such as ``control.num_rollouts=128`` give.

    Raises:
        ShmooError: a name is not a setting, or a value is not valid for its setting.
    """
    for text in settings:
        name, equals, value = text.partition("=")
        what = f"--set {shortened(text)!r}"
        if not equals:
            raise ShmooError(f"{what} must be NAME=VALUE, such as control.num_rollouts=128.")
        names = settings_of(method)
        if name not in names:
            raise ShmooError(f"{what}: {shortened(name)!r} is no setting; {_hint(name, names)}")
        plain = _as_tuple(value_of(value, what))
        if name.startswith(NAVIGATOR):
            path = name.removeprefix(NAVIGATOR).split(".")
            method = replace(method, navigator=_changed(method.navigator, path, plain, what))
        else:
            path = name.removeprefix(PUSHING).split(".")
            pushing, pose_pushing = (
                _changed(config, path, plain, what) for config in (method.pushing, method.pose_pushing)
            )
            method = replace(method, pushing=pushing, pose_pushing=pose_pushing)
    return method


def _leaves(config: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for field in fields(config):
        value = getattr(config, field.name)
        if is_dataclass(value):
            yield from _leaves(value, f"{prefix}{field.name}.")
        else:
            yield prefix + field.name, value


def _changed(config: Any, path: Sequence[str], value: Any, what: str) -> Any:
    name, *rest = path
    current = getattr(config, name)
    if rest:
        return replace(config, **{name: _changed(current, rest, value, what)})
    hint = typing.get_type_hints(type(config))[name]
    try:
        checked = TypeAdapter(hint).validate_python(value, strict=True)
    except ValidationError as error:
        told = error.errors()[0]["msg"].removeprefix("Input should be ")
        raise ShmooError(f"{what} must be {told}; it is {current} by default.") from None
    numbers = checked if isinstance(checked, tuple) else (checked,)
    if any(isinstance(number, float) and not math.isfinite(number) for number in numbers):
        raise ShmooError(f"{what} must be finite; it is {current} by default.")
    # Fields do not declare ranges. A count stays at least 1, and what is not negative by default stays so.
    least = 1 if isinstance(current, int) else 0
    if isinstance(current, int | float) and not isinstance(current, bool) and current >= least > checked:
        raise ShmooError(f"{what} must be at least {least}; it is {current} by default.")
    return replace(config, **{name: checked})


def _as_tuple(value: Any) -> Any:
    return tuple(map(_as_tuple, value)) if isinstance(value, list) else value


def _hint(name: str, names: dict[str, Any]) -> str:
    if "." not in name:
        return "settings have a dot, as control.num_rollouts has; properties of objects stand in the scenario file."
    if near := get_close_matches(name, names, 1, 0.7):
        return f"did you mean {near[0]}?"
    group = name.partition(".")[0] + "."
    if mates := [other for other in names if other.startswith(group)]:
        return f"choose from {', '.join(mates)}."
    groups = dict.fromkeys(other.partition(".")[0] for other in names)
    return f"names begin with {', '.join(f'{g}.' for g in groups)} (shmoo list settings shows them all)."
