"""Finds and reads the files of results, each by the reader of its format."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from armctl.core.errors import ArmctlError, ConfigurationError, reason
from armctl.episodes.stored import STORE
from armctl.judging.formats import delimited, json_files, parquet, sb3
from armctl.judging.rows import Rows

READERS: Mapping[str, Callable[[Path], list[Rows]]] = {
    ".csv": delimited.read,
    ".tsv": delimited.read,
    ".txt": delimited.read,
    ".json": json_files.read,
    ".jsonl": json_files.read_lines,
    ".ndjson": json_files.read_lines,
    ".npz": sb3.read,
    ".parquet": parquet.read,
}
"""Readers of files, by the ending of their names."""
IN_FOLDERS = ("evaluations.npz", "eval_info.json", "report.json", "*monitor.csv", "*.csv", "*.tsv", "*.jsonl", "*.json")
"""Files that a folder is searched for, with all folders in it: those of the first pattern that matches any."""
UNTOLD = {"evaluations", "eval_info", "report", "results", "episodes", "monitor", "eval", "evaluation", "eval_results",
          "metrics", "rollouts", "trials", "data", "summary"}  # fmt: skip
"""Names of files that say nothing of the policy: its folder's name does."""
LARGEST_FOLDER = 10_000
"""Files of a folder."""


def files_of(paths: Iterable[str | Path]) -> list[Path]:
    """Return the files that are meant: a folder stands for the result files in it.

    Raises `ConfigurationError` for a path that is not there, and for a folder without results.
    """
    files: list[Path] = []
    for path in map(Path, paths):
        try:
            inside = sorted(path.rglob("*")) if path.is_dir() else None
        except (OSError, ValueError) as error:
            raise ConfigurationError(f"{path} cannot be read: {reason(error)}") from error
        if inside is None:
            files.append(path)
            continue
        matches = next((list(matching) for pattern in IN_FOLDERS if (matching := [
            file for file in inside if file.match(pattern) and file.is_file()])), [])  # fmt: skip
        if not matches:
            raise ConfigurationError(f"{path} has no results: none of {', '.join(IN_FOLDERS)} is in it")
        files += matches[:LARGEST_FOLDER]
    if twice := [file for i, file in enumerate(files) if file in files[:i]]:
        raise ConfigurationError(f"{twice[0]} is named twice")
    return files


def read_file(path: Path) -> list[Rows]:
    """Read a file of results. Raises `ConfigurationError` with the file and the reason."""
    reader = READERS.get(path.suffix.lower())
    if path.name == STORE:
        raise ConfigurationError(f"{path} is the store of a results folder: name the folder {path.parent}")
    if reader is None and os.path.exists(path):
        raise ConfigurationError(f"{path}: armctl judge reads {', '.join(READERS)}, and armctl's results folders")
    try:
        return (reader or delimited.read)(path)
    except ArmctlError:
        raise
    except (OSError, ValueError) as error:
        why = "it is no text in a known encoding" if isinstance(error, UnicodeError) else reason(error)
        raise ConfigurationError(f"{path} cannot be read: {why.removesuffix(f': {path}')}") from error


def policy_names(files: Sequence[Path]) -> dict[str, str]:
    """Return a name for the policy of each file, for files that name none: as short as keeps them apart."""
    parts = [_parts(file) for file in files]
    names = {}
    for file, path_parts in zip(files, parts, strict=True):
        depth = 1
        while depth < len(path_parts) and sum(other[-depth:] == path_parts[-depth:] for other in parts) > 1:
            depth += 1
        names[str(file)] = "/".join(path_parts[-depth:])
    return names


def _parts(file: Path) -> tuple[str, ...]:
    stem = file.name
    for suffix in (file.suffix, ".monitor"):
        stem = stem.removesuffix(suffix)
    *folders, _ = file.absolute().parts
    return tuple(folders[1:]) if stem.lower() in UNTOLD and len(folders) > 1 else (*folders[1:], stem)
