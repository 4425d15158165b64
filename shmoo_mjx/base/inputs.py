"""Finds the files that a command reads: those among its arguments, and those to which they refer."""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from shmoo_mjx.base.guard import protected
from shmoo_mjx.errors import ShmooError

_OUTPUTS = ("out", "json", "record", "directory")
"""Command parameters that name output paths. All other paths are inputs."""
_FOLDERS = ("maps",)
"""Command parameters that name a folder whose YAML files are read, including those in subfolders."""


def with_inputs_kept(command: Callable[..., int]) -> Callable[..., int]:
    """Decorator that prevents a command from overwriting its input files."""
    signature = inspect.signature(command)

    @functools.wraps(command)
    def run(*arguments: Any, **options: Any) -> int:
        values = signature.bind(*arguments, **options).arguments
        read = {name: value for name, value in values.items() if name not in _OUTPUTS}
        with protected(files_read(value for name, value in read.items() if name in _FOLDERS or _is_file(value))):
            return command(*arguments, **options)

    return run


def files_read(values: Iterable[Any]) -> set[Path]:
    """All files among ``values``, the YAML files in folders among them, and all files to which YAML files refer."""
    files: set[Path] = set()
    for value in values:
        if isinstance(value, tuple):
            files |= files_read(value)
        elif isinstance(value, str | Path) and os.path.isfile(value):
            _add(Path(value), files)
        elif isinstance(value, Path) and os.path.isdir(value):
            for folder, _, names in os.walk(value):
                for name in names:
                    if _is_yaml(name):
                        _add(Path(folder, name), files)
    return files


def _is_file(value: Any) -> bool:
    """Whether the value is not a folder. Searching an arbitrary folder, such as a home folder, would take minutes."""
    return not (isinstance(value, Path) and value.is_dir())


def _add(file: Path, files: set[Path]) -> None:
    if file in files:
        return
    files.add(file)
    if _is_yaml(file.name):
        for text in _texts(_content(file)):
            # These are a map's image, a scenario's map and object files, or a sweep's object files.
            if os.path.isfile(file.parent / text):
                _add(file.parent / text, files)


def _content(file: Path) -> Any:
    from shmoo_mjx.base.yaml_input import read_mapping

    try:
        return read_mapping(file, "YAML")
    except ShmooError:
        return None  # The code that reads the file's content reports the error.


def _texts(data: Any) -> Iterator[str]:
    """All strings in nested mappings and lists."""
    waiting, visited = [data], set[int]()
    while waiting:
        value = waiting.pop()
        if isinstance(value, str):
            yield value
        elif isinstance(value, dict | list) and id(value) not in visited:
            visited.add(id(value))  # Visit a value with YAML aliases only once.
            waiting += value.values() if isinstance(value, dict) else value


def _is_yaml(name: str) -> bool:
    return name.lower().endswith((".yaml", ".yml"))
