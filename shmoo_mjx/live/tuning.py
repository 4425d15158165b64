"""Changes of MPPI's settings during a run: a thread compiles a controller with the new settings.

The number of roll-outs and the horizon are shapes of compiled functions, and the temperature is a constant in them. So
every change needs a compilation of several seconds. Meanwhile the robot keeps its controller.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import NamedTuple

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.live.session import LiveController, Session

_REST = 0.7
"""Time without a change of a slider after which the compilation begins [s]."""


class _Made(NamedTuple):
    """Result of a compilation."""

    controller: LiveController | None
    """The new controller; None if the compilation failed."""
    error: str = ""
    """Why it failed."""


class Tuning:
    """The wanted settings of MPPI, and the compilation of the controller for them. The session's thread calls it."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._wanted: tuple[str, ...] = ()
        self._since = 0.0
        self._compiling: tuple[str, ...] = ()
        self._thread: threading.Thread | None = None
        self._made: _Made | None = None

    @property
    def compiling(self) -> tuple[str, ...]:
        """The settings that are being compiled, as texts; empty if none are."""
        return self._compiling

    @property
    def pending(self) -> bool:
        """Whether settings are wanted or being compiled that the controller does not have yet."""
        return bool(self._wanted or self._compiling)

    def want(self, values: Mapping[str, float]) -> None:
        """Requests values of `MppiConfig` by name. The last request before the compilation counts."""
        control = self.session.controller.config.control
        changed = any(getattr(control, name) != value for name, value in values.items())
        texts = tuple(f"control.{name}={value:g}" for name, value in values.items())
        self._wanted = texts if (changed or self._compiling) and texts != self._compiling else ()
        self._since = time.perf_counter()

    def advance(self) -> str | None:
        """Starts a compilation that is due, and puts a finished controller into use.

        Returns:
            A message about a controller that is in use from now on, or None.

        Raises:
            ShmooError: the compilation failed.
        """
        if self._thread is not None and not self._thread.is_alive():
            return self._finish()
        if self._thread is None and self._wanted and time.perf_counter() - self._since > _REST:
            self._compiling, self._wanted = self._wanted, ()
            self._thread = threading.Thread(target=self._compile, args=(self._compiling,), name="compile", daemon=True)
            self._thread.start()
        return None

    def close(self) -> None:
        """Waits for a running compilation, which cannot be interrupted."""
        if self._thread is not None:
            self._thread.join()

    def _compile(self, settings: tuple[str, ...]) -> None:
        try:
            self._made = _Made(self.session.compiled(settings))
        except Exception as error:  # shown on the page; the run continues
            self._made = _Made(None, f"{type(error).__name__}: {error}")

    def _finish(self) -> str:
        made, settings = self._made, self._compiling
        self._thread, self._made, self._compiling = None, None, ()
        if made is None or made.controller is None:
            raise ShmooError(f"The controller could not be compiled: {made.error if made else 'it ended early'}")
        self.session.use(made.controller, settings)
        return f"MPPI now uses {', '.join(text.removeprefix('control.') for text in settings)}."
