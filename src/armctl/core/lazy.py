"""Exports of a package that are imported on first use, so that a name costs no more than its own module."""

import ast
import functools
import importlib
import inspect
import sys
from collections.abc import Callable
from typing import Any


def on_first_use(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a package, for the imports that it has under `if TYPE_CHECKING:`.

    No such name may be a submodule's too: whoever imports that would put it in the name's place.
    """

    @functools.cache
    def homes() -> dict[str, str]:
        tree = ast.parse(inspect.getsource(sys.modules[package]))
        imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
        return {alias.name: str(node.module) for node in imports for alias in node.names}

    def load(name: str) -> Any:
        module = sys.modules[package]
        if name not in module.__all__:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(homes()[name]), name)
        setattr(module, name, value)
        return value

    return load, lambda: list(sys.modules[package].__all__)
