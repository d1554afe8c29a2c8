"""Installed policies with other options than their own: `armctl compare tuned.toml`.

    policy = "reach_mpc"
    env = "armctl/ArmReach-v0"

    [options.problem]
    horizon = 12

A policy takes options if the function that makes it has a parameter `options`, a mapping. Which ones these are, it says
itself. A file beside the function's module, of the policy's name, may list them, with a search space for `armctl tune`.
"""

import functools
import inspect
import tomllib
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from armctl.errors import ConfigurationError, unknown_name
from armctl.files import bounded_text
from armctl.policies.trainings import GROUP
from armctl.registration import installed

SUFFIX = ".toml"


class PolicyConfiguration(BaseModel):
    """An installed policy and its options."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    policy: str
    env: str
    """The environment for which the options were chosen."""
    env_options: dict[str, Any] = {}
    options: dict[str, Any] = {}
    tune: dict[str, Any] = {}
    """The search space of `armctl tune` (see `armctl.search_space`)."""

    def make(self) -> Callable[..., Any]:
        """The function that makes the policy, with these options. Raises `ConfigurationError` if it takes none."""
        factory = installed(GROUP)[self.policy].load()
        if "options" not in inspect.signature(factory).parameters:
            able = [name for name in sorted(installed(GROUP).names) if configuration_beside(name)]
            raise ConfigurationError(f"{self.policy} takes no options; those that do: {', '.join(able)}")
        return functools.partial(factory, options=self.options)


def configured(policy: Any) -> PolicyConfiguration | None:
    """The configuration that a policy's name is the file of; None for any other policy. Raises `ConfigurationError`."""
    if isinstance(policy, (str, Path)) and Path(policy).suffix == SUFFIX:
        return read_configuration(Path(policy))
    return None


def read_configuration(file: Path) -> PolicyConfiguration:
    """The configuration in a TOML file, whose policy is installed: a file runs no other code.

    Raises `ConfigurationError`.
    """
    try:
        values = tomllib.loads(bounded_text(file))
    except OSError as error:
        raise ConfigurationError(f"the policy's options {file} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigurationError(f"{file} is not TOML: {error}") from error
    for key in values:
        if key not in PolicyConfiguration.model_fields:
            raise unknown_name(f"key of a policy's options in {file}:", key, PolicyConfiguration.model_fields)
    try:
        found = PolicyConfiguration.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ConfigurationError(f"{file} is not a policy's options: {where}: {first['msg']}") from error
    if found.policy not in installed(GROUP).names:
        raise unknown_name(f"installed policy in {file}:", found.policy, installed(GROUP).names)
    return found


def configuration_beside(name: str) -> Path | None:
    """The file with an installed policy's own options, which is beside its module; None if there is none."""
    home = find_spec(installed(GROUP)[name].module)
    beside = Path(home.origin).with_name(f"{name}{SUFFIX}") if home and home.origin else None
    return beside if beside is not None and beside.is_file() else None
