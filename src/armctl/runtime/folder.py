"""Folders of one identity: nothing of another identity is mixed into them.

A folder has one writer at a time (`armctl.core.files.one_writer`), and a sealed file with the identity of what is made
in it. So what another program, another configuration or another code has made there is neither continued nor replaced.
"""

import contextlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from armctl.core.errors import ResultsError, reason
from armctl.core.files import bounded_text, unsealed

OTHERWISE = "choose another folder, or overwrite it (--overwrite)"

Reasons = Callable[[Mapping[str, Any], Mapping[str, Any]], Sequence[str]]
"""Function that returns why what a stored identity names cannot be continued with another one, in words."""


def differences(stored: Mapping[str, Any], local: Mapping[str, Any]) -> list[str]:
    """Return what differs between two identities, in words."""
    texts = []
    for name, value in local.items():
        other = stored.get(name)
        if isinstance(value, dict) and isinstance(other, dict):
            keys = [key for key in {**other, **value} if other.get(key) != value.get(key)]
            texts += [f"{name}: {key} {other.get(key)} there, {value.get(key)} here" for key in keys]
        elif other != value:
            texts.append(f"{name}: {other} there, {value} here")
    return texts


def claim(
    file: Path,
    identity: Mapping[str, Any],
    kind: str,
    otherwise: str = OTHERWISE,
    reasons: Reasons = differences,
    format_number: int | str | None = None,
) -> dict[str, Any] | None:
    """Return the values of a sealed file that holds this identity, by itself or as `identity`; None if there is none.

    Raises `ResultsError` if it is damaged, has another format than `format_number`, or holds another identity. The
    message says what `kind` of thing that is, the differences, and what to do `otherwise`.
    """
    if not file.exists():
        return None
    values = read_sealed(file, otherwise, format_number)
    with _damage(file, otherwise):
        changes = reasons(values.get("identity", values), json.loads(json.dumps(identity)))
    refuse_changes(file.parent, changes, kind, otherwise)
    return values


def read_sealed(file: Path, otherwise: str = OTHERWISE, format_number: int | str | None = None) -> dict[str, Any]:
    """Return the values of a sealed file.

    Raises `ResultsError`, with what to do `otherwise`, if it is damaged or has another format than `format_number`.
    """
    with _damage(file, otherwise):
        return unsealed(bounded_text(file), format_number)


@contextlib.contextmanager
def _damage(file: Path, otherwise: str) -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError, AttributeError, RecursionError) as error:
        raise ResultsError(f"{file} cannot be read, or is damaged ({reason(error)}): {otherwise}") from error


def refuse_changes(folder: Path, changes: Sequence[str], kind: str, otherwise: str = OTHERWISE) -> None:
    """Raise `ResultsError` if anything about what a folder holds has changed: then it is of another `kind`."""
    if changes:
        raise ResultsError(f"{folder} holds {kind} ({'; '.join(changes)}): {otherwise}")
