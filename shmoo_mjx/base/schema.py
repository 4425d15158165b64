"""Checks what users write against a typed model (pydantic), and says every fault in one sentence.

Scenarios, maps, sweeps, scenario sets and object files share these rules: a number is not text and not true or false,
it is finite, and an angle is in radians.
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
"""Python's and pydantic's words for what a YAML or JSON file has."""
_LARGEST_ANGLE = 2 * math.pi + 1e-3
"""A full turn [rad], with room for 6.284."""


def _no_text(value: object) -> object:
    if isinstance(value, str | bytes):
        raise ValueError(f"is {reprlib.repr(value)}, which is text; give a number without quotes.")
    if isinstance(value, bool):
        raise ValueError(f"is {str(value).lower()}; give a number.")
    return value


def check_angle(value: float) -> float:
    """The angle [rad] as it is.

    Raises:
        ValueError: it is no finite number, or beyond a full turn, so that degrees are meant.
    """
    if isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(f"is {value}; give a finite number in radians.")
    if abs(value) > _LARGEST_ANGLE:
        radians = math.radians(math.remainder(value, 360.0))
        raise ValueError(f"is {value:g}, more than a full turn; give radians ({value:g} degrees are {radians:.4g}).")
    return value


Number = Annotated[FiniteFloat, BeforeValidator(_no_text)]
"""A finite number, which pydantic would also read from text."""
WholeNumber = Annotated[int, BeforeValidator(_no_text)]
"""The same for whole numbers."""
Angle = Annotated[Number, AfterValidator(check_angle)]
"""[rad], at most a full turn."""


def validated[Model: BaseModel](model: type[Model], data: dict[str, Any], path: str | Path) -> Model:
    """``data`` as an instance of ``model``.

    Raises:
        ShmooError: the first fault found, with the file, the field and the remedy.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ShmooError(_sentence(error, model, path)) from None


def read_json(path: str | Path, what: str, command: str) -> dict[str, Any]:
    """The top-level object of a JSON file.

    Args:
        path: the file.
        what: what the file is, for the error ("object file").
        command: what makes such files, for the error ("shmoo object add").

    Raises:
        ShmooError: the file is missing, unreadable, no JSON object, or has a key twice.
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
    """Advice on a name that is not among ``valid``: the nearest one if there is one, all of them otherwise."""
    names = list(valid)
    near = difflib.get_close_matches(str(name).lower(), names, n=1, cutoff=0.6)
    return f"did you mean '{near[0]}'?" if near else f"valid names are {', '.join(names)}."


def _sentence(error: ValidationError, model: type[BaseModel], path: str | Path) -> str:
    # A misspelt key also makes the right key "missing"; naming the misspelling helps more, so it goes first.
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    field = _dotted(first["loc"])
    kind, message, value = first["type"], first["msg"].split(" or instance of")[0], first.get("input")
    if kind == "extra_forbidden":
        return f"{path}: '{field}' is not a known key; {closest_name(first['loc'][-1], _keys_at(model, first['loc']))}"
    if kind == "missing":
        return f"{path}: '{field}' is missing; add it."
    if kind == "value_error":  # our own validators write the remedy themselves
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
    """The field names valid where ``location`` points, by walking the nested models."""
    for part in location[:-1]:
        if isinstance(part, int) or part not in model.model_fields:  # of a list, or a key that the user may name
            continue
        annotation: Any = model.model_fields[part].annotation
        candidates = [annotation, *getattr(annotation, "__args__", ())]
        model = next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), model)
    return [field.alias or name for name, field in model.model_fields.items()]
