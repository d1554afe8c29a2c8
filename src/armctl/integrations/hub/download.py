"""Downloads an agent: three files by name, each of bounded size, and into place only after all checks."""

import contextlib
import functools
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from armctl.agents import CARD, GRAPH, OnnxPolicy, read_agent, read_card
from armctl.agents.graph import LARGEST_FILE
from armctl.core.errors import AgentFileError, ConfigurationError, HubError, ResultsError
from armctl.core.files import LARGEST_TEXT, file_checksum, one_writer, write_atomically
from armctl.integrations.hub.client import check_repository, hub_api, hub_errors, in_time
from armctl.integrations.hub.model_card import folder_of
from armctl.study.curves import CURVE, read_curve

if TYPE_CHECKING:
    from huggingface_hub import HfApi

LARGEST = {CARD: LARGEST_TEXT, GRAPH: LARGEST_FILE, CURVE: LARGEST_TEXT}
"""Bytes of the files that are downloaded. Others never are."""
TIMEOUT = 30.0
"""s, in which a hub says something."""


def pull(name: str, out: Path | None = None, *, overwrite: bool = False) -> Path:
    """Download an agent into the folder `out`, by default `agents/OWNER/NAME`. Returns the path of its card.

    `name` is OWNER/NAME of a repository, or OWNER/NAME@REVISION for one of its branches, tags or commits. All files are
    of one commit. They are checked as every agent from a stranger is, and nothing is written unless they pass. Without
    `overwrite`, files that differ from what is in the folder are not written.

    Raises `AgentFileError` for what is not an agent, `ConfigurationError` for a name that no repository can have or a
    folder with another agent, `ResultsError` if the folder cannot be written to, and `HubError`.
    """
    api = hub_api()
    repository, at, revision = name.partition("@")
    check_repository(repository)
    if at and not revision:
        raise ConfigurationError(f"{name!r} names no revision after the @, such as {repository}@main")
    folder = folder_of(repository) if out is None else out
    try:
        with tempfile.TemporaryDirectory(prefix="armctl-", ignore_cleanup_errors=True) as temporary:
            staging = Path(temporary)
            in_time(api.endpoint, lambda: _download(api, name, repository, revision or None, staging))
            with _refused(staging, name):
                OnnxPolicy(staging / GRAPH, read_agent(staging / CARD))
                if (staging / CURVE).exists():
                    read_curve(staging / CURVE)
            _place(staging, folder, overwrite)
    except OSError as error:
        raise ResultsError(f"{name} cannot be written to {folder}: {error.strerror or error}") from error
    return folder / CARD


def _download(api: "HfApi", name: str, repository: str, revision: str | None, staging: Path) -> None:
    """Download the card first: without a valid one, nothing else is worth it."""
    with hub_errors(api, name):
        commit = api.model_info(repository, revision=revision, expand=["sha"], timeout=TIMEOUT).sha
        if commit is None:
            raise HubError(f"{api.endpoint} does not say which commit {name} is")
        for file in LARGEST:
            if not _fetch(api, repository, commit, staging / file) and file != CURVE:
                raise AgentFileError(f"{name} has no {file}: it is not an agent of armctl")
            if file == CARD:
                with _refused(staging, name):
                    read_card(staging / CARD)


def _fetch(api: "HfApi", repository: str, commit: str, target: Path) -> bool:
    """Download one file. Returns whether there is one. Raises `AgentFileError` as soon as it is too large."""
    from huggingface_hub import get_session, hf_hub_url, hf_raise_for_status
    from huggingface_hub.errors import RemoteEntryNotFoundError
    from huggingface_hub.utils import build_hf_headers  # type: ignore[attr-defined]  # documented, but not in `__all__`

    url = hf_hub_url(repository, target.name, revision=commit, endpoint=api.endpoint)
    headers = build_hf_headers(library_name=api.library_name, library_version=api.library_version)
    with get_session().stream("GET", url, headers=headers, timeout=TIMEOUT) as response, target.open("wb") as file:
        try:
            hf_raise_for_status(response)
        except RemoteEntryNotFoundError:
            target.unlink()
            return False
        size = int(response.headers.get("Content-Length", 0))
        for chunk in response.iter_bytes():
            size = max(size, file.tell() + len(chunk))
            if size > LARGEST[target.name]:
                raise AgentFileError(
                    f"{target.name} of {repository} has {size:,} bytes or more, and armctl reads up to "
                    f"{LARGEST[target.name]:,}"
                )
            file.write(chunk)
    return True


@contextlib.contextmanager
def _refused(staging: Path, name: str) -> Iterator[None]:
    """Errors of files in the staging folder name the repository instead of that folder."""
    try:
        yield
    except (AgentFileError, ResultsError) as error:
        raise AgentFileError(f"{name} is refused: {str(error).replace(f'{staging}/', '')}") from error


def _place(staging: Path, folder: Path, overwrite: bool) -> None:
    """Put the files into a folder, the card last: it names the graph."""
    with one_writer(folder):
        for target in (folder / file for file in LARGEST):
            if (target.exists() or target.is_symlink()) and not overwrite and not _same(target, staging / target.name):
                raise ConfigurationError(
                    f"{target} is there already, and differs: --overwrite replaces the agent there"
                )
        for file in (GRAPH, CURVE, CARD):
            if (staging / file).exists():
                write_atomically(folder / file, functools.partial(shutil.copyfile, staging / file))
            else:
                (folder / file).unlink(missing_ok=True)


def _same(first: Path, second: Path) -> bool:
    return first.is_file() and second.is_file() and file_checksum(first) == file_checksum(second)
