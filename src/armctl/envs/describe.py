"""The options of an environment: name, default, type and description of each, as `armctl list --env ID` shows them.

Fields of option dataclasses have their descriptions, with units, as docstrings beneath them. Python does not keep
these: they are read from the source.
"""

import ast
import dataclasses
import inspect
import itertools
import textwrap
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gymnasium.envs.registration import EnvSpec, load_env_creator

from armctl.core.registration import load_task
from armctl.envs.environment_options import EnvironmentOptions
from armctl.envs.find import find_spec, is_task
from armctl.envs.make import RESERVED

LIMIT = "Control steps until an episode is truncated."
BOUNDS = {"gt": "> {}", "ge": ">= {}", "lt": "< {}", "le": "<= {}"}
"""Notation of pydantic's constraints, by name."""


@dataclass(frozen=True)
class OptionDescription:
    """An option."""

    name: str
    default: str
    type: str
    text: str
    """Empty if its source says nothing."""


def describe_options(env: str) -> list[OptionDescription]:
    """Return an environment's options, with the defaults it was registered with. Raises `ConfigurationError`."""
    spec = find_spec(env)
    described = _fields(load_task(spec.kwargs["task"]).options_type) if is_task(spec) else _parameters(spec)
    registered = {name: _default(value) for name, value in spec.kwargs.items()}
    described = [
        dataclasses.replace(option, default=registered.get(option.name, option.default)) for option in described
    ]
    return [*described, OptionDescription("max_episode_steps", str(spec.max_episode_steps), "int", LIMIT)]


def describe_general_options() -> list[OptionDescription]:
    """Return the options of every environment that is made of a task, but for its time limit, which each has."""
    return [option for option in _fields(EnvironmentOptions) if option.name != "max_episode_steps"]


def _fields(options_type: type[Any]) -> list[OptionDescription]:
    texts: dict[str, str] = {}
    for base in reversed(options_type.__mro__):
        texts |= _docstrings(base)
    hints = typing.get_type_hints(options_type, include_extras=True)
    return [
        OptionDescription(field.name, _field_default(field), type_text(hints[field.name]), texts.get(field.name, ""))
        for field in dataclasses.fields(options_type)
    ]


def _docstrings(cls: type[Any]) -> dict[str, str]:
    """Return the docstrings beneath the fields of a class, by name; none if its source is missing."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(cls)))
    except (OSError, TypeError, SyntaxError):
        return {}
    body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
    texts = {}
    for field, beneath in itertools.pairwise(body):
        match field, beneath:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                texts[name] = " ".join(text.split())
    return texts


def _field_default(field: "dataclasses.Field[Any]") -> str:
    if field.default_factory is not dataclasses.MISSING:
        return _default(field.default_factory())
    return "none: it must be given" if field.default is dataclasses.MISSING else _default(field.default)


def _default(value: Any) -> str:
    """Return a default as it is written after `--set`; of named parts, such as reward terms, the names."""
    return ", ".join(value) or "none" if isinstance(value, Mapping) else str(value)


def _parameters(spec: EnvSpec) -> list[OptionDescription]:
    """Return the constructor's parameters of an environment of others."""
    maker = load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
    parameters = inspect.signature(maker).parameters if maker else {}
    return [
        OptionDescription(
            name,
            "" if parameter.default is parameter.empty else _default(parameter.default),
            "any" if parameter.annotation is parameter.empty else type_text(parameter.annotation),
            "",
        )
        for name, parameter in parameters.items()
        if name not in RESERVED | {"self"}
        and parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
    ]


def type_text(hint: Any) -> str:
    """Return a type for readers: `float > 0`, `position | delta`, `tuple of 3 float`."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        limits = [limit for extra in arguments[1:] for limit in (extra, *getattr(extra, "metadata", ()))]
        bounds = [
            shape.format(f"{getattr(limit, name):g}")
            for limit in limits
            for name, shape in BOUNDS.items()
            if isinstance(getattr(limit, name, None), (int, float))
        ]
        return " ".join([type_text(arguments[0]), " and ".join(dict.fromkeys(bounds))]).rstrip()
    if origin is typing.Literal:
        return " | ".join(map(str, arguments))
    if origin in (typing.Union, types.UnionType):
        return " | ".join(map(type_text, arguments))
    if origin is tuple:
        parts = [type_text(argument) for argument in arguments if argument is not ...]
        return f"({', '.join(parts)})" if ... not in arguments else f"tuple of {parts[0]}"
    if hint is types.NoneType:
        return "None"
    return str(getattr(origin or hint, "__name__", hint))
