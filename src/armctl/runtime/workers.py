"""A cluster's worker, seen from within: it works for each comparison in a new process of its own.

Nothing of other work is left in that process: neither modules as they were once, nor a folder, nor a picture's context.
"""

import functools
import os
import platform
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from armctl.core.errors import FAILURES, ArmctlError, described
from armctl.runtime.folder import differences
from armctl.runtime.identity import checksum_of_core
from armctl.runtime.provenance import versions
from armctl.runtime.sending import FORMAT_NUMBER, JobBundle

PARENT_CHECK = 1.0
"""s between two looks of a process whether its parent still lives."""

Work = Callable[..., Any]
"""A function of what all units share, and of a unit's own arguments. It lies in a module of armctl."""


class WorkersFailed(ArmctlError):
    """Workers died, could not load what they were sent, or have other versions than this process."""


@functools.cache
def environment_of(work: Work) -> dict[str, Any]:
    """Return what must be alike on all machines that do this work, or their results must not be mixed."""
    _, *folders = work.__module__.split(".")
    source = checksum_of_core(*folders[:1])
    return {"machine": platform.machine(), "bundles": FORMAT_NUMBER, "versions": versions(), "source": source}


def run_isolated(work: Work, bundle: JobBundle, expected: Mapping[str, Any], unit: tuple[Any, ...]) -> Any:
    """Do a unit in a worker of a cluster: in a process of its own, in which nothing is left of other work."""
    check_same_identity(expected, environment_of(work))
    with _ONE_AT_A_TIME:
        child = _Child.of(bundle)
        try:
            return child.executor.submit(_work, work, unit).result()
        except BrokenProcessPool:
            child.end()
            raise WorkersFailed(f"{unit[0]}: its process on {platform.node()} died") from None
        except (KeyboardInterrupt, SystemExit):  # by which Ray cancels
            child.end()
            raise


_ONE_AT_A_TIME = threading.Lock()
"""A worker of Dask may have several threads, but it has one core for each worker that we count."""


class _Child:
    """A process of a cluster's worker, made for one bundle, and the folder in which it works."""

    _present: "_Child | None" = None

    def __init__(self, bundle: JobBundle) -> None:
        from joblib.externals.loky import ProcessPoolExecutor  # which only clusters' workers need

        self.bundle, self.root = bundle, Path(tempfile.mkdtemp(prefix="armctl-"))
        bundle.write(self.root)
        self.executor = ProcessPoolExecutor(1, initializer=_open, initargs=(os.getpid(), bundle, self.root))

    @classmethod
    def of(cls, bundle: JobBundle) -> "_Child":
        """Return the present process, or a new one if that has another bundle."""
        if cls._present is None or cls._present.bundle != bundle:
            if cls._present is not None:
                cls._present.end()
            cls._present = cls(bundle)
        return cls._present

    def end(self) -> None:
        """Kill the process, and delete its folder."""
        self.executor.shutdown(kill_workers=True)
        shutil.rmtree(self.root, ignore_errors=True)
        _Child._present = None


_opened: dict[str, Any] = {}
"""Objects of a child process, and the function that opens what was sent."""


def _open(parent: int, bundle: JobBundle, root: Path) -> None:
    end_with_parent(parent, root)
    _opened["open"] = functools.partial(bundle.open_in, root)


def _work(work: Work, unit: tuple[Any, ...]) -> Any:
    """Do a unit in a child. Whatever is raised can be sent back."""
    try:
        if "objects" not in _opened:
            _opened["objects"] = _opened["open"]()
        return work(_opened["objects"], *unit)
    except WorkersFailed:
        raise
    except FAILURES as error:
        raise WorkersFailed(f"{unit[0]} cannot be done on {platform.node()}: {described(error)}") from None


def check_same_identity(expected: Mapping[str, Any], local: Mapping[str, Any]) -> None:
    """Raise `WorkersFailed` in a worker for any difference to the process that sent the work."""
    if others := differences(local, expected):
        raise WorkersFailed(
            f"the worker on {platform.node()} differs, and its results must not be mixed with others: "
            + "; ".join(others)
        )


def end_with_parent(parent: int, folder: Path | None = None) -> None:
    """Let this process end when its parent has gone, however that ended, and not by Ctrl-C before.

    A folder of its own is deleted then.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_CHECK)
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
