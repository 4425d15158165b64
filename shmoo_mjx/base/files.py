"""Files that are there whole or not at all, whenever their writer is stopped, in folders that one process keeps.

None of them replaces an input or a file of another kind (guard.py).
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
    """Keep a folder to this process while it writes there; made if absent, and gone again if nothing was written.

    Without POSIX's ``flock`` it is only made.

    Raises:
        ShmooError: another process keeps it.
    """
    folder = Path(folder)
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    # The folder itself is locked: nothing is left in it, and the lock ends with the process, however that ends.
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
    """A temporary name (NAME.PID.tmp, with the ending that a library asks for) whose file becomes ``path`` at the end.

    Missing folders are made. What a killed process was about to write in the same place is removed.

    Raises:
        OSError: with ``path`` as its file, whatever could not be written.
        ShmooError: ``path`` is an input or a file of another kind.
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
    """Write ``content`` to ``path``, whole or not at all; returns the path.

    Raises:
        OSError, ShmooError: as `whole`.
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
        return True  # Elsewhere signal 0 would end the process; rather leave its file.
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True
