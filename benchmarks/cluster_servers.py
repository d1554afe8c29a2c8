"""Clusters of Ray and Dask on this machine, each node a process with one core, for `benchmarks/clusters.py`."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from armctl.core.errors import ConfigurationError
from armctl.runtime.engines import connect

BIN = Path(sys.executable).parent
LONGEST_START = 120.0
"""s"""
QUIET = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled"}
os.environ |= QUIET


@contextlib.contextmanager
def ray_cluster(workers: int) -> Iterator[str]:
    """Yield the address of a cluster of Ray with so many nodes."""
    with tempfile.TemporaryDirectory(prefix="ray-", ignore_cleanup_errors=True) as folder, _Servers() as servers:
        port, client = _free_port(), _free_port()
        common = ["--num-cpus=1", "--block", "--disable-usage-stats"]
        servers.start(
            "ray", "start", "--head", "--node-ip-address=127.0.0.1", f"--port={port}", "--include-dashboard=false",
            f"--ray-client-server-port={client}", f"--temp-dir={folder}", *common,
        )  # fmt: skip
        address = f"ray://127.0.0.1:{client}"
        _until(lambda: _answers(client) and _workers(address) == 1, "Ray's head")
        for _ in range(workers - 1):
            servers.start("ray", "start", f"--address=127.0.0.1:{port}", *common)
        _until(lambda: _workers(address) == workers, "Ray's nodes")
        yield address


@contextlib.contextmanager
def dask_cluster(workers: int) -> Iterator[str]:
    """Yield the address of a scheduler of Dask with so many workers."""
    with _Servers() as servers:
        port = _free_port()
        servers.start("dask", "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard")
        _until(lambda: _answers(port), "Dask's scheduler")
        for _ in range(workers):
            servers.start("dask", "worker", f"tcp://127.0.0.1:{port}", "--nthreads=1", "--no-nanny", "--no-dashboard")
        address = f"dask://127.0.0.1:{port}"
        _until(lambda: _workers(address) == workers, "Dask's workers")
        yield address


class _Servers:
    """Processes that end with their context, each with all its children. They get a folder of their own."""

    def __enter__(self) -> "_Servers":
        self._folder = tempfile.TemporaryDirectory(prefix="servers-", ignore_cleanup_errors=True)
        self._started: list[subprocess.Popen[bytes]] = []
        return self

    def start(self, *command: object) -> None:
        program, *arguments = map(str, command)
        log = Path(self._folder.name, f"log{len(self._started)}")  # a pipe would keep `ray start` from ending
        with log.open("w") as output:
            process = subprocess.Popen(
                [str(BIN / program), *arguments], stdin=subprocess.DEVNULL, stdout=output, stderr=output,
                cwd=self._folder.name, start_new_session=True,
            )  # fmt: skip
        self._started.append(process)

    def __exit__(self, *_: object) -> None:
        for process in reversed(self._started):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        self._folder.cleanup()


def _until(ready: Callable[[], bool], server: str) -> None:
    deadline = time.monotonic() + LONGEST_START
    while not ready():
        if time.monotonic() > deadline:
            raise SystemExit(f"{server} did not start within {LONGEST_START:g} s")
        time.sleep(0.2)


def _answers(port: int) -> bool:
    with socket.socket() as connection:
        return connection.connect_ex(("127.0.0.1", port)) == 0


def _workers(address: str) -> int:
    with contextlib.suppress(ConfigurationError), connect(address) as engine:
        return engine.count()  # type: ignore[attr-defined]
    return 0


def _free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return int(server.getsockname()[1])
