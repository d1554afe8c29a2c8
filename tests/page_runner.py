"""A process that runs examples in forks of itself, so that only the first of them waits for imports."""

import contextlib
import json
import os
import select
import subprocess
import sys
from pathlib import Path

LEARNING = ("stable_baselines3", "onnxscript", "torch._dynamo", "torch.onnx._internal.exporter._core")
"""What trainings and exports of agents import: 4 s of processor time for each, if it is not shared."""
SECONDS = 600
"""That a page's examples may take."""


@contextlib.contextmanager
def page_runner(*options, imports=(), **variables):
    """Start `run_page.py` with options of Python, and return a function that runs a page's steps in a new folder."""
    command = [sys.executable, "-P", *options, str(Path(__file__).with_name("run_page.py")), *imports]
    env = os.environ | {"COLUMNS": "100"} | variables
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env) as process:

        def run(folder, steps):
            """Return what the steps print; fail if one of them does."""
            folder.mkdir(exist_ok=True)
            print(json.dumps([str(folder), steps]), file=process.stdin, flush=True)
            has_ended, _, _ = select.select([process.stdout], [], [], SECONDS)
            status = process.stdout.readline() if has_ended else process.kill()
            printed = folder.with_name("printed.txt").read_text()
            assert status == "0\n", printed[-6000:]
            return printed

        yield run
