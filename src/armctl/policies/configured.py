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
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict

from armctl.agents.costs import TuningCost
from armctl.core.errors import ConfigurationError, unknown_name
from armctl.core.files import read_toml
from armctl.core.options import checked_model
from armctl.core.registration import files_beside, installed
from armctl.policies.trainings import GROUP

SUFFIX = ".toml"
WHAT = "file of a policy's options"


class PolicyConfiguration(BaseModel):
    """An installed policy and its options."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    policy: str
    env: str
    """The environment for which the options were chosen."""
    env_options: dict[str, Any] = {}
    options: dict[str, Any] = {}
    tune: dict[str, Any] = {}
    """The search space of `armctl tune` (see `armctl.core.search_space`)."""
    tuned: TuningCost | None = None
    """The search for these values, or for better ones, whoever won it."""

    def make(self) -> Callable[..., Any]:
        """The function that makes the policy, with these options. Raises `ConfigurationError` if it takes none."""
        factory = installed(GROUP)[self.policy].load()
        if "options" not in inspect.signature(factory).parameters:
            raise ConfigurationError(
                f"{self.policy} takes no options; those that do: {', '.join(sorted(configurations()))}"
            )
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
    found = checked_model(PolicyConfiguration, read_toml(file, WHAT), WHAT, str(file))
    if found.policy not in installed(GROUP).names:
        raise unknown_name(f"installed policy in {file}:", found.policy, installed(GROUP).names)
    return found


def tuning_of(policy: str) -> TuningCost | None:
    """What is declared of the tuning of an expert, by the file that names it or that is beside it; None: nothing."""
    found = configured(policy)
    if found is None and (file := configurations().get(policy)) is not None:
        found = read_configuration(file)
    return None if found is None else found.tuned


def configurations() -> dict[str, Path]:
    """The files with the own options of installed policies that take options, by name."""
    return files_beside(GROUP, SUFFIX)
