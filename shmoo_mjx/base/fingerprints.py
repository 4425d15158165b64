"""What decides about a kept result: settings, files and arrays, and the code that made it."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.base.assets import asset

_PACKAGE = "shmoo_mjx"
_ROOT = Path(__file__).parents[1]


def fingerprint(code: str, settings: object, *parts: Any) -> str:
    """Name for what a module makes of these settings and parts, and of no others.

    Args:
        code: the module, ``__name__`` of the caller; it and everything of this package that it imports count.
        settings: anything that JSON or ``repr`` tells apart.
        parts: paths, whose contents count, and arrays.
    """
    digest = hashlib.sha256(code_hash(code).encode())
    digest.update(json.dumps(settings, sort_keys=True, default=repr).encode())
    for part in parts:
        content = part.read_bytes() if isinstance(part, Path) else np.ascontiguousarray(part).tobytes()
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()[:16]


@cache
def code_hash(module: str) -> str:
    """Hash of a module's code and of all that it imports from this package, now or later; comments don't count.

    Who imports the plant depends on its MJCF as well.
    """
    trees, todo = dict[str, str](), [module]
    while todo:
        name = todo.pop()
        if name in trees:
            continue
        tree = ast.parse(_source(name).read_text(encoding="utf-8"))
        trees[name] = ast.dump(tree)
        todo += _imported(tree)
    if f"{_PACKAGE}.plant" in trees:
        models = asset("models_xml")
        trees |= {str(p.relative_to(models)): p.read_text(encoding="utf-8") for p in models.rglob("*.xml")}
    return hashlib.sha256(json.dumps(trees, sort_keys=True).encode()).hexdigest()


def _imported(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        for name in names:
            parts = name.split(".")
            if parts[0] == _PACKAGE:
                parents = (".".join(parts[:n]) for n in range(1, len(parts) + 1))
                yield from (parent for parent in parents if _source(parent).is_file())


def _source(module: str) -> Path:
    place = _ROOT.joinpath(*module.split(".")[1:])
    return place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
