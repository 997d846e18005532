"""The server answers its own pages alone, and opens no tunnel."""

from __future__ import annotations

import http.client
from collections.abc import Iterator

import pytest
import viser
from tests.helpers.chromium import PATIENCE_S
from websockets.asyncio.server import serve
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from rtgs.base.errors import RtgsError
from rtgs.viewer.guard import GuardedServer


@pytest.fixture(scope="module")
def server() -> Iterator[GuardedServer]:
    found = GuardedServer("127.0.0.1", 0, "guarded")
    yield found
    found.stop()


def status(server: GuardedServer, path: str = "/", **headers: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=PATIENCE_S)
    try:
        connection.putrequest("GET", path, skip_host="Host" in headers)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        return connection.getresponse().status
    finally:
        connection.close()


def knock(server: GuardedServer, origin: str | None) -> int:
    """The status that a WebSocket gets; 101 where it is let in."""
    try:
        with connect(
            f"ws://127.0.0.1:{server.get_port()}",
            origin=None if origin is None else Origin(origin),
            subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
            open_timeout=PATIENCE_S,
        ):
            return 101
    except InvalidStatus as refused:
        return int(refused.response.status_code)


def test_its_own_page_is_answered(server: GuardedServer) -> None:
    port = server.get_port()
    assert status(server) == 200
    for host in (f"127.0.0.1:{port}", f"localhost:{port}", f"LOCALHOST:{port}", f"[::1]:{port}"):
        assert status(server, Host=host) == 200, host
    assert status(server, Origin=f"http://127.0.0.1:{port}") == 200
    assert server.url == f"http://127.0.0.1:{port}"


@pytest.mark.parametrize(
    "host", ["attacker.example", "127.0.0.1.attacker.example", "", "localhost@attacker.example", "[", "192.168.0.7"]
)
def test_a_foreign_host_is_refused(server: GuardedServer, host: str) -> None:
    assert status(server, Host=host) in (400, 403)


@pytest.mark.parametrize(
    "origin", ["http://attacker.example", "null", "http://localhost", "http://127.0.0.1:1", "https://{own}", "file://"]
)
def test_a_foreign_origin_is_refused(server: GuardedServer, origin: str) -> None:
    origin = origin.format(own=f"127.0.0.1:{server.get_port()}")
    assert status(server, Origin=origin) == 403
    assert knock(server, origin) == 403


def test_its_own_page_may_open_a_socket(server: GuardedServer) -> None:
    assert knock(server, f"http://127.0.0.1:{server.get_port()}") == 101


@pytest.mark.parametrize(
    "path",
    [
        "/../../../../../../etc/passwd",
        "/..%2f..%2f..%2f..%2f..%2fetc/passwd",
        "/%2e%2e/%2e%2e/%2e%2e/_viser.py",
        "/..\\..\\_viser.py",
        "//etc/passwd",
        "/assets/../../../_viser.py",
        "/index.html/../../_viser.py",
    ],
)
def test_nothing_outside_of_the_pages_is_given(server: GuardedServer, path: str) -> None:
    assert status(server, path) == 404


def test_no_tunnel_is_opened(server: GuardedServer) -> None:
    assert server.request_share_url() is None
    assert server._share_tunnel is None


def test_viser_is_itself_again(server: GuardedServer) -> None:
    """What was replaced while the server started is in its place: other servers of this process are as viser makes them."""
    assert serve.__qualname__ == "serve" and serve.__module__ == "websockets.asyncio.server"


def test_an_address_of_another_machine_is_refused() -> None:
    with pytest.raises(RtgsError, match="no address of this machine"):
        GuardedServer("192.0.2.1", 0, "elsewhere")
    with pytest.raises(RtgsError, match="port"):
        GuardedServer("127.0.0.1", 70000, "too high")
