"""What every test shares: a compilation cache that lasts between runs, and where other people's data lie."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parent.parent
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".pytest_jax_cache"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")
# A red CI must be red again on the next try; at the desk each run draws new examples.
settings.register_profile("ci", derandomize=True, deadline=None)
if os.environ.get("CI"):
    settings.load_profile("ci")
if not os.environ.get("DISPLAY"):
    os.environ.setdefault("MUJOCO_GL", "egl")


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of maps and data that are other people's and never committed."""
    folder = ROOT.parent / "shared"
    if not folder.is_dir():
        pytest.skip("../shared (maps and data of others) is not on this machine")
    return folder
