"""Checksums of Python objects by all that they are: the same in each process, and another if anything inside differs.

Objects count by type and attributes. Functions and classes of one's own count by their code and by what that refers to:
defaults, closures, and the globals that it names, by their values. Those of installed packages count by their names.
An object that leads to something opaque to Python, such as a lock or a session of a library in C, has no checksum.
"""

import copyreg
import functools
import hashlib
import sys
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import PurePath
from types import (
    BuiltinMethodType,
    CodeType,
    FunctionType,
    GetSetDescriptorType,
    MappingProxyType,
    MemberDescriptorType,
    MethodType,
    ModuleType,
)
from typing import Any

import numpy as np

from armctl.core.errors import described
from armctl.runtime.own_code import file_of, in_plugin, is_own

UNKNOWN = "unknown ("
"""Beginning of the text that replaces a checksum for an object without one."""
_ATOMS = (type(None), bool, int, float, complex, str, bytes)
_CONTAINERS: tuple[Any, ...] = (list, tuple, dict, set, frozenset, str, bytes, int, float)
"""Built-in classes, which others inherit; called with such an object, they return what is inherited."""
_DEFINING = (FunctionType, classmethod, staticmethod, property)
_HEAP_TYPE = 1 << 9
"""`Py_TPFLAGS_HEAPTYPE`: whether a class may have been defined in Python."""


def fingerprint(value: Any) -> str:
    """Return a checksum of an object; a unique text with the reason if it has none, so that it equals nothing."""
    hasher = _Hasher()
    try:
        hasher.add(value)
    except Exception as error:  # taking an object apart may raise anything
        return f"{UNKNOWN}{hasher.place}: {described(error)}, {uuid.uuid4().hex[:8]})"
    return hasher.checksum


class _Hasher:
    """Feeds an object, part by part, to a checksum. An object met before counts by the number of its first meeting."""

    def __init__(self) -> None:
        self._sha = hashlib.sha256()
        self._numbers: dict[int, int] = {}
        self._alive: list[Any] = []  # so that no other object gets the id of one that has a number
        self._path: list[str] = []
        self.place = "it"
        """In words, where in the object the last part lies that was begun."""

    @property
    def checksum(self) -> str:
        """The checksum of all that was added."""
        return self._sha.hexdigest()[:40]

    def add(self, obj: Any) -> None:
        """Add an object."""
        if type(obj) in _ATOMS:
            self._put(type(obj).__name__, repr(obj))
        elif type(obj) is tuple:
            self._put("tuple", len(obj))
            for part in obj:
                self.add(part)
        elif type(obj) in (set, frozenset):  # in an order that does not depend on the hashes of this process
            self._put("set", *sorted(_checksum_of(part) for part in obj))
        elif id(obj) in self._numbers:
            self._put("again", self._numbers[id(obj)])
        else:
            self._numbers[id(obj)] = len(self._numbers)
            self._alive.append(obj)
            self._add_new(obj)

    def _add_new(self, obj: Any) -> None:
        self.place = f"its {''.join(self._path)} of type {type(obj).__qualname__}" if self._path else "it"
        if type(obj) is list:
            self._put("list", len(obj))
            for i, part in enumerate(obj):
                with self._inside(f"[{i}]"):
                    self.add(part)
        elif type(obj) in (dict, MappingProxyType):
            self._put("dict", len(obj))
            for key, value in _in_order(obj):
                self.add(key)
                with self._inside(f".{key}" if isinstance(key, str) else f"[{key!r}]"):
                    self.add(value)
        elif isinstance(obj, np.ndarray) and not obj.dtype.hasobject:
            self._put("array", type(obj).__qualname__, obj.dtype.str, obj.dtype.descr, obj.shape)
            self._sha.update(np.ascontiguousarray(obj).tobytes())
        else:
            for part in _parts(obj):
                self.add(part)

    def _put(self, *values: Any) -> None:
        text = repr(values).encode(errors="surrogatepass")
        self._sha.update(len(text).to_bytes(8, "little") + text)

    @contextmanager
    def _inside(self, step: str) -> Iterator[None]:
        self._path.append(step)
        yield
        self._path.pop()  # not after an error: it is where that has happened


def _checksum_of(obj: Any) -> str:
    hasher = _Hasher()
    hasher.add(obj)
    return hasher.checksum


def _in_order(mapping: Mapping[Any, Any]) -> Iterable[tuple[Any, Any]]:
    if all(isinstance(key, str) for key in mapping):
        return sorted(mapping.items())  # no two keys are equal, so that no values are compared
    return sorted(mapping.items(), key=lambda item: _checksum_of(item[0]))


def _parts(obj: Any) -> tuple[Any, ...]:
    """Return what an object is made of; a name, for what counts by that."""
    for kind, parts in _PARTS_OF:
        if isinstance(obj, kind):
            return parts(obj)
    if isinstance(function := getattr(obj, "py_func", getattr(obj, "__wrapped__", None)), FunctionType):
        return "compiled or cached", function  # by Numba, or functools.cache
    if type(obj).__module__.partition(".")[0] == "torch" and hasattr(obj, "detach"):
        return _tensor(obj)
    if callable(getattr(obj, "predict", None)) and hasattr(obj, "policy"):  # Stable-Baselines3's
        plain = {name: value for name, value in vars(obj).items() if type(value) in _ATOMS}
        return "model", type(obj), obj.policy, _statistics(obj), plain
    return _object(obj)


def _code(code: CodeType) -> tuple[Any, ...]:
    counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
    return (
        "code", code.co_code, code.co_consts, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars,
        code.co_exceptiontable, counts,
    )  # fmt: skip


def _function(function: FunctionType) -> tuple[Any, ...]:
    return (
        "function", function.__code__, function.__defaults__, function.__kwdefaults__,
        [_content_of(cell) for cell in function.__closure__ or ()], _globals_of(function), vars(function),
    )  # fmt: skip


def _content_of(cell: Any) -> tuple[Any, ...]:
    try:
        return (cell.cell_contents,)
    except ValueError:  # it is empty
        return ()


def _class(cls: type[Any]) -> tuple[Any, ...]:
    members = {
        name: value
        for name, value in vars(cls).items()
        if isinstance(value, _DEFINING) or not (name.startswith("__") or name == "_abc_impl")
    }
    return "class", cls.__qualname__, type(cls), cls.__bases__, members


def _object(obj: Any) -> tuple[Any, ...]:
    """Yield an object by its type and all its attributes; as it would be pickled, if its class is not one's own."""
    cls = type(obj)
    if _name_of(cls) or _is_compiled(sys.modules.get(cls.__module__)):
        return "object", cls, *_reduced(obj)
    slots = [
        name for base in cls.__mro__ for name, slot in vars(base).items() if isinstance(slot, MemberDescriptorType)
    ]
    attributes = {name: getattr(obj, name) for name in slots if hasattr(obj, name)} | getattr(obj, "__dict__", {})
    inherited: list[Any] = [base(obj) for base in _CONTAINERS if isinstance(obj, base)]
    if isinstance(obj, np.ndarray):
        inherited.append(np.asarray(obj))
    elif not inherited and any(base is not object and not base.__flags__ & _HEAP_TYPE for base in cls.__mro__):
        inherited += _reduced(obj)
    return "object", cls, attributes, inherited


def _reduced(obj: Any) -> tuple[Any, ...]:
    """Return what `pickle` would write of an object."""
    reduce = copyreg.dispatch_table.get(type(obj))
    reduced: Any = reduce(obj) if reduce else obj.__reduce_ex__(4)
    if isinstance(reduced, str):
        return ("named", type(obj).__module__, reduced)
    parts: tuple[Any, ...] = (*reduced, None, None, None)
    make, args, state, items, pairs = parts[:5]
    return make, args, state, items and list(items), pairs and dict(pairs)


def _tensor(tensor: Any) -> tuple[Any, ...]:
    numbers = tensor.detach().cpu()
    if str(tensor.dtype) == "torch.bfloat16":  # NumPy has none
        numbers = numbers.float()
    return "tensor", type(tensor), str(tensor.dtype), tensor.requires_grad, numbers.numpy()


def _statistics(model: Any) -> Any:
    normaliser = getattr(model, "get_vec_normalize_env", lambda: None)()
    return None if normaliser is None else getattr(normaliser, "obs_rms", None)


def _name_of(code: Any) -> tuple[Any, ...]:
    """Return a function or class by its name, if an installed package defines it under that; empty for all others."""
    module = sys.modules.get(code.__module__ or "")
    if module is None or module.__name__ == "__main__" or is_own(module):
        return ()
    member: Any = module
    for name in code.__qualname__.split("."):
        member = getattr(member, name, None)
    return ("named", code.__module__, code.__qualname__) if member is code else ()


def _is_compiled(module: ModuleType | None) -> bool:
    """Return True if a module is not written in Python, so that attributes do not tell all of its objects."""
    if module is None or module.__name__ in sys.builtin_module_names:
        return module is not None
    return str(getattr(module, "__file__", "")).endswith(tuple(EXTENSION_SUFFIXES))


def _globals_of(function: FunctionType) -> dict[str, Any]:
    """Yield the global names that a function uses, with what they stand for."""
    return _named(function.__globals__, frozenset(_names(function.__code__)))


def _named(namespace: Mapping[str, Any], names: frozenset[str]) -> dict[str, Any]:
    """Yield what code with these names uses of a namespace; of one's own module, its attributes with these names."""
    values = {name: namespace[name] for name in names if name in namespace and not name.startswith("__")}
    return {
        name: [value, _named(vars(value), names - {name})] if isinstance(value, ModuleType) and is_own(value) else value
        for name, value in values.items()
    }


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _source(module: ModuleType) -> tuple[bytes, ...]:
    """Return the content of the file of a module of one's own."""
    file = file_of(module)
    return (file.read_bytes(),) if file is not None and is_own(module) else ()


def _method(method: Any) -> tuple[Any, ...]:
    if isinstance(method, BuiltinMethodType) and (method.__self__ is None or isinstance(method.__self__, ModuleType)):
        return "built-in", method.__module__, method.__qualname__
    return "method", getattr(method, "__func__", method.__name__), method.__self__


_PARTS_OF: tuple[tuple[Any, Callable[[Any], tuple[Any, ...]]], ...] = (
    (CodeType, _code),
    (ModuleType, lambda module: ("module", module.__name__, *_source(module))),
    (FunctionType, lambda function: _name_of(function) or _function(function)),
    (type, lambda cls: _name_of(cls) or _class(cls)),
    ((MethodType, BuiltinMethodType), _method),
    (property, lambda descriptor: ("property", descriptor.fget, descriptor.fset, descriptor.fdel)),
    ((staticmethod, classmethod), lambda method: (type(method).__name__, method.__func__)),
    (
        functools.partial,
        lambda partial: ("partial", type(partial), partial.func, partial.args, partial.keywords, vars(partial)),
    ),
    (functools.cached_property, lambda descriptor: ("cached property", descriptor.func)),
    ((MemberDescriptorType, GetSetDescriptorType), lambda descriptor: ("descriptor", descriptor.__name__)),
    (PurePath, lambda path: ("path", str(in_plugin(path)))),
    (np.dtype, lambda dtype: ("dtype", str(dtype), dtype.descr)),
    (np.generic, lambda number: ("number", number.dtype.str, number.tobytes())),
)
"""Kinds of objects, with functions that return what these are made of. The first kind that fits counts."""
