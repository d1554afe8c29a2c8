"""Access to the viewer's page: by its address with the token only, and never from pages of others.

MuJoCo Studio's server answers everybody who reaches its port, and so every page that is open in a browser here. `Guard`
stands before it, in the handshake that page, files and WebSockets have in common.
"""

import asyncio
import os
import secrets
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs

from mujoco.studio.web import web_server
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.http11 import Request, Response

from armctl.core.errors import ConfigurationError

NAMES = ("localhost", "127.0.0.1")
"""Names of this machine, as browsers write them. Another name that leads here is DNS rebinding."""
MAX_CONNECTIONS = 48
"""Open at once. A page that loads has eight, and Studio lets nine pages in."""
LARGEST_MESSAGE = 2**16
"""Bytes. A page sends keys, the mouse, its size and what is pasted."""
HANDSHAKE_TIME = 10.0
"""s until a connection must have said what it wants."""
START_TIME = 30.0
"""s until the server must have been started."""
HEADERS = {
    "Access-Control-Allow-Origin": None,
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
}
"""Headers of each response, instead of Studio's: other pages can neither read nor frame it, nor learn the token."""


STUDIO_TITLE = b"MuJoCo Web Viewer"
TITLE = b"armctl".ljust(len(STUDIO_TITLE))
"""Title of the page, instead of Studio's, and of the same length: the length has been announced."""


class Guard:
    """Lets in who asks for an address of the page, from a page of that address or none, with the token.

    The token comes in the address that is printed, `?token=...`, and later in a cookie. Nothing is uploaded: a model
    that is dropped onto the page would only fill memory.
    """

    def __init__(self, port: int) -> None:
        self.token = secrets.token_urlsafe(24)
        self.address = f"http://{NAMES[0]}:{port}/?token={self.token}"
        self.started = threading.Event()
        self._hosts = {f"{name}:{port}" for name in NAMES} | (set(NAMES) if port == 80 else set())
        self._cookie = f"armctl-{port}"  # browsers send a machine's cookies to all of its ports
        self._open: set[ServerConnection] = set()

    async def serve(self, handler: Any, *, process_request: Any, process_response: Any, **options: Any) -> Server:
        """Do what `websockets.asyncio.server.serve` does, for requests that are let in."""

        def request(connection: ServerConnection, request: Request) -> Any:
            problem = self._problem(request)
            if problem:
                return connection.respond(HTTPStatus.FORBIDDEN, f"{problem}\n")
            return process_request(connection, request)

        def response(connection: ServerConnection, request: Request, response: Response) -> Response:
            response = process_response(connection, request, response) or response
            response.body = response.body.replace(STUDIO_TITLE, TITLE)
            for name, value in HEADERS.items():
                if name in response.headers:
                    del response.headers[name]
                if value is not None:
                    response.headers[name] = value
            if response.status_code == HTTPStatus.OK and self._is_token(_query(request)):
                response.headers["Set-Cookie"] = f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
            return response

        server = await serve(
            handler,
            process_request=request,
            process_response=response,
            create_connection=self._counted(),
            **options | {"max_size": LARGEST_MESSAGE, "open_timeout": HANDSHAKE_TIME, "close_timeout": HANDSHAKE_TIME},
        )
        self.started.set()
        return server

    def _problem(self, request: Request) -> str:
        """Return the reason for which a request is not let in; empty if it is."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return f"This page is {' or '.join(sorted(self._hosts))}, on the machine that serves it."
        if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
            return "This is not for pages of others."
        if not (self._is_token(_query(request)) or any(map(self._is_token, self._cookies(request)))):
            return "Open the address that armctl view has printed: it ends in ?token=..."
        if request.path.partition("?")[0] == "/drop":
            return "Nothing can be uploaded here."
        return ""

    def _is_token(self, token: str) -> bool:
        return secrets.compare_digest(token.encode(errors="replace"), self.token.encode())

    def _cookies(self, request: Request) -> Iterator[str]:
        """Values of the page's cookie. Those of other programs may be of any form, which `http.cookies` stops at."""
        for header in request.headers.get_all("Cookie"):
            for cookie in header.split(";"):
                name, _, value = cookie.strip().partition("=")
                if name == self._cookie:
                    yield value

    def _counted(self) -> type[ServerConnection]:
        connections = self._open

        class Counted(ServerConnection):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                super().connection_made(transport)
                connections.add(self)
                if len(connections) > MAX_CONNECTIONS:
                    self.transport.abort()

            def connection_lost(self, exc: Exception | None) -> None:
                connections.discard(self)
                super().connection_lost(exc)

        return Counted


@contextmanager
def guarded(guard: Guard) -> Iterator[None]:
    """Put a guard before the server that Studio starts meanwhile, and wait until it stands there.

    Raises `ConfigurationError` for a version of Studio whose server cannot be guarded.
    """
    if getattr(web_server, "serve", None) is not serve:
        raise unguarded()
    web_server.serve = guard.serve
    try:
        yield
        if not guard.started.wait(START_TIME):
            raise unguarded()
    finally:
        web_server.serve = serve


def unguarded() -> ConfigurationError:
    """Error for a version of Studio that would let everybody in."""
    from importlib.metadata import version

    return ConfigurationError(
        f"MuJoCo {version('mujoco')} would serve this page to others: install a version that armctl knows"
    )


class OwnProcessListener(socket.socket):
    """A listening socket for connections from this process only: Studio's panel talks to its server through one."""

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection; one of another process's is closed, and raises `ConnectionAbortedError`."""
        connection, peer = super().accept()
        if peer in _own_addresses():
            return connection, peer
        connection.close()
        raise ConnectionAbortedError(f"{peer} is another process's")


def _own_addresses() -> set[Any]:
    """Local addresses of all sockets that this process has open."""
    addresses = set()
    for name in os.listdir("/dev/fd"):
        try:
            with socket.socket(fileno=os.dup(int(name))) as listener:
                addresses.add(listener.getsockname())
        except OSError:
            continue  # not a socket, or closed meanwhile
    return addresses


def _query(request: Request) -> str:
    """Return the token in an address; empty without one."""
    return parse_qs(request.path.partition("?")[2]).get("token", [""])[0]
