"""A process of its own that looks at files, so that a crash fails a test instead of ending all of them.

A script calls `serve(check)`; a test asks `Child(script)(path)`. The answer is what `check(path)` returns, or the words
of the `ArmctlError` that it raises. Any other error, a crash or a hang fails the test.
"""

import json
import signal
import subprocess
import sys
import traceback
from pathlib import Path

from armctl.core.errors import ArmctlError

HANGS = 120
"""s"""


class Child:
    def __init__(self, script):
        self._script = script
        self._start()

    def _start(self):
        self._process = subprocess.Popen(
            [sys.executable, self._script],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def __call__(self, path):
        if self._process.poll() is not None:  # it died of the file before
            self._start()
        print(path, file=self._process.stdin, flush=True)
        answer = self._process.stdout.readline()
        assert answer, f"died with {self._process.wait()} on {path}"
        kind, text = json.loads(answer)
        assert kind != "traceback", text
        return kind, text

    def close(self):
        self._process.communicate()


def serve(check):
    answers, sys.stdout = sys.stdout, sys.stderr  # libraries print warnings
    for line in sys.stdin:
        signal.alarm(HANGS)
        try:
            answer = "fine", check(Path(line.rstrip("\n")))
        except ArmctlError as error:
            answer = "refused", str(error)
        except Exception:
            answer = "traceback", traceback.format_exc()
        signal.alarm(0)
        print(json.dumps(answer), file=answers, flush=True)
