"""Access control of the live page: rejects requests from other web pages and through foreign host names.

A foreign web page can open a websocket to this machine, and a foreign host name can be made to resolve to it (DNS
rebinding). A browser reports both: the page in ``Origin``, the name in ``Host``.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http import HTTPStatus
from typing import Any
from unittest import mock
from urllib.parse import urlsplit

import websockets.asyncio.server

from shmoo_mjx.errors import ShmooError

AT_HOME = ("127.0.0.1", "localhost", "::1")


@contextmanager
def obeying_own_page(host: str) -> Iterator[None]:
    """Makes the server that viser starts in this context listen on ``host`` and reject (403) foreign requests.

    viser has no setting for this, so its function that starts the server is patched in this context.

    Raises:
        ShmooError: the server was started in another way and is not guarded.
    """
    serve, guarded = websockets.asyncio.server.serve, list[bool]()

    def guard(*args: Any, process_request: Callable[..., Any], **kwargs: Any) -> Any:
        def checked(connection: Any, request: Any) -> Any:
            if refused(host, request.headers.get_all("Host"), request.headers.get_all("Origin")):
                return connection.respond(HTTPStatus.FORBIDDEN, "This page answers to its own address only.\n")
            return process_request(connection, request)

        guarded.append(True)
        return serve(*args, process_request=checked, **kwargs)

    with mock.patch.object(websockets.asyncio.server, "serve", guard):
        yield
    if not guarded:
        raise ShmooError("shmoo live can't guard its page with this version of viser; install the version it pins.")


def refused(host: str, hosts: list[str], origins: list[str]) -> bool:
    """Whether a request to a server that listens on ``host`` is foreign.

    Args:
        host: the address that the server listens on.
        hosts: the request's ``Host`` headers. There must be exactly one, with a name of this server.
        origins: its ``Origin`` headers: none (not a browser), or one with the same host and port.
    """
    if len(hosts) != 1 or not _is_own(host, hosts[0]):
        return True
    own = {f"{scheme}://{hosts[0]}".lower() for scheme in ("http", "https")}
    return len(origins) > 1 or any(origin.lower() not in own for origin in origins)


def _is_own(host: str, host_header: str) -> bool:
    """Whether a ``Host`` header names the server that listens on ``host``.

    Any port is allowed, because tunnels change it.
    """
    try:
        name = (urlsplit(f"//{host_header}").hostname or "").lower()
    except ValueError:
        return False
    if name in (*AT_HOME, host.lower()):
        return True
    if host in AT_HOME:
        return False
    this = socket.gethostname().lower()
    if name in (this, f"{this}.local", socket.getfqdn().lower()):
        return True
    # The server listens on every address. An IP address, unlike a name, cannot be redirected.
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_unspecified and bool(ipaddress.ip_address(name))
    return False
