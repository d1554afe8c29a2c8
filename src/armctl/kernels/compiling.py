"""Compilation of kernels: at the first call, once for each version, into the user's cache folder."""

import hashlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function of arrays and scalars, when it is called first. Division by zero gives infinity, as in NumPy.

    Kernels may call each other, also across files. Their machine code is kept for later processes.
    """
    previous = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_FOLDER or "")
    try:
        return numba.njit(function, cache=_FOLDER is not None, nogil=True, error_model="numpy")
    finally:
        numba.config.CACHE_DIR = previous


def _cache_folder() -> Path | None:
    """Return a folder for the present sources of all kernels, since numba sees changes in a kernel's own file only.

    None if it cannot be written: then each process compiles.
    """
    sources = sorted(Path(__file__).parent.glob("*.py"))
    version = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
    try:
        home = numba.config.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(home) / "armctl" / f"kernels-{version}"
        if not folder.exists():
            folder.mkdir(parents=True, exist_ok=True)
            print("armctl: compiling its arithmetic, once; this takes some seconds", file=sys.stderr)
        return folder if os.access(folder, os.W_OK) else None
    except (OSError, RuntimeError):  # RuntimeError: no home
        return None


_FOLDER = _cache_folder()


@numba.njit(inline="always")
def copy_to(values, out):
    """Set `out[:] = values`, (k,) each. Compiling that line takes seconds, because of NumPy's errors."""
    for i in range(len(out)):
        out[i] = values[i]
