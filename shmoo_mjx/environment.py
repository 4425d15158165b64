"""What the command line sets for its own process before it imports anything heavy; a library must not."""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path

__all__ = ["prepare_environment"]


def prepare_environment() -> None:
    """Defaults for this process only; whatever the user has set stands."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "shmoo_mjx" / "jax"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if cores > 1 and "xla_force_host_platform_device_count" not in os.environ.get("XLA_FLAGS", ""):
        # XLA runs small matrix products on one core: MPPI shares its samples out among these devices.
        os.environ.setdefault("JAX_NUM_CPU_DEVICES", str(min(cores, 4)))
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        # MuJoCo's default window system needs a display; EGL renders without one.
        os.environ.setdefault("MUJOCO_GL", "egl")
    # JAX warns of any fork. The video encoder and the renderer's trial run call exec at once and share no lock with it.
    warnings.filterwarnings("ignore", message=r"os\.fork\(\) was called", category=RuntimeWarning)
