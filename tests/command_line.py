"""The command line, as a program and in this process."""

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from armctl.cli import main

ARMCTL = str(Path(sys.executable).parent / "armctl")
ENVIRONMENT = {"COLUMNS": "100", "NO_COLOR": "1"}


def program(*arguments, cwd, check=True, **variables):
    """Run armctl as a program, which has never seen another folder's modules."""
    done = subprocess.run(
        [ARMCTL, *arguments], capture_output=True, text=True, cwd=cwd, env=os.environ | ENVIRONMENT | variables
    )
    assert not check or done.returncode == 0, done.stderr
    return done


def armctl(*arguments, cwd, check=True):
    """Run armctl in this process, where everything is imported already."""
    with pytest.MonkeyPatch.context() as patch, io.StringIO() as out, io.StringIO() as err:
        patch.chdir(cwd)
        patch.setattr(sys, "argv", ["armctl", *arguments])
        patch.setattr(sys, "path", list(sys.path))
        for name, value in ENVIRONMENT.items():
            patch.setenv(name, value)
        status = 0
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                main()
            except SystemExit as exit:
                status = exit.code
        done = subprocess.CompletedProcess(arguments, status, out.getvalue(), err.getvalue())
    assert not check or done.returncode == 0, done.stderr
    return done
