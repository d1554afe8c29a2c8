"""The errors that armctl raises, and the wording they share."""

from collections.abc import Iterable
from difflib import get_close_matches

from armctl import DISTRIBUTION


class ArmctlError(Exception):
    """Base of every error that armctl raises on purpose."""


class ConfigurationError(ArmctlError, ValueError):
    """An option, a name or a file that armctl cannot work with."""


class InvalidAction(ArmctlError, ValueError):
    """An action of the wrong shape, or with numbers that are not finite. The world was not stepped."""


class UnreachableTarget(ArmctlError):
    """No configuration of the arm brings its end-effector to the target."""


class AgentFileError(ArmctlError):
    """A learned agent's file that is missing, corrupt, or made for something else."""


class ResultsError(ArmctlError):
    """A results folder that cannot be written, or that holds results already."""


def missing_extra(purpose: str, error: ModuleNotFoundError) -> ConfigurationError:
    """Error for a feature whose packages are not installed."""
    how = f"pip install '{DISTRIBUTION}[rl]', or pip install -e '.[rl]' in a clone"
    return ConfigurationError(f"{purpose} needs {error.name}: {how}")


def unknown_name(kind: str, name: object, allowed: Iterable[str]) -> ConfigurationError:
    """Error for a misspelt name: what was asked for, what there is, and the nearest."""
    names = sorted(allowed)
    nearest = get_close_matches(str(name), names, n=1)
    hint = f" Did you mean {nearest[0]!r}?" if nearest else ""
    return ConfigurationError(f"there is no {kind} {name!r}.{hint} There are: {', '.join(names) or 'none'}")
