"""Checksums of Python objects by their values: the same in each process, and another if anything inside has changed."""

import functools
import sys
import uuid
from collections.abc import Iterator
from types import CellType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np
from joblib.hashing import NumpyHasher


def fingerprint(given: Any) -> str:
    """A checksum of an object; a unique text if it cannot be told what it is, so that it equals nothing."""
    try:
        return str(_Hasher().hash(given))
    except Exception as error:  # pickling an object may raise anything
        return f"unknown ({type(error).__name__}, {uuid.uuid4().hex[:8]})"


class _Hasher(NumpyHasher):  # type: ignore[misc]  # joblib has no types
    """Hashes what others import by its name, and functions and classes of scripts and notebooks by their content."""

    def __init__(self) -> None:
        super().__init__(hash_name="sha1")
        self._inside: set[int] = set()

    def save(self, obj: Any) -> None:
        """Hash an object."""
        if id(obj) in self._inside:  # it refers to itself
            super().save(("again", getattr(obj, "__qualname__", "")))
            return
        content = _content(obj)
        if content is None:
            super().save(obj)
            return
        self._inside.add(id(obj))
        try:
            self.save(content)
        finally:
            self._inside.discard(id(obj))


def _content(obj: Any) -> Any:
    """What stands for an object that pickle knows by its name only, or not at all; None for all others."""
    match obj:
        case CodeType():
            return "code", obj.co_code, obj.co_consts, obj.co_names, obj.co_varnames
        case CellType():
            return "cell", obj.cell_contents
        case ModuleType():
            return "module", obj.__name__
        case MethodType():
            return "method", obj.__func__, obj.__self__
        case property():
            return "property", obj.fget, obj.fset
        case staticmethod() | classmethod():
            return type(obj).__name__, obj.__func__
        case frozenset():
            return "frozenset", set(obj)
        case FunctionType() if not _is_importable(obj):
            closed = [cell.cell_contents for cell in obj.__closure__ or ()]
            return "function", obj.__code__, obj.__defaults__, obj.__kwdefaults__, closed, _globals_of(obj)
        case type() if not _is_importable(obj):
            own = {name: value for name, value in vars(obj).items() if not name.startswith("__") or callable(value)}
            return "class", obj.__qualname__, obj.__bases__, own
        case functools.partial():
            return "partial", obj.func, obj.args, obj.keywords
        case _ if isinstance(parameters := getattr(obj, "state_dict", None), MethodType):
            return "parameters", {name: np.asarray(value.detach().cpu()) for name, value in parameters().items()}
        case _ if callable(getattr(obj, "predict", None)) and hasattr(obj, "policy"):  # Stable-Baselines3's
            return "model", type(obj), obj.policy, _statistics(obj)
    return None


def _is_importable(code: Any) -> bool:
    """Whether a module other than the script defines it, under its name."""
    module = sys.modules.get(code.__module__)
    if module is None or module.__name__ == "__main__":
        return False
    found: Any = module
    for name in code.__qualname__.split("."):
        found = getattr(found, name, None)
    return found is code


def _globals_of(function: FunctionType) -> dict[str, Any]:
    """The global names that a function uses, with what they stand for."""
    return {name: function.__globals__[name] for name in _names(function.__code__) if name in function.__globals__}


def _names(code: CodeType) -> Iterator[str]:
    yield from sorted(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _statistics(model: Any) -> Any:
    normaliser = getattr(model, "get_vec_normalize_env", lambda: None)()
    return None if normaliser is None else getattr(normaliser, "obs_rms", None)
