"""``shmoo live``: steps the session in real time, and the page with it."""

from __future__ import annotations

import socket
import time
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from shmoo_mjx.base.assets import WEIGHTS, asset
from shmoo_mjx.base.options import SensesName
from shmoo_mjx.errors import ShmooError
from shmoo_mjx.types import DT

if TYPE_CHECKING:
    from shmoo_mjx.live.page import Page

_IDLE = 0.02
"""Time between two looks at what is wanted while the world stands still [s]."""


def run_live(
    scene: str,
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    senses: SensesName = "real",
    weights: Path | None = None,
    out: Path = Path("runs/live"),
    seconds: float | None = None,
) -> int:
    """Open the page and go on until Ctrl-C, or for ``seconds`` of wall-clock time.

    ``scene`` is "demo SEED", a scenario of the package or of ``out`` by its name, or a scenario file.
    """
    missing = [name for name in ("viser", "mjviser") if find_spec(name) is None]
    if missing:
        names = " and ".join(missing)
        raise ShmooError(f"shmoo live needs {names}, not installed here; in a clone, pip install '.[live]'.")
    _check_host(host)
    from shmoo_mjx.learning.weights import load_weights
    from shmoo_mjx.live.own_page import AT_HOME
    from shmoo_mjx.live.page import Page
    from shmoo_mjx.live.session import Session, loader_named

    session = Session(load_weights(weights or asset(WEIGHTS)), loader_named(scene, out), senses, out)
    session.compile()
    page = Page(session, host, port, scene)
    if host not in AT_HOME:
        print(f"Everybody who reaches {host} can use this page; it asks for no password.")
    print(f"{page.url}   (Ctrl-C ends it)", flush=True)
    try:
        go_on(page, seconds)
    except KeyboardInterrupt:
        pass
    finally:
        page.close()
        session.close()
    return 0


def _check_host(host: str) -> None:
    """The server would wait for ever for an address that is not this machine's."""
    try:
        socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError:
        raise ShmooError(f"--host {host!r} is no address of this machine; choose 127.0.0.1 or 0.0.0.0.") from None


def go_on(page: Page, seconds: float | None = None) -> None:
    """Step the page's session at the speed it is set to, until it is closed or for ``seconds`` of wall-clock time."""
    began = time.perf_counter()
    due = began
    while not page.closed and (seconds is None or time.perf_counter() - began < seconds):
        if not page.carry_out():
            time.sleep(_IDLE)
            due = time.perf_counter()
            continue
        page.session.step()
        page.show()
        # What was late is not caught up with: a world in a hurry would be another one.
        due = max(due + (DT / page.speed if page.speed else 0.0), time.perf_counter() - DT)
        time.sleep(max(0.0, due - time.perf_counter()))
