"""Options: dataclasses that check what they are given, and how options are written as text.

Pydantic checks them. It is loaded with the first value to check: defaults need no check, and take no time.
"""

import ast
import dataclasses
import functools
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, dataclass_transform

from annotated_types import Ge, Gt, Le

from armctl.core.errors import ConfigurationError, UnknownOption, unknown_name

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

Options = TypeVar("Options")
Model = TypeVar("Model", bound="BaseModel")

Count = Annotated[int, Ge(1)]
Natural = Annotated[int, Ge(0)]
Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Share = Annotated[float, Ge(0), Le(1)]
CHECKS = {"strict": True, "arbitrary_types_allowed": True, "allow_inf_nan": False}
"""Pydantic's configuration."""


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def options(cls: type[Options]) -> type[Options]:
    """Make a class a frozen dataclass that checks its fields' types and bounds, as pydantic does, strictly.

    A wrong value raises `ConfigurationError`, which names the option, what is allowed, and the value.
    """
    unchecked: Any = dataclasses.dataclass(frozen=True)(cls)
    unchecked.__pydantic_config__ = CHECKS
    plain_init = unchecked.__init__

    @functools.cache
    def checked() -> Any:
        from pydantic.dataclasses import dataclass

        return dataclass(unchecked, frozen=True)

    @functools.wraps(plain_init)
    def init(self: Any, *args: Any, **values: Any) -> None:
        if not args and not values and not required:
            plain_init(self)
            return
        from pydantic import ValidationError

        try:
            self.__dict__.update(vars(checked()(*args, **values)))
        except ValidationError as error:
            raise _explained(error) from error

    required = any(
        field.default is field.default_factory is dataclasses.MISSING for field in dataclasses.fields(unchecked)
    )
    unchecked.__init__ = init
    return unchecked  # type: ignore[no-any-return]


def make_options(
    options_type: type[Options], values: Mapping[str, Any], kind: str = "option", others: Sequence[str] = ()
) -> Options:
    """Return options from values by name.

    Raises `ConfigurationError`, and `UnknownOption` for an unknown name. Its message names the valid ones, and
    `others`, which are options in another place.
    """
    names = [field.name for field in dataclasses.fields(options_type)]  # type: ignore[arg-type]
    for name in values:
        if name not in names:
            unknown = unknown_name(kind, name, [*names, *others])
            raise UnknownOption(f"{unknown} (unexpected keyword argument {name!r})")
    return options_type(**values)


def checked_model(model: type[Model], values: Mapping[str, Any], description: str, source: str) -> Model:
    """Return a pydantic model of values from `source`, in messages `description`. Raises `ConfigurationError`."""
    from pydantic import ValidationError

    for key in values:
        if key not in model.model_fields:
            raise unknown_name(f"key of a {description} in {source}:", key, model.model_fields)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ConfigurationError(f"{source} is not a {description}: {where}: {first['msg']}") from error


def changed_options(options: Options, values: Mapping[str, Any], kind: str = "option") -> Options:
    """Return options with other values, as a TOML file has them: by name, options within as tables, tuples as lists.

    Raises `ConfigurationError` as `make_options` does.
    """
    present = {field.name: getattr(options, field.name) for field in dataclasses.fields(options)}  # type: ignore[arg-type]
    changed = dict(values)
    for name, value in values.items():
        match present.get(name), value:
            case object(__dataclass_fields__=_) as within, Mapping():
                changed[name] = changed_options(within, value, f"{kind}: {name}")
            case tuple(), list():
                changed[name] = tuple(value)
    return make_options(type(options), present | changed, kind)


def option_value(text: str) -> Any:
    """Return a number, tuple, True, False or None as Python writes it, also true or false; anything else is text."""
    try:
        return text == "true" if text in ("true", "false") else ast.literal_eval(text)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        return text


def option_arguments(options: Mapping[str, Any]) -> list[str]:
    """Return an environment's options as arguments of the command line, which it reads as the same values."""
    arguments = []
    for name, value in options.items():
        text = value if isinstance(value, str) and option_value(value) == value else repr(value)
        arguments += ["--set", f"{name}={text}"]
    return arguments


def _explained(error: "ValidationError") -> ConfigurationError:
    first = error.errors()[0]
    if isinstance(raised := first.get("ctx", {}).get("error"), ConfigurationError):
        return raised
    name = str(first["loc"][0]) if first["loc"] else error.title
    if first["type"] == "literal_error":
        return unknown_name(name, first["input"], re.findall(r"'([^']*)'", first["ctx"]["expected"]))
    message = first["msg"].removeprefix("Value error, ")
    return ConfigurationError(f"{name}: {message[0].lower()}{message[1:]}, not {first['input']!r}")
