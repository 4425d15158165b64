"""Validates users' files with typed models (pydantic) and reports the first error in one sentence.

Scenarios, maps, sweeps, scenario sets and object files share these rules: numbers are finite, neither text nor
true/false, and angles are in radians.
"""

from __future__ import annotations

import difflib
import json
import math
import reprlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, FiniteFloat, ValidationError

from shmoo_mjx.errors import ShmooError

_PLAIN_TERMS = {"tuple": "list", "Input": "it", "dictionary": "mapping of 'key: value' lines"}
"""Plain terms for YAML and JSON files in place of those of Python and pydantic."""
_LARGEST_ANGLE = 2 * math.pi + 1e-3
"""Largest allowed angle [rad]: a full turn, with a margin for the rounded value 6.284."""


def _no_text(value: object) -> object:
    if isinstance(value, str | bytes):
        raise ValueError(f"is {reprlib.repr(value)}, which is text; give a number without quotes.")
    if isinstance(value, bool):
        raise ValueError(f"is {str(value).lower()}; give a number.")
    return value


def check_angle(value: float) -> float:
    """Check an angle [rad] and return it.

    Raises:
        ValueError: the angle is not finite, or exceeds a full turn and is therefore likely in degrees.
    """
    if isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(f"is {value}; give a finite number in radians.")
    if abs(value) > _LARGEST_ANGLE:
        radians = math.radians(math.remainder(value, 360.0))
        raise ValueError(f"is {value:g}, more than a full turn; give radians ({value:g} degrees are {radians:.4g}).")
    return value


Number = Annotated[FiniteFloat, BeforeValidator(_no_text)]
"""A finite number. Text is rejected, which pydantic alone would convert."""
WholeNumber = Annotated[int, BeforeValidator(_no_text)]
"""A whole number, with the same rule."""
Angle = Annotated[Number, AfterValidator(check_angle)]
"""An angle of at most a full turn [rad]."""


def validated[Model: BaseModel](model: type[Model], data: dict[str, Any], path: str | Path) -> Model:
    """Validate ``data`` and return it as an instance of ``model``.

    Args:
        model: pydantic model of the file's content.
        data: content of the file.
        path: the file, for error messages.

    Raises:
        ShmooError: the data does not fit; the message names file, field and remedy of the first error.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ShmooError(_sentence(error, model, path)) from None


def read_json(path: str | Path, what: str, command: str) -> dict[str, Any]:
    """Read the top-level object of a JSON file.

    Args:
        path: the file.
        what: kind of file, for error messages ("object file").
        command: command that makes such files, for error messages ("shmoo object add").

    Raises:
        ShmooError: the file is missing or unreadable, holds no JSON object, or repeats a key.
    """

    def unique(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
        mapping: dict[str, Any] = {}
        for key, value in pairs:
            if key in mapping:
                raise ShmooError(f"{path}: the key '{key}' stands twice; keep one of them.")
            mapping[key] = value
        return mapping

    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"), object_pairs_hook=unique)
    except FileNotFoundError:
        raise ShmooError(f"{path}: there is no such {what}; check the path, or make one with {command}.") from None
    except (ValueError, RecursionError, IsADirectoryError):
        data = None
    except OSError as error:
        raise ShmooError(f"{path}: the {what} can't be read ({error.strerror}); give a readable file.") from None
    if not isinstance(data, dict):
        raise ShmooError(f"{path}: this is no {what}; make one with {command}.")
    return data


def closest_name(name: object, valid: Iterable[str]) -> str:
    """Hint for an unknown name: the most similar valid name, or all valid names if none is similar."""
    names = list(valid)
    near = difflib.get_close_matches(str(name).lower(), names, n=1, cutoff=0.6)
    return f"did you mean '{near[0]}'?" if near else f"valid names are {', '.join(names)}."


def _sentence(error: ValidationError, model: type[BaseModel], path: str | Path) -> str:
    # A misspelt key also makes the correct key "missing". The misspelling is the cause, so it is reported first.
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    field = _dotted(first["loc"])
    kind, message, value = first["type"], first["msg"].split(" or instance of")[0], first.get("input")
    if kind == "extra_forbidden":
        return f"{path}: '{field}' is not a known key; {closest_name(first['loc'][-1], _keys_at(model, first['loc']))}"
    if kind == "missing":
        return f"{path}: '{field}' is missing; add it."
    if kind == "value_error":  # messages of our own validators contain the remedy
        return f"{path}: '{field}' {message.removeprefix('Value error, ')}" if field else f"{path}: {message[13:]}"
    for term, plain in _PLAIN_TERMS.items():
        message = message.replace(term, plain)
    return f"{path}: '{field}' is {reprlib.repr(value)}; {message[0].lower()}{message[1:]}."


def _dotted(location: tuple[int | str, ...]) -> str:
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _keys_at(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Valid field names at ``location`` in the nested models."""
    for part in location[:-1]:
        if isinstance(part, int) or part not in model.model_fields:  # index of a list, or a user-defined key
            continue
        annotation: Any = model.model_fields[part].annotation
        candidates = [annotation, *getattr(annotation, "__args__", ())]
        model = next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), model)
    return [field.alias or name for name, field in model.model_fields.items()]
