"""What a user brings as "package.module:Name": found, named in errors, and told apart by its source."""

from __future__ import annotations

import hashlib
import importlib
import sys
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from shmoo_mjx.errors import ShmooError


def named(kind: str, name: str) -> Callable[..., Any]:
    """The class or function that ``name``, "package.module:Name", says; modules in the present folder are found too.

    Raises:
        ShmooError: there is none, or its module can't be imported; ``kind`` says what it was to be.
    """
    module_name, _, attribute = name.partition(":")
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        raise ShmooError(f"{kind} {name}: there is no module {error.name!r}; run from its folder.") from None
    except Exception as error:
        raise ShmooError(f"{kind} {name}: its module can't be imported: {_told(error)}.") from error
    member = getattr(module, attribute, None)
    if not callable(member):
        raise ShmooError(f"{kind} {name}: {module_name} has no class or function {attribute!r}.")
    return member


def call(kind: str, name: str, function: Callable[[], Any]) -> Any:
    """What ``function``, code of the user's, returns.

    Raises:
        ShmooError: the user's code failed; it says in which line.
    """
    try:
        return function()
    except ShmooError:
        raise
    except Exception as error:
        raise ShmooError(f"{kind} {name}: {_told(error)}.") from error


def kept_as(kind: str, name: str, own: Iterable[str]) -> str:
    """``name`` as part of a result's name: what isn't our ``own`` goes with the content of the file it stands in."""
    if name in own:
        return name
    named(kind, name)
    file = sys.modules[name.partition(":")[0]].__file__
    return name if file is None else f"{name}@{hashlib.sha256(Path(file).read_bytes()).hexdigest()[:8]}"


def _told(error: Exception) -> str:
    """What went wrong, and in which line."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} in {Path(last.filename).name}, line {last.lineno}: {error}"
