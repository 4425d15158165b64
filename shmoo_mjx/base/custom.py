"""Loads user code given as "package.module:Name", reports its errors, and identifies it by its source."""

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
    """Import a class or function given as "package.module:Name". Modules in the current folder are found too.

    Args:
        kind: what the name stands for, for the error message.
        name: "package.module:Name".

    Raises:
        ShmooError: ``name`` has another form, the class or function does not exist, or its module can't be imported.
    """
    module_name, _, attribute = name.partition(":")
    if not (module_name and attribute):
        raise ShmooError(f"{kind} {name}: is no class or function; give it as package.module:Name.")
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
    """Call user code and return its result.

    Args:
        kind: what the code stands for, for the error message.
        name: name of the code, for the error message.
        function: user code to call.

    Raises:
        ShmooError: the user code raised an exception. The message names the line.
    """
    try:
        return function()
    except ShmooError:
        raise
    except Exception as error:
        raise ShmooError(f"{kind} {name}: {_told(error)}.") from error


def kept_as(kind: str, name: str, own: Iterable[str]) -> str:
    """``name`` as part of a result's name. For user code, a hash of its source file is appended.

    Args:
        kind: what the name stands for, for the error message.
        name: built-in name or "package.module:Name".
        own: built-in names, which are returned unchanged.
    """
    if name in own:
        return name
    named(kind, name)
    file = sys.modules[name.partition(":")[0]].__file__
    return name if file is None else f"{name}@{hashlib.sha256(Path(file).read_bytes()).hexdigest()[:8]}"


def _told(error: Exception) -> str:
    """The error with its type, file and line."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} in {Path(last.filename).name}, line {last.lineno}: {error}"
