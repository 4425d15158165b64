"""``shmoo doctor``: checks the installation of this machine and suggests remedies."""

from __future__ import annotations

import importlib
import os
import platform
import sys
import tempfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from shmoo_mjx.base.environment import device_problem, graphics_problem


class Check(NamedTuple):
    """Result of one check."""

    name: str
    """Name of the checked item."""
    ok: bool
    """Whether the check passed."""
    finding: str
    """What was found."""
    remedy: str
    """What to do if the check failed."""
    needed: bool = True
    """Whether the main function fails without it."""


def _python() -> Check:
    return Check("Python", sys.version_info >= (3, 12), platform.python_version(), "install Python 3.12 or newer")


def _mujoco() -> Check:
    core, mjx = metadata.version("mujoco"), metadata.version("mujoco-mjx")
    return Check(
        "mujoco and mujoco-mjx", core == mjx, f"{core} and {mjx}", f"pip install mujoco=={mjx} mujoco-mjx=={mjx}"
    )


def _jax() -> Check:
    version = metadata.version("jax")
    numbers = tuple(int(n) for n in version.split(".")[:2])
    remedy = "pip install 'jax>=0.12': older ones crash where MJX is compiled for several CPU devices"
    return Check("JAX", numbers >= (0, 12), version, remedy)


def _device() -> Check:
    jax, problem = importlib.import_module("jax"), device_problem()
    if problem:
        # The other checks need a device that works.
        jax.config.update("jax_platforms", "cpu")
    finding = problem or ", ".join(str(d) for d in jax.devices())
    return Check("JAX device", not problem, finding, "unset JAX_PLATFORMS, or install the cuda extra")


def _renderer() -> Check:
    problem = graphics_problem()
    if problem:
        os.environ["MUJOCO_GL"] = "disable"  # the other checks must not fail for the same reason
        return Check("3-D renderer", False, problem, "unset MUJOCO_GL, or set it to egl, glfw or disable")
    from shmoo_mjx.plant.render import can_render

    problem = can_render()
    remedy = (
        "install EGL (Debian, Ubuntu: apt-get install libegl1 libgl1-mesa-dri) or set MUJOCO_GL; "
        "without it videos are drawn from above"
    )
    return Check("3-D renderer", not problem, problem or "MuJoCo renders without a display", remedy, needed=False)


def _encoder() -> Check:
    import numpy as np

    from shmoo_mjx.report.video import write_video

    remedy = "pip install imageio-ffmpeg, which brings an ffmpeg program, or set IMAGEIO_FFMPEG_EXE"
    try:
        with tempfile.TemporaryDirectory() as folder:
            write_video(Path(folder) / "try.mp4", [np.zeros((64, 64, 3), np.uint8)] * 3)
    except Exception as error:  # the encoder program may fail in any way
        return Check("video encoder", False, f"{type(error).__name__}: {error}", remedy)
    return Check("video encoder", True, "H.264", remedy)


def _weights() -> Check:
    from shmoo_mjx.base.assets import WEIGHTS, asset
    from shmoo_mjx.errors import ShmooError

    path = asset(WEIGHTS)
    remedy = "reinstall, or make them anew: shmoo collect, shmoo train (docs/models.md)"
    try:
        from shmoo_mjx.learning.weights import load_weights

        made_by = load_weights(path).info.get("made_by", {})
    except ShmooError as error:
        return Check("shipped weights", False, str(error), remedy)
    except Exception as error:  # another check reports this problem
        return Check("shipped weights", False, f"{type(error).__name__}: {error}", remedy)
    of = "; ".join(
        f"{part}: {by['command']}, data {by['data']['sha256'][:8]}, score {by['score']:.3f}"
        for part, by in made_by.items()
    )
    return Check("shipped weights", True, f"{path.name} ({of})" if of else path.name, remedy)


def _training() -> Check:
    """Checks networks, optimiser and checkpoints on a minimal example.

    Versions of these packages often do not fit JAX's.
    """
    remedy = "pip install --upgrade flax optax orbax-checkpoint"
    try:
        jax, optax = importlib.import_module("jax"), importlib.import_module("optax")
        from shmoo_mjx.dynamics import core
        from shmoo_mjx.learning.checkpoints import Checkpoints

        params = core.init(jax.random.key(0)).object
        state = {"params": params, "optimiser": optax.adam(1e-3).init(params)}
        with tempfile.TemporaryDirectory() as folder:
            kept = Checkpoints(Path(folder), "doctor")
            kept.save(1, state, {})
            kept.load(state)
            kept.close()
    except Exception as error:  # any incompatibility
        return Check("training", False, f"{type(error).__name__}: {str(error).partition(chr(10))[0]}", remedy)
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("flax", "optax", "orbax-checkpoint"))
    return Check("training", True, versions, remedy)


CHECKS: tuple[Callable[[], Check], ...] = (_python, _mujoco, _jax, _device, _renderer, _encoder, _training, _weights)


def checks() -> list[Check]:
    """Results of all checks. Takes some seconds."""
    return [check() for check in CHECKS]


def report() -> int:
    """Prints the results. Returns 0 if the main function can run, 1 otherwise."""
    results = checks()
    for check in results:
        mark = "ok  " if check.ok else ("FAIL" if check.needed else "note")
        print(f"{mark}  {check.name}: {check.finding}")
        if not check.ok:
            print(f"      {check.remedy}")
    return int(any(c.needed and not c.ok for c in results))
