"""The command line, as a program and in this process."""

import contextlib
import functools
import io
import os
import resource
import subprocess
import sys
from pathlib import Path

import gymnasium
import pytest

from armctl.cli import main
from armctl.runtime import identity

ARMCTL = str(Path(sys.executable).parent / "armctl")
POLICY_SEED = 2**128 // 3
"""Of all runs in this process (see conftest.py); as `--policy-seed`, of a program's."""
ENVIRONMENT = {"COLUMNS": "100", "NO_COLOR": "1"}


@contextlib.contextmanager
def full_disk(size):
    """Longer files than `size` bytes cannot be written, as on a full disk, here and by processes that begin here.

    Python keeps no bytecode meanwhile: it would keep what it could write of it, and read that ever after.
    """
    before, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "dont_write_bytecode", True)
            patch.setenv("PYTHONDONTWRITEBYTECODE", "1")
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, hard))


def program(*arguments, cwd, check=True, disk=None, **variables):
    """Run armctl as a program, which has never seen another folder's modules; `disk` is as for `full_disk`."""
    done = subprocess.run(
        [ARMCTL, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=os.environ | ENVIRONMENT | ({} if disk is None else {"PYTHONDONTWRITEBYTECODE": "1"}) | variables,
        preexec_fn=None if disk is None else functools.partial(resource.setrlimit, resource.RLIMIT_FSIZE, (disk, disk)),
    )
    assert not check or done.returncode == 0, done.stderr
    return done


def armctl(*arguments, cwd, check=True, disk=None, **variables):
    """Run armctl in this process, where everything is imported already; what it imports and registers is forgotten.

    `disk` is as for `full_disk`. Kernels should be compiled by then, as numba cannot write them either.
    """
    with pytest.MonkeyPatch.context() as patch, io.StringIO() as out, io.StringIO() as err:
        patch.chdir(cwd)
        patch.setattr(sys, "argv", ["armctl", *map(str, arguments)])
        patch.setattr(sys, "path", list(sys.path))
        patch.setattr(sys, "dont_write_bytecode", True)  # a file that is edited at once may be as old and as long
        patch.setattr(identity, "_first_seen", {})  # so that an edited module is not told to be edited after its import
        patch.setenv("PYTHONSAFEPATH", "")  # `main` sets it, and processes that tests start would inherit that
        for name, value in (ENVIRONMENT | variables).items():
            patch.setenv(name, value)
        for file in Path(cwd).glob("*.py"):
            patch.delitem(sys.modules, file.stem, raising=False)  # one of that name that another test has imported
        status, registered = None, set(gymnasium.registry)
        limited = contextlib.nullcontext() if disk is None else full_disk(disk)
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), limited:
            try:
                main()
            except SystemExit as exit:
                status = exit.code
            finally:
                for name, module in list(sys.modules.items()):
                    if (getattr(module, "__file__", None) or "").startswith(f"{cwd}{os.sep}"):
                        del sys.modules[name]
                for env_id in set(gymnasium.registry) - registered:
                    del gymnasium.registry[env_id]
        done = subprocess.CompletedProcess(arguments, int(status or 0), out.getvalue(), err.getvalue())
    assert not check or done.returncode == 0, done.stderr
    return done
