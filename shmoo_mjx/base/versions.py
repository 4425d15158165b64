"""Versions of what a result depends on."""

from __future__ import annotations

import platform
from importlib import metadata


def versions() -> dict[str, str]:
    """Versions of everything a result depends on."""
    names = ("shmoo-mjx", "jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy", "scikit-image", "clarabel")
    return {"python": platform.python_version()} | {name: metadata.version(name) for name in names}
