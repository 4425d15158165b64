"""Finds the files that come with the package, in an editable and in an installed copy alike."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType

WEIGHTS = "experiments/weights/demo.safetensors"
"""The weights that come with the package (docs/models.md says how they are made)."""

PAPER_WEIGHTS = "experiments/weights/paper.safetensors"
"""The same R with psi as the paper prints it."""

_PACKAGE = Path(__file__).resolve().parents[1]


def asset(relative_path: str) -> Path:
    """Path of a shipped file such as ``models_xml/shmoobot.xml`` or ``experiments/weights/demo.safetensors``.

    In a wheel the top-level folders lie inside the package; in a checkout, beside it.
    """
    inside = _PACKAGE / relative_path
    return inside if inside.exists() else _PACKAGE.parent / relative_path


def benchmark_suite() -> ModuleType:
    """The module ``registry`` of ``benchmarks``, which is part of this package in a wheel only."""
    return import_module(f"{'shmoo_mjx.' if (_PACKAGE / 'benchmarks').is_dir() else ''}benchmarks.registry")
