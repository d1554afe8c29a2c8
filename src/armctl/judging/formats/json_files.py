"""JSON: the result files of others that are known, lists of objects, and JSON lines."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from armctl.core.errors import ConfigurationError
from armctl.core.files import bounded_text
from armctl.judging.formats import lerobot, robo_evals, vla_eval
from armctl.judging.rows import Rows, rows_of_records

FORMATS: Sequence[Callable[[str, Any], list[Rows] | None]] = (lerobot.rows, vla_eval.rows, robo_evals.rows)
"""Formats, each of which returns None for a file of another one."""
LISTS = ("episodes", "results", "trials", "rollouts", "per_episode", "data")
"""Keys under which files of no known format have their episodes."""


def read(path: Path) -> list[Rows]:
    """Read a JSON file. Raises `ConfigurationError`, `OSError` or `ValueError`."""
    source = str(path)
    try:
        document = json.loads(bounded_text(path).removeprefix("\ufeff"))
    except json.JSONDecodeError as error:
        if error.msg == "Extra data":
            return read_lines(path)
        raise ConfigurationError(f"{source}, line {error.lineno}: it is not JSON: {error.msg}") from None
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    for rows_of in FORMATS:
        try:
            rows = rows_of(source, document)
        except (AttributeError, KeyError, TypeError) as error:
            name = rows_of.__module__.rpartition(".")[2]
            raise ValueError(f"it is no whole result file of {name}: {type(error).__name__} {error}") from None
        if rows is not None:
            return rows
    return [_plain(source, document)]


def _plain(source: str, document: Any) -> Rows:
    """Return the rows of a list of objects, by itself or in an object, or of an object of columns."""
    if isinstance(document, list):
        return rows_of_records(source, document, "episode")
    if not isinstance(document, dict) or not document:
        raise ValueError("it has no list of episodes")
    name = next((name for name in LISTS if isinstance(document.get(name), list)), None)
    if name is not None:
        texts = {key: value for key in ("policy", "task") if isinstance(value := document.get(key), str)}
        return rows_of_records(source, document[name], "episode", constants=texts)
    if not all(isinstance(column, list) for column in document.values()):
        raise ValueError("it has no list of episodes")
    lengths = {name: len(values) for name, values in document.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"its columns differ in length: {lengths}")
    records = [dict(zip(document, row, strict=True)) for row in zip(*document.values(), strict=True)]
    return rows_of_records(source, records, "episode")


def read_lines(path: Path) -> list[Rows]:
    """Read JSON lines: an object in each line. Raises `ConfigurationError`, `OSError` or `ValueError`."""
    source, records, places = str(path), [], []
    for number, line in enumerate(bounded_text(path).lstrip("\ufeff").splitlines(), 1):
        if line.strip():
            try:
                records.append(json.loads(line))
            except ValueError as error:
                raise ConfigurationError(f"{source}, line {number}: it is not JSON: {error}") from None
            except RecursionError:
                raise ValueError(f"line {number} is nested too deeply") from None
            places.append(number)
    rows = rows_of_records(source, records, "line")
    rows.places = places
    return [rows]
