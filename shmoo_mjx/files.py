"""Files that are there whole or not at all, whenever the process that writes them is stopped."""

from __future__ import annotations

import os
import re
from pathlib import Path

__all__ = ["write_whole"]


def write_whole(path: Path, content: bytes) -> None:
    """Write ``content`` under a temporary name (NAME.PID.tmp), then rename it to ``path``.

    What a killed process was about to write in the same place is removed.
    """
    _clear_abandoned(path)
    temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _clear_abandoned(path: Path) -> None:
    pattern = re.compile(re.escape(path.name) + r"\.(\d+)\.tmp")
    for other in path.parent.iterdir():
        found = pattern.fullmatch(other.name)
        if found and not _alive(int(found[1])):
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
