"""Declarations of classes and functions, texts and numbers in their source, read without importing anything heavy."""

import ast
import contextlib
import functools
import importlib.util
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from armctl.core.registration import importable_from

LONGEST_WAY = 5
"""Files in which a definition is looked for, each imported by the one before."""


@dataclass(frozen=True)
class Declaration:
    """The first line of a docstring, and values that need no code."""

    summary: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Attributes of a class."""
    decorators: Mapping[str, tuple[list[Any], dict[str, Any]]] = field(default_factory=dict)
    """Arguments and keywords of decorators, by the decorators' names."""


def class_value(name: str, attribute: str) -> str | None:
    """Return `module:Class` of a class that is an attribute of the class `name`, or of a base; None: unknown."""
    for module, node in _with_bases(name):
        for line in node.body:
            match line:
                case (
                    ast.Assign(targets=[ast.Name(id=target)], value=ast.Name(id=value))
                    | ast.AnnAssign(target=ast.Name(id=target), value=ast.Name(id=value))
                ) if target == attribute:
                    return f"{module}:{value}"
    return None


def field_names(name: str) -> list[str]:
    """Return the fields of the dataclass `module:Class` and its bases."""
    return [
        line.target.id
        for _, node in _with_bases(name)
        for line in node.body
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name) and "ClassVar" not in ast.dump(line)
    ]


def _with_bases(name: str) -> Iterator[tuple[str, ast.ClassDef]]:
    """Yield a class and its bases, as far as they are found, each with its module."""
    module, node = _definition(name)
    if isinstance(node, ast.ClassDef):
        yield module, node
        for base in node.bases:
            if isinstance(base, ast.Name):
                yield from _with_bases(f"{module}:{base.id}")


def declaration(name: str) -> Declaration | None:
    """Return what `module:attribute` declares; None if the source does not say."""
    _, node = _definition(name)
    return None if node is None else _read(node)


def declaration_of_code(name: str) -> Declaration | None:
    """Return the same of code that the user names, `module:attribute` or `path/to/file.py:attribute`.

    No package is imported, not even to look for a module in it.
    """
    module, _, attribute = name.rpartition(":")
    file = Path(module) if module.endswith(".py") else _file_of(module)
    for _ in range(LONGEST_WAY):
        if file is None:
            break
        node, file = _in_file(file, attribute)
        if node is not None:
            return _read(node)
    return None


def _file_of(module: str) -> Path | None:
    first, *others = module.split(".")
    with contextlib.suppress(Exception), importable_from(Path.cwd()):  # whatever a name may be
        spec = importlib.util.find_spec(first)
        if spec is not None and not others:
            return Path(spec.origin or "")
        for folder in spec.submodule_search_locations or () if spec else ():
            beside = Path(folder, *others)
            for file in (beside.with_suffix(".py"), beside / "__init__.py"):
                if file.is_file():
                    return file
    return None


def _in_file(file: Path, attribute: str) -> tuple[ast.ClassDef | ast.FunctionDef | None, Path | None]:
    """Return the definition in a file, or the file beside it from which it comes."""
    try:
        tree = ast.parse(file.read_bytes())
    except (OSError, ValueError, SyntaxError, RecursionError):
        return None, None
    for node in tree.body:
        match node:
            case ast.ClassDef(name=defined) | ast.FunctionDef(name=defined) if defined == attribute:
                return node, None
            case ast.ImportFrom(module=str(home)) if attribute in {alias.name for alias in node.names}:
                return None, file.parent.joinpath(*home.split(".")).with_suffix(".py")
    return None, None


def _definition(name: str) -> tuple[str, ast.ClassDef | ast.FunctionDef | None]:
    """Return the module that defines `module:attribute`, and the definition; None if it is made in another way."""
    module, _, attribute = name.partition(":")
    for node in ast.walk(_tree(module)):
        match node:
            case ast.ClassDef(name=defined) | ast.FunctionDef(name=defined) if defined == attribute:
                return module, node
            case ast.ImportFrom(module=str(home)) if attribute in {alias.asname or alias.name for alias in node.names}:
                return _definition(f"{home}:{attribute}")
    return module, None


@functools.cache
def _tree(module: str) -> ast.Module:
    """Return a module's source, taken apart; nothing if it cannot be read."""
    with contextlib.suppress(Exception):  # whatever a stranger's package does when its folder is looked for
        spec = importlib.util.find_spec(module)
        source = getattr(spec.loader, "get_source", None) if spec else None
        return ast.parse(source(module) if source else "")
    return ast.parse("")


def _read(node: ast.ClassDef | ast.FunctionDef) -> Declaration:
    values, decorators = {}, {}
    for line in node.body if isinstance(node, ast.ClassDef) else []:
        match line:
            case ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)) if line.value:
                with contextlib.suppress(ValueError):
                    values[name] = ast.literal_eval(line.value)
    for decorator in node.decorator_list:
        match decorator:
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=args, keywords=keywords):
                with contextlib.suppress(ValueError):
                    arguments = {keyword.arg or "": ast.literal_eval(keyword.value) for keyword in keywords}
                    decorators[name] = [ast.literal_eval(arg) for arg in args], arguments
    return Declaration((ast.get_docstring(node) or "").partition("\n")[0], values, decorators)
