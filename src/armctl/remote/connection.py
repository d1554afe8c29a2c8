"""Connections to policies and environments in other processes."""

import contextlib
import importlib.util
import os
import re
import select
import shutil
import subprocess
import sys
import tempfile
import weakref
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

from armctl.core.errors import ArmctlError, ConfigurationError, ConnectionFailed, missing_extra
from armctl.remote.names import other_python

try:
    from websockets.exceptions import WebSocketException
    from websockets.sync.client import connect

    from armctl.remote.messages import LARGEST, UnreadableMessage, packed, unpacked
except ModuleNotFoundError as error:
    raise missing_extra("A policy or environment in another process", error, "remote") from error

PATIENCE = 10.0
"""s that the other end may take for an answer."""
TO_CLOSE = 0.5
"""s that the other end may take to end a connection."""
TO_START = 120.0
"""s that another Python may take until it has imported what it runs."""
PACKAGES = ("websockets", "msgpack")
"""Packages of this Python that another one may import, after its own."""
LOOPBACK = {"127.0.0.1", "localhost", "::1"}
LAST_FRAME = re.compile(r'^  File "(.+)", line (\d+), in .*\n    (.+)$', re.MULTILINE)
"""File, number and text of a line in a traceback."""
START = """
import sys, types
sys.path.append({packages!r})
package = types.ModuleType("armctl")
package.__path__ = [{armctl!r}]
sys.modules["armctl"] = package
from armctl.remote.host import main
del sys.modules["armctl"]
main({kind!r}, {module!r}, {name!r}, {descriptor})
"""


class OtherEndFailed(ArmctlError):
    """The other end of a connection raised an error, which it told."""


class Connection:
    """A connection to the other end at `url`. Raises `ConnectionFailed`, and `OtherEndFailed`."""

    def __init__(self, url: str, patience: float = PATIENCE) -> None:
        self._place, self.patience = url, patience
        address = urlsplit(url)
        try:
            is_address = address.hostname is not None and address.port != 0
        except ValueError:  # a port that is none
            is_address = False
        if not is_address:
            raise ConfigurationError(f"{url} is no address, such as ws://127.0.0.1:8000")
        with contextlib.ExitStack() as stack, self._failures("does not answer"):
            self._socket = stack.enter_context(
                connect(
                    f"{address.scheme}://{address.netloc}{address.path or '/'}",
                    open_timeout=patience, close_timeout=TO_CLOSE, compression=None, max_size=LARGEST,
                    proxy=None if address.hostname in LOOPBACK else True,
                )
            )  # fmt: skip
            self._close = weakref.finalize(self, stack.pop_all().close)
        self.metadata = self._received()
        """What the other end says of itself."""

    def ask(self, message: dict[str, Any]) -> dict[str, Any]:
        """Return the answer to a message. Raises `ConnectionFailed` and `OtherEndFailed`."""
        with self._failures("has closed the connection"):
            self._socket.send(packed(message))
        return self._received()

    def close(self) -> None:
        """End the connection."""
        self._close()

    def _received(self) -> dict[str, Any]:
        with self._failures("has closed the connection"):
            content = self._socket.recv(self.patience)
        if isinstance(content, str):  # openpi's servers tell errors so
            raise error_in(content)
        with self._failures("answers nonsense"):
            return unpacked(content)

    @contextlib.contextmanager
    def _failures(self, failure: str) -> Any:
        try:
            yield
        except TimeoutError as error:
            self._give_up(f"has not answered for {self.patience:g} s", error)
        except (WebSocketException, OSError, UnreadableMessage) as error:
            self._give_up(f"{failure} ({error or type(error).__name__})", error)

    def _give_up(self, failure: str, error: Exception) -> None:
        if hasattr(self, "_close"):
            self._close()
        raise ConnectionFailed(f"{self._place} {failure}") from error


def error_in(text: str) -> OtherEndFailed:
    """Return an error that reads like the one in a traceback from the other end."""
    name, colon, message = text.strip().rpartition("\n")[2].partition(": ")
    kind = name.rpartition(".")[2]
    frames = LAST_FRAME.findall(text)
    if kind.isidentifier() and frames and not message:
        file, number, message = frames[-1]
        message = f'"{message}" in {Path(file).name}:{number}'
    elif not (colon and kind.isidentifier()):
        kind, message = OtherEndFailed.__name__, f"{name}{colon}{message}" or "an error without a text"
    error: OtherEndFailed = type(kind, (OtherEndFailed,), {})(message)
    error.add_note(f"At the other end:\n{text}")
    return error


def in_words(error: ConnectionFailed | OtherEndFailed) -> str:
    """Return the cause of a failure, with the type of an error of the other end."""
    return f"{type(error).__name__}: {error}" if isinstance(error, OtherEndFailed) else str(error)


class Host:
    """A process of another Python. It ends with this one, or when nothing refers to it any more.

    Raises `ConfigurationError` if it cannot be started.
    """

    def __init__(self, name: str, kind: Literal["policy", "environment"]) -> None:
        code = other_python(name)
        packages = tempfile.mkdtemp(prefix="armctl-")
        for package in PACKAGES:
            (spec,) = filter(None, [importlib.util.find_spec(package)])
            os.symlink(Path(str(spec.origin)).parent, Path(packages, package))
        reading, writing = os.pipe()
        start = START.format(
            packages=packages, armctl=str(Path(__file__).parents[1]), kind=kind, module=code.module, name=code.name,
            descriptor=writing,
        )  # fmt: skip
        try:
            self._process = subprocess.Popen(
                [code.interpreter, "-c", start], pass_fds=[writing], stdin=subprocess.PIPE, stdout=sys.stderr,
            )  # fmt: skip
        except OSError as error:
            os.close(reading)
            shutil.rmtree(packages)
            raise ConfigurationError(f"{name} could not be started: {code.interpreter}: {error.strerror}") from error
        finally:
            os.close(writing)
        self._end = weakref.finalize(self, _end, self._process, packages)
        self.url = f"ws://127.0.0.1:{self._port(name, reading)}"

    @property
    def is_running(self) -> bool:
        """True unless it has died or was ended."""
        return self._end.alive and self._process.poll() is None

    def end(self) -> None:
        """End the process."""
        self._end()

    def _port(self, name: str, reading: int) -> int:
        says = ""
        with os.fdopen(reading) as pipe:
            if select.select([pipe], [], [], TO_START)[0]:
                says = pipe.read()
        if says.strip().isdigit():
            return int(says)
        self.end()
        reason = says.strip().rpartition("\n")[2] or f"it has not started within {TO_START:g} s, or died"
        error = ConfigurationError(f"{name} could not be started: {reason}")
        error.add_note(says)
        raise error


_hosts: "weakref.WeakValueDictionary[tuple[str, str], Host]" = weakref.WeakValueDictionary()


def host_of(name: str, kind: Literal["policy", "environment"]) -> Host:
    """Return the process that runs code for another Python: one for each name, as long as somebody keeps it."""
    host = _hosts.get((name, kind))
    if host is None or not host.is_running:
        host = _hosts[name, kind] = Host(name, kind)
    return host


def _end(process: "subprocess.Popen[bytes]", packages: str) -> None:
    process.kill()
    process.wait()
    if process.stdin is not None:
        process.stdin.close()
    shutil.rmtree(packages, ignore_errors=True)
