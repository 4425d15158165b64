"""Recording of a run: the navigator's observations and commands, sample by sample."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from shmoo_mjx.base.npz import read_arrays, write_arrays
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.types import Command, Observation

RECORDING_FILE = "recorded.npz"
"""Name of the recording in a run's folder."""
_VERSION = 1
"""Version of the file's layout."""


class Recording(NamedTuple):
    """Inputs and outputs of the navigator, sample by sample."""

    observations: Observation
    """Fields ``[T, 1, ...]``."""
    commands: Command
    """Fields ``[T, 1, ...]``."""
    goals: np.ndarray
    """``[T, 2]`` goal in {W} [m]."""


def save_recording(path: Path, recorded: Recording) -> None:
    """Writes a run's observations and commands."""
    arrays = {f"observation.{k}": v for k, v in recorded.observations._asdict().items()}
    arrays |= {f"command.{k}": v for k, v in recorded.commands._asdict().items()}
    write_arrays(path, arrays | {"goals": recorded.goals, "version": np.array(_VERSION)})


def load_recording(path: Path) -> Recording:
    """Reads a recording.

    Raises:
        ShmooError: the file is missing, damaged, or of another version.
    """
    arrays = read_arrays(path, "recording")
    names = {"goals", *(f"observation.{n}" for n in Observation._fields), *(f"command.{n}" for n in Command._fields)}
    if int(arrays.get("version", np.array(-1))) != _VERSION or not names <= set(arrays):
        raise ShmooError(f"{path}: the recording is of another version of shmoo_mjx; run the scenario again.")
    return Recording(
        Observation(*(arrays[f"observation.{n}"] for n in Observation._fields)),
        Command(*(arrays[f"command.{n}"] for n in Command._fields)),
        arrays["goals"],
    )
