"""Which files a command reads: those that its arguments name, and those that these refer to."""

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
"""Parameters of commands that name what is written; every other path is read."""
_FOLDERS = ("maps",)
"""Parameters of commands that name a folder whose YAML files are read, wherever below it they lie."""


def with_inputs_kept(command: Callable[..., int]) -> Callable[..., int]:
    """The command, which can't write over what it reads."""
    signature = inspect.signature(command)

    @functools.wraps(command)
    def run(*arguments: Any, **options: Any) -> int:
        values = signature.bind(*arguments, **options).arguments
        read = {name: value for name, value in values.items() if name not in _OUTPUTS}
        with protected(files_read(value for name, value in read.items() if name in _FOLDERS or _is_file(value))):
            return command(*arguments, **options)

    return run


def files_read(values: Iterable[Any]) -> set[Path]:
    """The files among ``values``, the YAML files in folders among them, and all files that YAML files refer to."""
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
    """Whether it names no folder: to look through any folder that somebody names, a home say, would take minutes."""
    return not (isinstance(value, Path) and value.is_dir())


def _add(file: Path, files: set[Path]) -> None:
    if file in files:
        return
    files.add(file)
    if _is_yaml(file.name):
        for text in _texts(_content(file)):
            # A map's image, a scenario's map and object files, a sweep's object files.
            if os.path.isfile(file.parent / text):
                _add(file.parent / text, files)


def _content(file: Path) -> Any:
    from shmoo_mjx.base.yaml_input import read_mapping

    try:
        return read_mapping(file, "YAML")
    except ShmooError:
        return None  # Whoever reads the file for its content says what is wrong with it.


def _texts(data: Any) -> Iterator[str]:
    """All strings in nested mappings and lists."""
    waiting, visited = [data], set[int]()
    while waiting:
        value = waiting.pop()
        if isinstance(value, str):
            yield value
        elif isinstance(value, dict | list) and id(value) not in visited:
            visited.add(id(value))  # YAML's aliases would otherwise be walked through again and again.
            waiting += value.values() if isinstance(value, dict) else value


def _is_yaml(name: str) -> bool:
    return name.lower().endswith((".yaml", ".yml"))
