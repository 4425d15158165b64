"""Fingerprints of cached results, from settings, files, arrays and the code that makes the result."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from shmoo_mjx.base.assets import asset

_PACKAGE = "shmoo_mjx"
_ROOT = Path(__file__).parents[1]


def fingerprint(code: str, settings: object, *parts: Any) -> str:
    """Fingerprint that identifies a result by its code and inputs.

    Args:
        code: module that makes the result, ``__name__`` of the caller. All modules of this package that it imports are
            included.
        settings: settings that JSON or ``repr`` can serialise.
        parts: further inputs: paths, whose file contents are hashed, and arrays.

    Returns:
        16 hexadecimal digits.
    """
    digest = hashlib.sha256(code_hash(code).encode())
    digest.update(json.dumps(settings, sort_keys=True, default=repr).encode())
    for part in parts:
        content = part.read_bytes() if isinstance(part, Path) else np.ascontiguousarray(part).tobytes()
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()[:16]


@cache
def code_hash(module: str) -> str:
    """Hash of a module's code and of all modules of this package that it imports, also inside functions.

    Comments and docstrings are ignored. If the plant is among the modules, its MJCF files are included.
    """
    trees, todo = dict[str, str](), {module}
    while todo:
        name = todo.pop()
        if name in trees or not _source(name).is_file():
            continue
        trees[name], imported = _parsed(_source(name).read_text(encoding="utf-8"))
        todo |= imported - trees.keys()
    if f"{_PACKAGE}.plant" in trees:
        models = asset("models_xml")
        trees |= {str(p.relative_to(models)): p.read_text(encoding="utf-8") for p in models.rglob("*.xml")}
    return hashlib.sha256(json.dumps(trees, sort_keys=True).encode()).hexdigest()


@cache
def _parsed(source: str) -> tuple[str, frozenset[str]]:
    """Syntax tree of a module without docstrings, and names of this package that it may import.

    The names include functions and classes, and the packages that contain a module.
    """
    code = _Code()
    tree = ast.dump(code.visit(ast.parse(source)))
    return tree, frozenset(code.imported)


class _Code(ast.NodeTransformer):
    """Removes strings that stand alone: docstrings of modules, classes, functions and fields. Collects imports."""

    def __init__(self) -> None:
        self.imported = set[str]()

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        """None, which removes the node, for a string."""
        alone = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if alone else node

    def visit_Import(self, node: ast.Import) -> ast.Import:
        self._add(alias.name for alias in node.names)
        return node

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.ImportFrom:
        self._add(f"{node.module}.{alias.name}" for alias in node.names)
        return node

    def _add(self, names: Iterable[str]) -> None:
        for name in names:
            parts = name.split(".")
            if parts[0] == _PACKAGE:
                self.imported |= {".".join(parts[:n]) for n in range(1, len(parts) + 1)}


def _source(module: str) -> Path:
    place = _ROOT.joinpath(*module.split(".")[1:])
    return place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
