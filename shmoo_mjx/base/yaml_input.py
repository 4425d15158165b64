"""Reads users' YAML files with the scalar rules of YAML 1.2, and writes YAML files that it can read back unchanged."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from shmoo_mjx.errors import ShmooError

_DEEPEST = 32
"""Largest nesting depth. Parsing is recursive, and its time grows with the square of the depth."""
_LONGEST_NUMBER = 300
"""Largest number of characters of a number. A longer whole number would not fit in a float."""
# The core schema of YAML 1.2 (chapter 10.3.2). PyYAML follows YAML 1.1, where 010 is 8, 1:30 is 90, yes is true, and
# 1e1 is text.
_CORE = {
    "bool": ("tTfF", re.compile(r"(true|True|TRUE|false|False|FALSE)$")),
    "int": ("-+0123456789", re.compile(r"([-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$")),
    "float": (
        "-+.0123456789",
        re.compile(r"([-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN))$"),
    ),
}
"""First characters and pattern of each scalar type that is not text."""
_TAG = "tag:yaml.org,2002:"


class _Loader(yaml.SafeLoader):
    """Loader of plain data. It rejects deep nesting and duplicate keys, of which YAML would silently keep the last."""

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
        keys: set[str] = set()
        for key, _ in node.value:
            if key.value in keys:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key '{key.value}' stands twice", key.start_mark
                )
            if isinstance(key.value, str):
                keys.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_core(self, node: yaml.ScalarNode) -> bool | int | float:
        """A scalar of YAML 1.2; its type is either detected from the text or given by a tag."""
        text, kind = str(node.value), node.tag.removeprefix(_TAG)
        if not _CORE[kind][1].match(text) or len(text) > _LONGEST_NUMBER:
            raise yaml.constructor.ConstructorError(None, None, f"no {kind}", node.start_mark)
        if kind == "bool":
            return text.lower() == "true"
        if kind == "int":
            return int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))
        return float(re.sub(r"\.(?=[iInN])", "", text))


class _Dumper(yaml.SafeDumper):
    """Dumper that quotes text which YAML 1.1 or 1.2 would read as another type."""


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag in (f"{_TAG}null", f"{_TAG}merge")]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.yaml_constructors = {
    tag: yaml.SafeLoader.yaml_constructors[tag]
    for tag in (f"{_TAG}null", f"{_TAG}str", f"{_TAG}seq", f"{_TAG}map", None)
}
for _kind, (_first, _pattern) in _CORE.items():
    _Loader.add_implicit_resolver(_TAG + _kind, _pattern, list(_first))
    _Dumper.add_implicit_resolver(_TAG + _kind, _pattern, list(_first))
    _Loader.add_constructor(_TAG + _kind, _Loader.construct_core)


def yaml_text(data: dict[str, Any]) -> bytes:
    """Serialise ``data`` as YAML, with lists of plain values on one line."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=None).encode()


def yaml_files(folder: Path, below: bool = False) -> list[Path]:
    """Sorted list of the YAML files (*.yaml, *.yml) in ``folder``; with ``below`` also those in subfolders."""
    paths = folder.rglob("*") if below else folder.glob("*")
    return sorted(p for p in paths if p.suffix.lower() in (".yaml", ".yml") and p.is_file())


def value_of(text: str, name: str) -> Any:
    """Parse ``text`` as a YAML value: a number, a boolean, a list or text.

    Args:
        text: text to parse.
        name: name of the option or field, for the error message.

    Raises:
        ShmooError: the text is not valid YAML.
    """
    try:
        return yaml.load(text, _Loader)
    except yaml.YAMLError:
        raise ShmooError(f"{name} must be a number, true, false, or a list such as [true, false].") from None


def read_mapping(path: str | Path, what: str) -> dict[str, Any]:
    """Read the top-level mapping of a YAML file.

    Args:
        path: file to read.
        what: what the file is ("map", "scenario"), for the error message.

    Raises:
        ShmooError: the file is missing or unreadable, not valid YAML, or not a mapping.
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
