"""Runs the examples of pages in their order, each in a fork of this process, which has imported armctl already.

So each begins as in a process of its own, but for the seconds of imports; arguments name further modules to import.
Each line of standard input is a page: a JSON list of its folder, in which its examples work, and of their list:
`["file", NAME, TEXT]`, `["python", CODE]`, `["command", WORD, ...]`, `["script", FILE, WORD, ...]` and
`["module", NAME, WORD, ...]`. What they print goes to `printed.txt` beside the folder; the answer is a line with 0 if
all went well. See `page_runner.py`.
"""

import atexit
import gc
import importlib
import json
import os
import runpy
import subprocess
import sys
import threading
import types
import warnings
from pathlib import Path

import armctl
from armctl.cli import main
from armctl.runtime.identity import own_modules


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


def script(file, *words):
    """As `python FILE WORD ...`."""
    sys.argv = [file, *words]
    sys.path.insert(0, str(Path(file).parent))
    runpy.run_path(file, run_name="__main__")


def module(name, *words):
    """As `python -m NAME WORD ...`."""
    sys.argv = [name, *words]
    runpy.run_module(name, run_name="__main__", alter_sys=True)


RUNS = {"python": python, "command": command, "script": script, "module": module}


def page(folder, steps):
    """Run a page's examples up to the first that fails."""
    with open(os.devnull) as nothing, Path(folder).with_name("printed.txt").open("w") as printed:
        for stream, file in enumerate((nothing, printed, printed)):
            os.dup2(file.fileno(), stream)
    os.chdir(folder)
    for kind, *given in steps:
        print("+", *given, flush=True)
        if kind == "file":
            Path(given[0]).write_text(given[1])
        elif status := apart(RUNS[kind], *given):
            os._exit(status)


def apart(run, *given):
    """Run it in a fork, and return its status.

    It ends as any process does, with its threads and what it has registered for the end, except that its memory is left
    as it is: to clear what it has of its parent takes a fifth of a second, and a third with torch.
    """
    if fork := os.fork():
        return os.waitstatus_to_exitcode(os.waitpid(fork, 0)[1])
    status = 0
    try:
        run(*given)
    except SystemExit as ended:
        if isinstance(ended.code, str):
            print(ended.code, file=sys.stderr)
        status = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        sys.excepthook(*sys.exc_info())
        status = 1
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def warm_up(*names):
    """Import what most examples need, and load compiled kernels; but nothing that starts threads: forks lose them."""
    for name in ("armctl.study.verbs", "armctl.tasks.reach.reach", "onnx", "plotly.graph_objects", "scipy.stats"):
        importlib.import_module(name)
    with warnings.catch_warnings(action="ignore"):  # of packages, where they are errors for the page's own code
        for name in names:
            importlib.import_module(name)
    armctl.evaluate("reach_ik", episodes=1)
    own_modules()
    gc.collect()
    gc.freeze()  # forks look at no object of these again


if __name__ == "__main__":
    warm_up(*sys.argv[1:])
    for line in sys.stdin:
        print(apart(page, *json.loads(line)), flush=True)
