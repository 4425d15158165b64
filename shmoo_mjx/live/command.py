"""``shmoo live``: runs a session in real time together with its page."""

from __future__ import annotations

import socket
import time
from collections.abc import Sequence
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
"""Time between two checks for requests while the simulation is paused [s]."""


def run_live(
    scene: str,
    *,
    host: str = "127.0.0.1",
    port: int = 8080,
    senses: SensesName = "real",
    weights: Path | None = None,
    out: Path = Path("runs/live"),
    seconds: float | None = None,
    settings: Sequence[str] = (),
) -> int:
    """Opens the page and runs the simulation until Ctrl-C, or for ``seconds`` of wall-clock time.

    Args:
        scene: "demo SEED", the name of a scenario of the package or of ``out``, or a scenario or map file.
        host: network interface to listen on.
        port: first port to try.
        senses: "real" or "perfect".
        weights: trained weights; the shipped ones if None.
        out: folder for scenes and reports that are saved on the page.
        seconds: wall-clock time after which the command ends [s].
        settings: "NAME=VALUE" texts that replace settings of the run (`shmoo_mjx.behavior.settings`).

    Returns:
        The exit status.

    Raises:
        ShmooError: viser or mjviser is missing, the host is not an address of this machine, or the scene, the weights
            or a setting are not valid.
    """
    missing = [name for name in ("viser", "mjviser") if find_spec(name) is None]
    if missing:
        names = " and ".join(missing)
        raise ShmooError(
            f"shmoo live needs {names}, which are not installed; in a clone, type uv run shmoo live, "
            "or pip install '.[live]'."
        )
    _check_host(host)
    from shmoo_mjx.learning.weights import load_weights
    from shmoo_mjx.live.own_page import AT_HOME
    from shmoo_mjx.live.page import Page
    from shmoo_mjx.live.scenes import loader_named
    from shmoo_mjx.live.session import Session

    loaded = load_weights(weights or asset(WEIGHTS))
    session = Session(loaded, loader_named(scene, out), senses, out, settings=settings)
    session.compile()
    page = Page(session, host, port, scene)
    if host not in AT_HOME:
        print(f"Anyone who can reach {host} can use this page; it has no password.")
    print(f"{page.url}   (Ctrl-C to stop)", flush=True)
    try:
        go_on(page, seconds)
    except KeyboardInterrupt:
        pass
    finally:
        page.close()
        session.close()
    return 0


def _check_host(host: str) -> None:
    """Raises an error for an address of another machine, for which the server would wait for ever."""
    try:
        socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError:
        raise ShmooError(f"--host {host!r} is not an address of this machine; choose 127.0.0.1 or 0.0.0.0.") from None


def go_on(page: Page, seconds: float | None = None) -> None:
    """Steps the page's session at the page's speed, until it is closed or for ``seconds`` of wall-clock time."""
    began = time.perf_counter()
    due = began
    while not page.closed and (seconds is None or time.perf_counter() - began < seconds):
        if not page.carry_out():
            time.sleep(_IDLE)
            due = time.perf_counter()
            continue
        page.session.step()
        page.show()
        # Lost time is not made up for, so that the motion never looks faster than the chosen speed.
        due = max(due + (DT / page.speed if page.speed else 0.0), time.perf_counter() - DT)
        time.sleep(max(0.0, due - time.perf_counter()))
