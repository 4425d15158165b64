"""Reading a user's YAML file into a checked model, every fault said in one sentence."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from shmoo_mjx.errors import ShmooError

_PLAIN_TERMS = {"tuple": "list", "Input": "it", "dictionary": "mapping of 'key: value' lines"}
"""Python's and pydantic's words for what a YAML file has."""


_DEEPEST = 32
"""More brackets within brackets cost recursion, and time with their square."""


class _Loader(yaml.SafeLoader):
    """Plain data, not too deep, no key twice in one mapping: YAML would let the last one win in silence."""

    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self._depth == _DEEPEST:
            mark = self.peek_event().start_mark
            raise yaml.composer.ComposerError(None, None, f"more than {_DEEPEST} levels stand within each other", mark)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key '{key.value}' stands twice", key.start_mark
                )
            if isinstance(key.value, str):
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def read_mapping(path: str | Path, what: str) -> dict[str, Any]:
    """The top-level mapping of a YAML file.

    Args:
        path: the file.
        what: what the file is, for the error ("map", "scenario").

    Raises:
        ShmooError: the file is missing, unreadable, no YAML, or not a mapping.
    """
    path = Path(path)
    try:
        data = yaml.load(path.read_text(encoding="utf-8"), _Loader)
    except FileNotFoundError:
        raise ShmooError(f"{path}: there is no such {what} file; check the path.") from None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ShmooError(f"{path}: the {what} file can't be read ({reason}); give a readable YAML text file.") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark is not None else ""
        if isinstance(error, yaml.constructor.ConstructorError) and "twice" in str(error.problem):
            raise ShmooError(f"{path}: {error.problem}{where}; keep one of them.") from None
        if isinstance(error, yaml.composer.ComposerError) and "levels" in str(error.problem):
            raise ShmooError(f"{path}: {error.problem}{where}; no {what} file needs more than a few.") from None
        raise ShmooError(f"{path}: this is not valid YAML{where}; correct the syntax there.") from None
    if not isinstance(data, dict):
        raise ShmooError(f"{path}: a {what} file must be a mapping of 'key: value' lines; this one is not.")
    return data


def closest_name(name: object, valid: Iterable[str]) -> str:
    """Advice on a name that is not among ``valid``: the nearest one if there is one, all of them otherwise."""
    names = list(valid)
    near = difflib.get_close_matches(str(name).lower(), names, n=1, cutoff=0.6)
    return f"did you mean '{near[0]}'?" if near else f"valid names are {', '.join(names)}."


def validated[Model: BaseModel](model: type[Model], data: dict[str, Any], path: str | Path) -> Model:
    """``data`` as an instance of ``model``.

    Raises:
        ShmooError: the first fault found, with the file, the field and the remedy.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ShmooError(_sentence(error, model, path)) from None


def _sentence(error: ValidationError, model: type[BaseModel], path: str | Path) -> str:
    # A misspelt key also makes the right key "missing"; naming the misspelling helps more, so it goes first.
    first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    field = _dotted(first["loc"])
    kind, message, given = first["type"], first["msg"].split(" or instance of")[0], first.get("input")
    if kind == "extra_forbidden":
        return f"{path}: '{field}' is not a known key; {closest_name(first['loc'][-1], _keys_at(model, first['loc']))}"
    if kind == "missing":
        return f"{path}: '{field}' is missing; add it."
    if kind == "value_error":  # our own validators write the remedy themselves
        return f"{path}: '{field}' {message.removeprefix('Value error, ')}" if field else f"{path}: {message[13:]}"
    for term, plain in _PLAIN_TERMS.items():
        message = message.replace(term, plain)
    return f"{path}: '{field}' is {reprlib.repr(given)}; {message[0].lower()}{message[1:]}."


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
    return list(model.model_fields)
