"""The live page obeys its own page only: real requests over loopback, and which hosts and origins are its own."""

# ruff: noqa: E402 (without the extra the file is skipped before it imports what needs it)
from __future__ import annotations

import http.client
import socket
from collections.abc import Iterator

import pytest

viser = pytest.importorskip("viser")
pytest.importorskip("mjviser")

import websockets.asyncio.server
import websockets.sync.client
from websockets.exceptions import InvalidStatus

from shmoo_mjx.errors import ShmooError
from shmoo_mjx.live.own_page import obeying_own_page, refused


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with obeying_own_page("127.0.0.1"):
        server = viser.ViserServer(host="127.0.0.1", port=18080, verbose=False)
    yield server.get_port()
    server.stop()


OWN = ("127.0.0.1:{}", "localhost:{}", "LOCALHOST:{}", "[::1]:{}", "localhost")
FOREIGN = ("evil.example", "evil.example:{}", "127.0.0.1.evil.example:{}", "localhost@evil.example", "192.0.2.1:{}", "",
           "[::1", "0.0.0.0:{}")  # fmt: skip


def status(port: int, host: str, **headers: str) -> int:
    client = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    client.putrequest("GET", "/", skip_host=True)
    for name, value in {"Host": host.format(port), **headers}.items():
        client.putheader(name, value.format(port))
    client.endheaders()
    answer = client.getresponse()
    answer.read()
    client.close()
    return answer.status


def test_the_page_answers_to_its_own_names_only(port: int) -> None:
    assert [status(port, host) for host in OWN] == [200] * len(OWN)
    assert [status(port, host) for host in FOREIGN] == [403] * len(FOREIGN)
    assert status(port, "127.0.0.1:{}", Origin="http://evil.example") == 403
    assert status(port, "127.0.0.1:{}", Origin="http://127.0.0.1:{}") == 200


@pytest.mark.parametrize(
    ("origin", "own"),
    [
        ("http://127.0.0.1:{}", True),
        (None, True),  # no browser
        ("http://evil.example", False),
        ("http://localhost:{}", False),  # another host than that of the request
        ("http://127.0.0.1:1", False),  # another server of this machine
        ("http://127.0.0.1:{}.evil.example", False),
        ("null", False),  # a file, or a frame without rights
        ("", False),
        ("file://127.0.0.1:{}", False),
    ],
)
def test_a_websocket_is_for_the_own_page_only(port: int, origin: str | None, own: bool) -> None:
    def connect() -> None:
        websockets.sync.client.connect(
            f"ws://127.0.0.1:{port}", origin=origin and origin.format(port),
            subprotocols=[f"viser-v{viser.__version__}"], additional_headers={} if origin != "" else {"Origin": ""},
            max_size=None, proxy=None,
        ).close()  # fmt: skip

    if own:
        connect()
    else:
        with pytest.raises(InvalidStatus) as answer:
            connect()
        assert answer.value.response.status_code == 403


@pytest.mark.parametrize(
    ("listens", "asked", "own"),
    [
        ("localhost", "127.0.0.1:8080", True),
        ("127.0.0.1", socket.gethostname(), socket.gethostname() == "localhost"),
        ("0.0.0.0", f"{socket.gethostname()}:8080", True),
        ("0.0.0.0", "192.0.2.7:8080", True),
        ("::", "[2001:db8::1]:8080", True),
        ("0.0.0.0", "evil.example:8080", False),
        ("192.0.2.7", "192.0.2.7:8080", True),
        ("192.0.2.7", "192.0.2.8:8080", False),
        ("robot.example", "robot.example", True),
        ("robot.example", "evil.example", False),
    ],
)
def test_whose_name_is_its_own(listens: str, asked: str, own: bool) -> None:
    assert refused(listens, [asked], []) is not own
    assert refused(listens, [asked], [f"http://{asked}"]) is not own
    assert refused(listens, [asked], [f"http://{asked}", f"http://{asked}"])
    assert refused(listens, [asked, asked], []) and refused(listens, [], [])


def test_a_server_that_is_started_in_another_way_is_no_guarded_one() -> None:
    with pytest.raises(ShmooError, match="viser"), obeying_own_page("127.0.0.1"):
        pass


def test_servers_that_are_made_later_are_as_they_were() -> None:
    serve = websockets.asyncio.server.serve
    with obeying_own_page("127.0.0.1"):
        viser.ViserServer(host="127.0.0.1", port=18090, verbose=False).stop()
    assert websockets.asyncio.server.serve is serve
