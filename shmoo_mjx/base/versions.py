"""Versions of the software on which a result depends."""

from __future__ import annotations

import platform
from importlib import metadata


def versions() -> dict[str, str]:
    """Versions of Python and of the packages on which a result depends."""
    names = ("shmoo-mjx", "jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy", "scikit-image", "clarabel")
    return {"python": platform.python_version()} | {name: metadata.version(name) for name in names}
