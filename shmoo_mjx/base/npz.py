"""Reads and writes array files (.npz)."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from shmoo_mjx.base.files import whole
from shmoo_mjx.errors import ShmooError


def write_arrays(path: str | Path, arrays: dict[str, np.ndarray]) -> Path:
    """Write an ``.npz`` file atomically and return its path."""
    with whole(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    return Path(path)


def read_arrays(path: Path, what: str) -> dict[str, np.ndarray]:
    """Read an ``.npz`` file of a run.

    Args:
        path: file to read.
        what: what the file is, for the error message.

    Raises:
        ShmooError: the file is missing or damaged.
    """
    try:
        # Given a path instead of an open file, NumPy leaves the file open if it is not an archive.
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise ShmooError(f"{path}: there is no {what} here; give the folder of a finished run.") from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        raise ShmooError(f"{path}: the {what} is damaged; run the scenario again.") from None
