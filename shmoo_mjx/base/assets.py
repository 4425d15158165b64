"""Finds the files that are shipped with the package, in a checkout and in an installed wheel."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType

WEIGHTS = "experiments/weights/demo.safetensors"
"""Weights shipped with the package. docs/models.md describes their training."""

PAPER_WEIGHTS = "experiments/weights/paper.safetensors"
"""Weights with the same R, and with psi in the form of the paper."""

_PACKAGE = Path(__file__).resolve().parents[1]


def asset(relative_path: str) -> Path:
    """Path of a shipped file such as ``models_xml/shmoobot.xml`` or ``experiments/weights/demo.safetensors``.

    In a wheel, the top-level folders are inside the package; in a checkout, they are next to it.
    """
    inside = _PACKAGE / relative_path
    return inside if inside.exists() else _PACKAGE.parent / relative_path


def benchmark_suite() -> ModuleType:
    """The module ``benchmarks.registry``. In a wheel, ``benchmarks`` is inside this package."""
    return import_module(f"{'shmoo_mjx.' if (_PACKAGE / 'benchmarks').is_dir() else ''}benchmarks.registry")
