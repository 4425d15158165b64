"""The options ``--quiet`` and ``--verbose`` of all commands, and the logger behind them.

The level of the logger ``shmoo_mjx`` stores the choice. Quiet prints only results and errors. The default shows
progress bars. Verbose prints lines with date and time to stderr instead of bars (``2> run.log`` saves them as a log).
"""

from __future__ import annotations

import inspect
import logging
import platform
import re
import sys
import time
import typing
from collections.abc import Callable
from importlib import metadata
from typing import Any

import tyro
from tyro.conf import FlagCreatePairsOff

from shmoo_mjx.errors import ShmooError

LOG = logging.getLogger("shmoo_mjx")

_OPTIONS = """\
    quiet: print only results and errors.
    verbose: print log lines with date and time to stderr, instead of progress bars.
"""


def is_quiet() -> bool:
    """Whether progress is switched off (``--quiet``)."""
    return LOG.getEffectiveLevel() > logging.WARNING


def is_verbose() -> bool:
    """Whether progress is printed as log lines (``--verbose``)."""
    return LOG.getEffectiveLevel() <= logging.INFO


def with_verbosity(command: Callable[..., int]) -> Callable[..., int]:
    """Decorator that adds ``--quiet`` and ``--verbose`` to a command, for a parser of its signature and docstring."""

    def run(*arguments: Any, quiet: bool = False, verbose: bool = False, **options: Any) -> int:
        _set(quiet, verbose)
        started = time.monotonic()
        LOG.info(
            "shmoo %s, Python %s: %s", metadata.version("shmoo-mjx"), platform.python_version(), " ".join(sys.argv[1:])
        )
        code = command(*arguments, **options)
        LOG.info("took %.1f s, exit code %d", time.monotonic() - started, code)
        return code

    flag = FlagCreatePairsOff[bool]
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=flag)
        for name in ("quiet", "verbose")
    ]
    signature = inspect.signature(command)
    run.__signature__ = signature.replace(parameters=[*signature.parameters.values(), *added])  # type: ignore[attr-defined]
    hints = typing.get_type_hints(command, include_extras=True) | {"quiet": flag, "verbose": flag}
    for name, parameter in signature.parameters.items():
        if parameter.default in (None, ()):  # The help text itself states what happens by default.
            hints[name] = typing.Annotated[hints[name], tyro.conf.arg(help_behavior_hint="")]
    run.__annotations__ = hints
    # tyro would print the continuation lines of an argument as lines of their own.
    doc = re.sub(r"\n {8}(?=\S)", " ", inspect.getdoc(command) or "")
    run.__doc__ = doc.rstrip() + ("\n" if "\nArgs:\n" in doc else "\n\nArgs:\n") + _OPTIONS
    run.__name__ = command.__name__
    return run


def _set(quiet: bool, verbose: bool) -> None:
    if quiet and verbose:
        raise ShmooError("--quiet and --verbose exclude each other; give one of them.")
    LOG.setLevel(logging.ERROR if quiet else logging.INFO if verbose else logging.WARNING)
    for handler in list(LOG.handlers):
        LOG.removeHandler(handler)
    if verbose:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(logging.Formatter("%(asctime)s %(message)s", "%Y-%m-%d %H:%M:%S"))
        LOG.addHandler(handler)
        LOG.propagate = False
