"""The errors that armctl raises, and the wording they share."""

import inspect
import shlex
import sysconfig
import traceback
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any

from armctl import DISTRIBUTION
from armctl.core.causes import hint_for, source_line

FAILURES = (Exception, SystemExit)
"""Exceptions of other people's code when it fails. `sys.exit` in a policy ends the policy, not the comparison."""


class ArmctlError(Exception):
    """Base of every error that armctl raises on purpose."""


class ConfigurationError(ArmctlError, ValueError):
    """An option, a name or a file that armctl cannot work with."""


class UnknownOption(ConfigurationError, TypeError):
    """An option that there is not. It is a `TypeError` too, as for any function's unexpected keyword argument."""


class InvalidAction(ArmctlError, ValueError):
    """An action of the wrong shape, or with numbers that are not finite. No world was stepped."""

    def __init__(self, message: str, by_world: Mapping[int, str] = MappingProxyType({})) -> None:
        super().__init__(message)
        self.by_world = dict(by_world)
        """What is wrong with the actions of single worlds; empty if it is unknown which worlds' are invalid."""


class Disqualified(ArmctlError):
    """A policy changed the world in another way than by its actions."""


class EnvironmentFailed(ArmctlError):
    """An environment raised an error, or returned what an environment must not, such as a reward that is not finite."""


class ConnectionFailed(ArmctlError):
    """A policy or environment in another process is gone, does not answer in time, or answers nonsense."""


class TookTooLong(ArmctlError):
    """A call of a policy or environment in this process took longer than its limit."""


class UnreachableTarget(ArmctlError):
    """No configuration of the arm brings its end-effector to the target."""


class AgentFileError(ArmctlError):
    """A learned agent's file that is missing, corrupt, or made for something else."""


class HubError(ArmctlError):
    """A model hub that cannot be reached, refuses what was asked, or does not have it."""


class ResultsError(ArmctlError):
    """A results folder that cannot be written, or that holds results already."""


def no_results(folder: object) -> ResultsError:
    """Return an error for a results folder that is not there."""
    return ResultsError(f"there is no folder {folder}: armctl compare --out {shlex.quote(str(folder))} makes one")


@contextmanager
def os_errors_as(message: str, kind: type[ArmctlError] = ResultsError) -> Iterator[None]:
    """Raise an error with this message, and the system's reason, in place of an `OSError`."""
    try:
        yield
    except OSError as error:
        raise kind(f"{message}: {error.strerror or error}") from error


def reason(error: BaseException) -> str:
    """Return what an error says; of one of the system, without its number."""
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    return error.strerror if error.filename is None else f"{error.strerror}: {error.filename}"


def described(error: BaseException) -> str:
    """Return an error of user code in a line: its type, its message, its place, and a hint if its cause is known."""
    return f"{type(error).__name__}: {details_of(error)}"


def details_of(error: BaseException) -> str:
    """Return an error of user code in a line, without its type."""
    place, message = place_of(error), reason(error)
    if not message:
        message = source_line(error)
        place = "" if message.endswith(place.strip(" ()")) else place
    return f"{message}{place}{hint_for(error)}"


def place_of(error: BaseException) -> str:
    """Return the place in the user's own code of an error, such as ` (mine.py:27)`; empty if that took no part."""
    if isinstance(error, SyntaxError):
        return ""  # its message says where
    library = sysconfig.get_path("stdlib")
    frames = [
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if not f"{frame.f_globals.get('__name__')}.".startswith(("armctl.", "importlib."))
    ]
    user_frames = [frame for frame in frames if "site-packages" not in frame[0] and not frame[0].startswith(library)]
    return f" ({Path(user_frames[-1][0]).name}:{user_frames[-1][1]})" if user_frames else ""


def defined_at(value: Any) -> str:
    """Return where a function, a class or an object's class is defined, such as ` (mine.py:12)`; empty if unknown."""
    source = value if inspect.isclass(value) or inspect.isroutine(value) else type(value)
    try:
        return f" ({Path(inspect.getsourcefile(source) or '').name}:{inspect.getsourcelines(source)[1]})"
    except (OSError, TypeError):
        return ""


def format_cause(error: BaseException) -> str:
    """Return the traceback of what an error was made of, or its own."""
    return formatted(error.__cause__ or error)


def formatted(error: BaseException) -> str:
    """Return the traceback of an error as text."""
    return "".join(traceback.format_exception(error))


def missing_extra(purpose: str, error: ModuleNotFoundError, extra: str = "rl") -> ConfigurationError:
    """Return an error for a feature whose packages, those of an extra, are not installed."""
    how = f"pip install '{DISTRIBUTION}[{extra}]', or pip install -e '.[{extra}]' in a clone"
    return ConfigurationError(f"{purpose} needs {error.name}: {how}")


def unknown_name(kind: str, name: object, allowed: Iterable[str]) -> ConfigurationError:
    """Return an error for a misspelt name: what was asked for, what there is, and the nearest."""
    names = sorted(allowed)
    return ConfigurationError(
        f"there is no {kind} {name!r}.{nearest(name, names)} There are: {', '.join(names) or 'none'}"
    )


def nearest(name: object, names: Iterable[str]) -> str:
    """Return a question whether the nearest of some names was meant; nothing if none is near."""
    matches = get_close_matches(str(name), list(names), n=1)
    return f" Did you mean {matches[0]!r}?" if matches else ""
