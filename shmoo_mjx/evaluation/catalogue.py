"""Lists what is shipped, with the command for each item (``shmoo list``)."""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from shmoo_mjx.base.assets import asset, benchmark_suite


class Item(NamedTuple):
    """One item of the list."""

    name: str
    command: str
    """Command that uses it."""
    about: str = ""


def catalogue(kind: str) -> list[Item]:
    """The items of one of `KINDS`."""
    return list(KINDS[kind]())


def lines(kinds: list[str]) -> list[str]:
    """One line per item of the kinds, with the columns name, command and description."""
    items = {kind: catalogue(kind) for kind in kinds}
    width, wide = (max(len(item[i]) for group in items.values() for item in group) for i in (0, 1))
    return [
        text
        for kind, group in items.items()
        for text in (
            *([f"{kind}:"] if len(kinds) > 1 else []),
            *(f"  {item.name:{width}}  {item.command:{wide}}  {item.about}".rstrip() for item in group),
        )
    ]


def _files(folder: str, command: str, pattern: str = "*.yaml", stem: bool = False) -> Callable[[], Iterator[Item]]:
    def items() -> Iterator[Item]:
        for path in sorted(asset(f"experiments/{folder}").glob(pattern)):
            yield Item(path.stem, command.format(path.stem if stem else _short(path)))

    return items


def _short(path: Path) -> str:
    relative = os.path.relpath(path)
    return str(path) if relative.startswith("..") else relative


def _experiments() -> Iterator[Item]:
    from shmoo_mjx.evaluation.registry import EXPERIMENTS, RELIABILITY

    for name, module in (EXPERIMENTS | RELIABILITY).items():
        yield Item(name, f"shmoo experiment {name}", _first_line(module))


def _first_line(module: str) -> str:
    """First line of a module's docstring, read without importing the module."""
    spec = find_spec(module)
    source = Path(str(spec.origin)).read_text(encoding="utf-8") if spec else ""
    first = (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]
    return re.sub(r"^Experiment \S+ ", "", first)


def _objects() -> Iterator[Item]:
    from shmoo_mjx.plant.objects import FAMILIES

    return (Item(family, f"shmoo push {family}") for family in FAMILIES)


def _weights() -> Iterator[Item]:
    from shmoo_mjx.behavior.methods import METHODS

    for path, name in {method.weights: name for name, method in reversed(METHODS.items())}.items():
        yield Item(Path(path).stem, f"shmoo demo --method {name} --weights {_short(asset(path))}")


def _methods() -> Iterator[Item]:
    from shmoo_mjx.behavior.methods import METHODS

    return (Item(name, f"shmoo demo --method {name}") for name in METHODS)


def _policies() -> Iterator[Item]:
    from shmoo_mjx.evaluation.navigation import POLICIES

    return (Item(name, f"shmoo experiment navigation --policies {name}") for name in POLICIES)


def _controllers() -> Iterator[Item]:
    from shmoo_mjx.evaluation.pushing_trials import METHODS

    return (Item(name, f"shmoo experiment pushing --policies {name}") for name in METHODS)


def _faults() -> Iterator[Item]:
    from shmoo_mjx.evaluation.faults import FAULTS

    return (Item(name, f"shmoo experiment faults --only {name}", fault.what) for name, fault in FAULTS.items())


def _benchmarks() -> Iterator[Item]:
    suite = benchmark_suite()
    for name in suite.BENCHMARKS:
        yield Item(name, f"shmoo bench {name}", _first_line(f"{suite.__package__}.{name}"))


def _settings() -> Iterator[Item]:
    from shmoo_mjx.behavior.methods import METHODS, OURS
    from shmoo_mjx.behavior.settings import settings_of

    for name, value in settings_of(METHODS[OURS]).items():
        yield Item(name, f"shmoo demo --set '{name}={_as_yaml(value)}'")


def _as_yaml(value: Any) -> str:
    text = str(list(value) if isinstance(value, tuple) else value)
    return text.lower() if isinstance(value, bool) else text


KINDS: dict[str, Callable[[], Iterator[Item]]] = {
    "scenarios": _files("scenarios", "shmoo navigate --scenario {}"),
    "sets": _files("scenario_sets", "shmoo experiment navigation --scenarios {}", "*.json", stem=True),
    "maps": _files("maps", "shmoo map show {}"),
    "objects": _objects,
    "weights": _weights,
    "methods": _methods,
    "experiments": _experiments,
    "policies": _policies,
    "controllers": _controllers,
    "faults": _faults,
    "benchmarks": _benchmarks,
    "sweeps": _files("sweeps", "shmoo sweep {}", stem=True),
    "settings": _settings,
}
"""Kind of items to the function that lists them."""
