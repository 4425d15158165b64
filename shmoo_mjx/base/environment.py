"""Environment settings of the command line's process, made before heavy imports. Library code must not call this."""

from __future__ import annotations

import ctypes
import os
import sys
import warnings
from pathlib import Path

from shmoo_mjx.errors import ShmooError


def prepare_environment() -> None:
    """Set default environment variables for this process. Variables that the user has set are not changed."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "shmoo_mjx" / "jax"
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.5")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if cores > 1 and "xla_force_host_platform_device_count" not in os.environ.get("XLA_FLAGS", ""):
        # XLA runs small matrix products on one core, so MPPI distributes its samples over several CPU devices.
        os.environ.setdefault("JAX_NUM_CPU_DEVICES", str(min(cores, 4)))
    # On a GPU, allow several processes to share the memory, and use full single precision (TF32 has a 10-bit mantissa).
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    os.environ.setdefault("JAX_DEFAULT_MATMUL_PRECISION", "highest")
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        # The default graphics library needs a display. Importing MuJoCo fails if MUJOCO_GL names a missing library.
        os.environ.setdefault("MUJOCO_GL", headless_graphics())
    # JAX warns about every fork. The forks of the video encoder and the renderer's check are safe: they exec at once.
    warnings.filterwarnings("ignore", message=r"os\.fork\(\) was called", category=RuntimeWarning)


def headless_graphics() -> str:
    """Value of MUJOCO_GL for a machine without a display: "egl", or "disable" if the EGL library is missing."""
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError:
        return "disable"
    return "egl"


def check_environment() -> None:
    """Check the user's MUJOCO_GL and JAX_PLATFORMS before any computation.

    Raises:
        ShmooError: JAX does not find the device, or MuJoCo can't load the graphics library.
    """
    for variable, problem in (("MUJOCO_GL", graphics_problem), ("JAX_PLATFORMS", device_problem)):
        value = os.environ.get(variable, "")
        why = problem() if value else ""
        if why:
            raise ShmooError(f"{variable}={value} can't be used here ({why}); unset it, or run shmoo doctor.")


def graphics_problem() -> str:
    """Reason why MuJoCo can't be imported with the graphics library of MUJOCO_GL; empty if it can."""
    try:
        import mujoco  # noqa: F401
    except Exception as error:  # graphics libraries fail with many error types
        return _first_line(error)
    return ""


def device_problem() -> str:
    """Reason why JAX finds no device; empty if it finds one."""
    import jax

    try:
        jax.devices()
    except (RuntimeError, AssertionError) as error:
        return _first_line(error)
    return ""


def _first_line(error: Exception) -> str:
    lines = str(error).splitlines()
    return lines[0] if lines else "there is no such device"
