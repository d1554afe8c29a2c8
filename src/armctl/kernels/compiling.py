"""Compilation of kernels: at the first call, once for each version, into the user's cache folder."""

import contextlib
import functools
import hashlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba import types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, UserProvidedCacheLocator
from numba.experimental import structref
from numba.extending import overload

from armctl.core.interrupts import interrupts_raised
from armctl.kernels.borrowing import BorrowingCompiler

KERNELS = Path(__file__).parent


class _Locator(UserProvidedCacheLocator):  # type: ignore[misc]
    """Places of machine code, which is that of all installations with the same sources of kernels."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Return the folder for the kernels of a file."""
        return KERNELS.name if Path(py_file).parent == KERNELS else str(super().get_suitable_cache_subpath(py_file))


class _Implementation(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class _Cache(FunctionCache):  # type: ignore[misc]
    """Machine code in the cache folder; what is damaged there is compiled again, and a full disk stops nothing."""

    _impl_class = _Implementation

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the code for a signature; None if there is none that can be read."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # unpickling damaged data raises anything
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code for a signature, if that can be written."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)


def compiled(function: Callable[..., Any], fastmath: Any = False) -> Any:
    """Compile a function of arrays and scalars, when it is called first. Division by zero gives infinity, as in NumPy.

    Kernels may call each other, also across files. Their machine code is kept for later processes.
    """
    options = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, "fastmath": fastmath}
    dispatcher = numba.njit(function, pipeline_class=BorrowingCompiler, **options)
    dispatcher.compile = interrupts_raised()(dispatcher.compile)
    if _FOLDER is not None:
        previous = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(_FOLDER)
        try:
            dispatcher._cache = _Cache(function)
        finally:
            numba.config.CACHE_DIR = previous
    return dispatcher


def _cache_folder() -> Path | None:
    """Return a folder for the present sources of all kernels, since numba sees changes in a kernel's own file only.

    It is the user's own, and nobody else may write to it, since code is loaded from it. None if there is no such
    folder: then each process compiles.
    """
    sources = sorted(KERNELS.glob("*.py"))
    version = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
    try:
        home = numba.config.CACHE_DIR or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(home) / "armctl" / f"kernels-{version}"
        is_new = not folder.exists()
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if folder.stat().st_uid != os.getuid():
            return None
        folder.chmod(0o700)
        if not os.access(folder, os.W_OK):
            return None
    except (OSError, RuntimeError):  # RuntimeError: no home
        return None
    if is_new:
        print("armctl: compiling its arithmetic, once; this takes some seconds", file=sys.stderr)
    return folder


_FOLDER = _cache_folder()


@structref.register
class _BoundType(types.StructRef):  # type: ignore[misc]
    """Type of `Bound` in kernels."""


class Bound(structref.StructRefProxy):  # type: ignore[misc]
    """`arguments` of kernels, unboxed once: this takes as long as an array, and each array in them as long again."""


structref.define_boxing(_BoundType, Bound)


def _new(arguments):
    """Return `arguments` as a `Bound`, in kernels."""


@overload(_new)
def _new_of_type(arguments):
    bound_type = _BoundType([("arguments", arguments)])

    def new(arguments):
        result = structref.new(bound_type)
        result.arguments = arguments
        return result

    return new


@compiled
def bound(arguments):
    """Return `arguments`, a tuple, as a `Bound`, in which arrays stay the same ones."""
    return _new(arguments)


fused = functools.partial(compiled, fastmath={"contract"})
"""Compile a function in which a product and its sum are one instruction, rounded once, where the processor has it."""

inlined = numba.njit(inline="always")
"""Compile a short function into those that call it: calls with many arrays take longer than the arithmetic."""


@inlined
def copy_to(values, out):
    """Set `out[:] = values`, (k,) each. Compiling that line takes seconds, because of NumPy's errors."""
    for i in range(len(out)):
        out[i] = values[i]
