"""What the command line sets for its own process before it imports anything heavy; a library must not."""

from __future__ import annotations

import ctypes
import os
import sys
import warnings
from pathlib import Path

from shmoo_mjx.errors import ShmooError


def prepare_environment() -> None:
    """Defaults for this process only; whatever the user has set stands."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "shmoo_mjx" / "jax"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if cores > 1 and "xla_force_host_platform_device_count" not in os.environ.get("XLA_FLAGS", ""):
        # XLA runs small matrix products on one core: MPPI shares its samples out among these devices.
        os.environ.setdefault("JAX_NUM_CPU_DEVICES", str(min(cores, 4)))
    # On a GPU: several processes share it, and single precision is meant (TF32 keeps 10 bits of a product's factors).
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    os.environ.setdefault("JAX_DEFAULT_MATMUL_PRECISION", "highest")
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        # MuJoCo's default window system needs a display, and MuJoCo can't be imported if what is named is missing.
        os.environ.setdefault("MUJOCO_GL", headless_graphics())
    # JAX warns of any fork. The video encoder and the renderer's trial run call exec at once and share no lock with it.
    warnings.filterwarnings("ignore", message=r"os\.fork\(\) was called", category=RuntimeWarning)


def headless_graphics() -> str:
    """What MUJOCO_GL must be without a display: egl, or disable where that library is missing."""
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError:
        return "disable"
    return "egl"


def check_environment() -> None:
    """Try what the user's own settings name, before anything is computed.

    Raises:
        ShmooError: if JAX has no such device, or MuJoCo can't load such graphics.
    """
    for variable, problem in (("MUJOCO_GL", graphics_problem), ("JAX_PLATFORMS", device_problem)):
        value = os.environ.get(variable, "")
        why = problem() if value else ""
        if why:
            raise ShmooError(f"{variable}={value} can't be used here ({why}); unset it, or run shmoo doctor.")


def graphics_problem() -> str:
    """Empty if MuJoCo can be imported with the graphics that MUJOCO_GL names, else why not."""
    try:
        import mujoco  # noqa: F401
    except Exception as error:  # whatever the graphics library does wrong
        return _first_line(error)
    return ""


def device_problem() -> str:
    """Empty if JAX finds a device, else why not."""
    import jax

    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:
        return _first_line(error)
    return ""


def _first_line(error: Exception) -> str:
    lines = str(error).splitlines()
    return lines[0] if lines else "there is no such device"
