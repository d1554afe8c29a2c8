"""The guard before Studio's own server, asked by real clients."""

import http.client
import re
import socket
import subprocess
import sys
import time
from typing import Any

import pytest
from mujoco.studio.web import web_server
from websockets.exceptions import ConnectionClosedError, InvalidStatus
from websockets.frames import CloseCode
from websockets.sync.client import connect

from armctl.core.errors import ConfigurationError
from armctl.viewer import guard as module
from armctl.viewer.guard import LARGEST_MESSAGE, MAX_CONNECTIONS, Guard, OwnProcessListener, guarded

MODEL = b"a model's bytes"
PATHS = ("/", "/index.html", "/model", "/web_client.js", "/nothing", "/state", "/ui", "/drop")
WEBSOCKETS = ("/state", "/ui", "/drop")


@pytest.fixture
def served():
    """A guard, before a server that has a model to show."""
    public = web_server.bind_public_socket("127.0.0.1")
    inner = OwnProcessListener(fileno=web_server.bind_loopback_socket().detach())
    guard: Any = Guard(public.getsockname()[1])
    server = web_server.WebServer(http_sock=public, tcp_sock=inner, mjb_data=MODEL)
    with public, inner:
        with guarded(guard):
            server.start()
        guard.port, guard.inner = public.getsockname()[1], inner.getsockname()[1]
        yield guard
        server.stop()


def asked(guard, path, host=None, **headers):
    """Status, headers and body of a page."""
    connection = http.client.HTTPConnection("127.0.0.1", guard.port, timeout=120)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in {"Host": host or f"localhost:{guard.port}", **headers}.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    body = response.read()
    connection.close()
    return response.status, response.headers, body


def cookie(guard, value=None):
    return {"Cookie": f'other={{"a": 1}}; armctl-{guard.port}={value or guard.token}'}


def dialled(guard, path, host="localhost", origin=None, headers=None):
    headers = cookie(guard) if headers is None else headers
    return connect(
        f"ws://{host}:{guard.port}{path}", origin=origin, additional_headers=headers, proxy=None,
        sock=socket.create_connection(("127.0.0.1", guard.port), timeout=120),
    )  # fmt: skip


def test_who_has_the_token_gets_the_page_and_a_cookie_for_the_rest(served):
    status, headers, body = asked(served, f"/?token={served.token}")
    assert (status, b"web_client" in body) == (200, True)
    name, value, *rules = re.split("[=;] ?", headers["Set-Cookie"])
    assert rules == ["Path", "/", "HttpOnly", "SameSite", "Strict"]
    for host in ("localhost", "127.0.0.1"):
        assert asked(served, "/model", f"{host}:{served.port}", Cookie=f"{name}={value}")[::2] == (200, MODEL)
        origin = f"http://{host}:{served.port}"
        with dialled(served, "/state", host, origin, {"Cookie": f"{name}={value}"}) as state:
            assert "role=spectator" in state.recv(timeout=120)
    assert served.address == f"http://localhost:{served.port}/?token={served.token}"


@pytest.mark.parametrize("path", PATHS)
def test_nobody_gets_anything_without_the_token(served, path):
    wrong = ["", "?token=", "?token=" + "x" * 32, f"?token={served.token[:-1]}", "?token=%E2%82%AC%00"]
    assert {asked(served, path + query)[0] for query in wrong} == {403}
    assert asked(served, path, **cookie(served, "x" * 32))[0] == 403
    assert asked(served, path, Cookie=f"armctl-{served.port + 1}={served.token}")[0] == 403
    assert asked(served, path)[1]["Set-Cookie"] is None
    assert served.token.encode() not in asked(served, path)[2]


def test_a_websocket_needs_the_token_too(served):
    for path in WEBSOCKETS:
        for headers in ({}, cookie(served, "x" * 32)):
            with pytest.raises(InvalidStatus, match="403"):
                dialled(served, path, headers=headers)


@pytest.mark.parametrize("host", ["evil.example:{port}", "localhost.evil.example:{port}", "localhost:1", "localhost"])
def test_another_host_is_refused_although_its_name_leads_here(served, host):
    host = host.format(port=served.port)
    for path in PATHS:
        assert asked(served, f"{path}?token={served.token}", host)[0] == 403
        assert asked(served, path, host, **cookie(served))[0] == 403


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://localhost:1", "https://localhost:{port}"])
def test_a_page_of_another_origin_is_refused_although_the_browser_sends_the_cookie(served, origin):
    origin = origin.format(port=served.port)
    for path in WEBSOCKETS:
        with pytest.raises(InvalidStatus, match="403"):
            dialled(served, path, origin=origin)
    status, headers, _ = asked(served, "/model", Origin=origin, **cookie(served))
    assert status == 403
    assert headers["Access-Control-Allow-Origin"] is None


def test_pages_of_others_can_neither_read_nor_frame_the_page(served):
    for path in ("/", "/model", "/web_client.js"):
        _, headers, _ = asked(served, path, **cookie(served))
        assert headers.get_all("Access-Control-Allow-Origin") is None
        assert headers.get_all("Cross-Origin-Resource-Policy") == ["same-origin"]
        assert headers["Content-Security-Policy"] == "frame-ancestors 'none'"
        assert headers["Referrer-Policy"] == "no-referrer"


def test_nothing_is_uploaded_and_messages_are_bounded(served):
    with pytest.raises(InvalidStatus, match="403"):
        dialled(served, "/drop")
    for message in (b"x" * (LARGEST_MESSAGE + 1), "x" * (LARGEST_MESSAGE + 1)):
        with dialled(served, "/state") as state:
            state.send(message)
            with pytest.raises(ConnectionClosedError):
                list(state)
            assert state.close_code == CloseCode.MESSAGE_TOO_BIG


def test_connections_are_bounded_and_come_free_again(served):
    held = [socket.create_connection(("127.0.0.1", served.port), timeout=120) for _ in range(MAX_CONNECTIONS)]
    until = time.monotonic() + 120
    while len(served._open) < MAX_CONNECTIONS and time.monotonic() < until:
        time.sleep(0.05)
    with pytest.raises((http.client.HTTPException, OSError)):
        asked(served, "/model", **cookie(served))
    for connection in held:
        connection.close()
    until = time.monotonic() + 120
    while served._open and time.monotonic() < until:
        time.sleep(0.05)
    assert asked(served, "/model", **cookie(served))[0] == 200


def test_who_says_nothing_is_not_waited_for(served, monkeypatch):
    monkeypatch.setattr(module, "HANDSHAKE_TIME", 0.2)
    other = Guard(served.port)
    public = web_server.bind_public_socket("127.0.0.1")
    with public, web_server.bind_loopback_socket() as inner:
        server = web_server.WebServer(http_sock=public, tcp_sock=inner, mjb_data=MODEL)
        with guarded(other):
            server.start()
        with socket.create_connection(public.getsockname(), timeout=120) as silent:
            assert silent.recv(1) == b""
        server.stop()


def test_the_panel_talks_to_this_process_alone(served):
    knock = f"import socket; print(socket.create_connection(('127.0.0.1', {served.inner}), timeout=120).recv(1))"
    assert subprocess.run([sys.executable, "-c", knock], capture_output=True, text=True).stdout == "b''\n"
    with socket.create_connection(("127.0.0.1", served.inner)) as own, dialled(served, "/ui") as panel:
        panel.send(b"version")
        other = socket.create_connection(("127.0.0.1", served.inner), timeout=120)  # as Studio does for each page
        assert other.recv(7) == b"version"
        own.close()
        other.close()


def test_a_server_that_cannot_be_guarded_is_not_started(monkeypatch):
    monkeypatch.setattr(web_server, "serve", None)
    with pytest.raises(ConfigurationError, match="would serve this page to others"), guarded(Guard(1)):
        pytest.fail("it was started")
    monkeypatch.undo()
    monkeypatch.setattr(module, "START_TIME", 0.01)
    with pytest.raises(ConfigurationError, match="would serve this page to others"), guarded(Guard(1)):
        pass
    assert web_server.serve is module.serve


def test_tokens_differ_and_cannot_be_guessed():
    assert len({Guard(8080).token for _ in range(100)}) == 100
    assert len(Guard(8080).token) >= 32
