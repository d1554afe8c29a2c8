"""Servers that a test starts, and that end with it."""

import contextlib
import os
import signal
import subprocess


class Processes:
    """Servers that end with the test, each with all its children."""

    def __init__(self, folder):
        self.folder, self.started = folder, []

    def start(self, *command, environment=None):
        with (self.folder / f"log{len(self.started)}").open("w") as log:
            one = subprocess.Popen(
                [*map(str, command)], stdout=log, stderr=log, stdin=subprocess.DEVNULL, start_new_session=True,
                cwd=self.folder, env=os.environ | (environment or {}),
            )  # fmt: skip
        self.started.append(one)
        return one

    def output(self):
        """The last lines that the servers have printed."""
        return "\n".join(file.read_text()[-1000:] for file in sorted(self.folder.glob("log*")))

    def kill(self, one):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(one.pid, signal.SIGKILL)
        one.wait()


@contextlib.contextmanager
def servers(folder):
    started = Processes(folder)
    try:
        yield started
    finally:
        for one in reversed(started.started):
            started.kill(one)
