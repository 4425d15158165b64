"""Atomic file writing and folder locks.

Files are written completely or not at all, even if the process is killed. Writing never replaces an input file or a
file of another kind (guard.py).
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from shmoo_mjx.base.guard import check_output, kind_of
from shmoo_mjx.errors import ShmooError


@contextmanager
def claimed(folder: str | Path) -> Iterator[None]:
    """Lock a folder for this process while it writes there.

    A missing folder is created, and removed again if nothing was written. Without POSIX's ``flock`` there is no lock.

    Raises:
        ShmooError: another process has locked the folder.
    """
    folder = Path(folder)
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    # Lock the folder itself: this needs no lock file, and the lock ends with the process, even if it is killed.
    descriptor = os.open(folder, os.O_RDONLY) if os.name == "posix" else None
    try:
        if descriptor is not None:
            _lock(descriptor, folder)
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)
        if made:
            with suppress(OSError):
                folder.rmdir()


@contextmanager
def whole(path: str | Path, suffix: str = "") -> Iterator[Path]:
    """Context manager for writing a file atomically.

    It yields a temporary path, NAME.PID.tmp, and renames this file to ``path`` at the end. Missing folders are created.
    Temporary files of killed processes for the same ``path`` are removed.

    Args:
        path: file to write.
        suffix: suffix of the temporary path, if a library needs one.

    Raises:
        OSError: writing failed; its filename is ``path``.
        ShmooError: ``path`` is a folder, an input or a file of another kind.
    """
    path = Path(path)
    check_output(path)
    temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp{suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _clear_abandoned(path)
        yield temporary
        check_output(path, kind_of(temporary, path.name) if path.exists() else "")
        os.replace(temporary, path)
    except OSError as error:
        if error.filename not in (None, temporary, str(temporary)):
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_whole(path: str | Path, content: bytes) -> Path:
    """Write ``content`` to ``path`` atomically and return the path.

    Raises:
        OSError, ShmooError: see `whole`.
    """
    with whole(path) as temporary, open(temporary, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    return Path(path)


def _lock(descriptor: int, folder: Path) -> None:
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ShmooError(f"{folder}: another process writes there; wait for it, or name another folder.") from None


def _clear_abandoned(path: Path) -> None:
    pattern = re.compile(re.escape(path.name) + r"\.(\d+)\.tmp(\.\w+)?")
    for other in path.parent.iterdir():
        match = pattern.fullmatch(other.name)
        if match and not _alive(int(match[1])):
            other.unlink(missing_ok=True)


def _alive(process: int) -> bool:
    if os.name != "posix":
        return True  # On other systems signal 0 would end the process, so keep the file.
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True
