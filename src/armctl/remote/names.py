"""Names of policies and environments in other processes, known without connecting.

`ws://HOST:PORT` is a policy server; `python=INTERPRETER:MODULE:NAME` is code for another Python, which runs it in a
process of its own.
"""

from typing import NamedTuple

from armctl.core.errors import ConfigurationError

SERVERS = ("ws://", "wss://")
OTHER_PYTHON = "python="


class OtherPython(NamedTuple):
    """Code for another Python."""

    interpreter: str
    module: str
    """Name of a module, or a file's path."""
    name: str


def is_remote(name: object) -> bool:
    """Return True for the name of a policy or environment in another process."""
    return isinstance(name, str) and name.startswith((*SERVERS, OTHER_PYTHON))


def other_python(name: str) -> OtherPython:
    """Return the parts of a name of code for another Python. Raises `ConfigurationError`."""
    interpreter, _, code = name.removeprefix(OTHER_PYTHON).partition(":")
    module, colon, attribute = code.rpartition(":")
    if not (interpreter and module and colon and attribute):
        raise ConfigurationError(
            f"{name} is read as code for another Python, python=INTERPRETER:MODULE:NAME, such as "
            "python=venv/bin/python:mine.py:policy"
        )
    return OtherPython(interpreter, module, attribute)
