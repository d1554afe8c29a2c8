"""Installed policies with other options than their own: `armctl compare tuned.toml`.

    policy = "reach_mpc"
    env = "armctl/ArmReach-v0"

    [options.problem]
    horizon = 12

The same without a file: `armctl compare reach_mpc reach_mpc:problem.horizon=12`.

A policy takes options if the function that makes it has a parameter `options`, a mapping. Which ones these are, it says
itself. A file beside the function's module, of the policy's name, may list them, with a search space for `armctl tune`.
"""

import functools
import inspect
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict

from armctl.agents.costs import TuningCost
from armctl.core.errors import ConfigurationError, unknown_name
from armctl.core.files import read_toml
from armctl.core.options import checked_model
from armctl.core.registration import files_beside, installed, load_installed
from armctl.policies.names import GROUP, without_filter
from armctl.remote.names import is_remote

SUFFIX = ".toml"
DESCRIPTION = "file of a policy's options"


class PolicyConfiguration(BaseModel):
    """An installed policy and its options."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    policy: str
    env: str
    """The environment for which the options were chosen; `*` of options in a policy's name."""
    env_options: dict[str, Any] = {}
    options: dict[str, Any] = {}
    tune: dict[str, Any] = {}
    """The search space of `armctl tune` (see `armctl.core.search_space`)."""
    tuned: TuningCost | None = None
    """The search for these values, or for better ones, whatever its winner."""

    def make(self) -> Callable[..., Any]:
        """Return the function that makes the policy so. Raises `ConfigurationError` if it takes no options."""
        factory = load_installed(GROUP, self.policy, "policy")
        if "options" not in inspect.signature(factory).parameters:
            raise ConfigurationError(
                f"{self.policy} takes no options; those that do: {', '.join(sorted(configurations()))}"
            )
        return functools.partial(factory, options=self.options)


def configured(policy: Any) -> PolicyConfiguration | None:
    """Return the configuration in the file `policy`, or in a name such as `reach_mpc:problem.horizon=12`.

    None for other policies. Raises `ConfigurationError`.
    """
    if not isinstance(policy, (str, Path)):
        return None
    if Path(policy).suffix == SUFFIX:
        return read_configuration(Path(policy))
    name, colon, text = str(policy).partition(":")
    if not colon or name not in installed(GROUP).names:
        return None
    return PolicyConfiguration(policy=name, env="*", options=options_in(str(policy), text))


def is_code(policy: str) -> bool:
    """Return True for the name of code, `module:name`, and not of an installed policy with options."""
    policy = without_filter(policy)
    return ":" in policy and configured(policy) is None and not is_remote(policy)


def options_in(policy: str, text: str) -> dict[str, Any]:
    """Return the options in a policy's name: the content of an inline table of TOML, such as `a=1,b.c=false`."""
    try:
        options: dict[str, Any] = tomllib.loads(f"options = {{{text}}}")["options"]
    except (ValueError, RecursionError) as error:
        options, reason = {}, f" ({error})"
    else:
        reason = ""
    if not options:
        raise ConfigurationError(
            f"{policy} is read as a policy with options, NAME:OPTION=VALUE,OPTION=VALUE, with values as in TOML: "
            f"true, 12, 0.5, 'text', [1, 2]{reason}"
        )
    return options


def read_configuration(file: Path) -> PolicyConfiguration:
    """Read the configuration in a TOML file, whose policy is installed: a file runs no other code.

    Raises `ConfigurationError`.
    """
    configuration = checked_model(PolicyConfiguration, read_toml(file, DESCRIPTION), DESCRIPTION, str(file))
    if configuration.policy not in installed(GROUP).names:
        raise unknown_name(f"installed policy in {file}:", configuration.policy, installed(GROUP).names)
    return configuration


def tuning_of(policy: str) -> TuningCost | None:
    """Return the declared tuning of an expert, by the file that names it or that is beside it; None: nothing."""
    policy = without_filter(policy)
    configuration = configured(policy)
    if configuration is None and (file := configurations().get(policy)) is not None:
        configuration = read_configuration(file)
    return None if configuration is None else configuration.tuned


def configurations() -> dict[str, Path]:
    """Return the files with the options of installed policies that take options, by name."""
    return files_beside(GROUP, SUFFIX)
