"""The web server: bound to this machine, closed to strangers, without a tunnel.

viser listens on all networks by default, asks no request where it comes from, and can open a public tunnel. A page of another site that is
open in the same browser could then talk to it. Here every request is checked before viser sees it.
"""

from __future__ import annotations

import contextlib
import http
import http.client
import io
import ipaddress
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server
from websockets import Headers
from websockets.http11 import Request, Response

from rtgs.base.errors import RtgsError

Answer = Callable[[Any, Request], Any]
_ONE_AT_A_TIME = threading.Lock()
_STRANGER = "stranger.invalid"  # RFC 2606: never anybody's name


class GuardedServer(viser.ViserServer):
    """A viser server that answers requests to its own address from its own pages alone.

    Args:
        host: address to bind to. port: 0: any free one.

    Raises:
        RtgsError: the address cannot be bound, or viser cannot be guarded (another version of it).
    """

    def __init__(self, host: str, port: int, label: str) -> None:
        _check_address(host, port)
        with _guarded(Guard(host)), contextlib.redirect_stdout(io.StringIO()):
            super().__init__(host=host, port=port, label=label, verbose=False)
        if not self._refuses_strangers():
            self.stop()
            raise RtgsError("This version of viser cannot be kept to this machine. Install viser 1.1: pip install 'rtgs[view]'.")

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Opens no tunnel, whoever asks."""
        return None

    def stop(self) -> None:
        """Close all connections and the server."""
        with contextlib.redirect_stdout(io.StringIO()):
            super().stop()

    @property
    def url(self) -> str:
        host = self.get_host()
        shown = "localhost" if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self.get_port()}"

    def _refuses_strangers(self) -> bool:
        """Whether the check is in place: asked as a stranger."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.get_host(), self.get_host())
        connection = http.client.HTTPConnection(host, self.get_port(), timeout=30)
        try:
            connection.request("GET", "/", headers={"Host": _STRANGER})
            return connection.getresponse().status == http.HTTPStatus.FORBIDDEN
        except (OSError, http.client.HTTPException):
            return False
        finally:
            connection.close()


class Guard:
    """Which requests are answered.

    The Host of a request has to be this server: else a name of somebody else that leads here (DNS rebinding) would do. The Origin,
    where a request has one, has to be the page of this very server. The path stays inside viser's pages.
    """

    def __init__(self, host: str) -> None:
        self._names = {"localhost", "127.0.0.1", "::1", host.lower()}
        self._everywhere = host in ("0.0.0.0", "::")
        if self._everywhere:
            self._names |= {socket.gethostname().lower(), socket.getfqdn().lower()}

    def refusal(self, request: Request) -> Response | None:
        """The answer to a request that is not from here; None for one that is."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_ours(hosts[0]):
            return _refuse("This server answers to its own address alone.")
        if len(origins) > 1 or any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
            return _refuse("This server answers its own pages alone.")
        return None

    def _is_ours(self, host: str) -> bool:
        try:
            name = (urlsplit(f"//{host}").hostname or "").lower()
        except ValueError:
            return False
        if self._everywhere:
            with contextlib.suppress(ValueError):
                ipaddress.ip_address(name)  # an address is nobody's to rebind
                return True
        return name in self._names


def _refuse(reason: str) -> Response:
    body = reason.encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body)), "Connection": "close"})
    return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, body)


@contextlib.contextmanager
def _guarded(guard: Guard) -> Iterator[None]:
    """Within the block, a server that viser starts asks the guard first. viser has no place of its own to put a check."""
    module = websockets.asyncio.server
    serve = module.serve

    def guarded(*args: Any, process_request: Answer | None = None, **kwargs: Any) -> Any:
        def answer(connection: Any, request: Request) -> Any:
            refusal = guard.refusal(request)
            if refusal is not None or process_request is None:
                return refusal
            return process_request(connection, request)

        return serve(*args, process_request=answer, **kwargs)

    with _ONE_AT_A_TIME:
        module.serve = guarded  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            module.serve = serve  # type: ignore[misc]


def _check_address(host: str, port: int) -> None:
    """Raises `RtgsError` where nothing can be bound at this address: viser would try for ever."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with contextlib.closing(socket.socket(family, socket.SOCK_STREAM)) as probe:
        try:
            probe.bind((host, 0))
        except (OSError, OverflowError) as error:
            raise RtgsError(f"--host {host}: is no address of this machine ({error}). Leave it out, or name one.") from error
    if not 0 <= port <= 65535:
        raise RtgsError(f"--port {port}: a port is a number from 0 to 65535.")
