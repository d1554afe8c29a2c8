"""Runs the examples of a page in their order, each in a fork of this process, which has imported armctl already.

So each begins as in a process of its own, but for the seconds of imports. The working directory is theirs. Standard
input is a JSON list of `["file", NAME, TEXT]`, `["python", CODE]` and `["command", WORD, ...]`. See `test_docs.py`.
"""

import json
import os
import subprocess
import sys
import types
import warnings
from pathlib import Path

import armctl.agents
import armctl.report
import armctl.study  # noqa: F401 - what most of the commands need
from armctl.cli import main


def python(code):
    """As `python -c`."""
    sys.path.insert(0, "")
    sys.modules["__main__"] = module = types.ModuleType("__main__")
    exec(compile(code, "<page>", "exec"), module.__dict__)


def command(*words):
    if words[0] != "armctl":
        subprocess.run(words, check=True)
        return
    warnings.simplefilter("ignore", DeprecationWarning)  # which are errors for the page's own code
    sys.argv = list(words)
    main()


def apart(run, *given):
    """Run it in a fork, which ends like any process, and end with it if it fails."""
    print("+", *given, flush=True)
    fork = os.fork()
    if not fork:
        run(*given)
        sys.exit()
    if os.waitpid(fork, 0)[1]:
        sys.exit(1)


if __name__ == "__main__":
    for kind, *given in json.load(sys.stdin):
        if kind == "file":
            Path(given[0]).write_text(given[1])
        else:
            apart({"python": python, "command": command}[kind], *given)
