"""The hub's side: its API, which names a repository can have, and what its failures are called here."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import TYPE_CHECKING, TypeVar

from armctl.core.errors import ArmctlError, ConfigurationError, HubError, missing_extra

if TYPE_CHECKING:
    from huggingface_hub import HfApi

LONGEST_MESSAGE = 300
"""Characters of what a hub says that are shown."""
LONGEST_TRANSFER = 600.0
"""s of all that a download or an upload asks a hub, which may send a byte now and then for ever."""
Result = TypeVar("Result")


def hub_api() -> "HfApi":
    """Return the API of the hub that the environment variable `HF_ENDPOINT` names, by default Hugging Face's.

    Raises `ConfigurationError` if the extra `hub` is not installed.
    """
    try:
        from huggingface_hub import HfApi
    except ModuleNotFoundError as error:
        raise missing_extra("sharing agents", error, "hub") from error
    from armctl import __version__

    return HfApi(library_name="armctl", library_version=__version__)


def check_repository(name: str) -> None:
    """Check that a name is OWNER/NAME, as the hub spells it, and so no path. Raises `ConfigurationError`."""
    from huggingface_hub.errors import HFValidationError
    from huggingface_hub.utils import validate_repo_id  # type: ignore[attr-defined]  # not in `__all__`

    try:
        validate_repo_id(name)
    except HFValidationError as error:
        raise ConfigurationError(f"{name!r} is not the name of a repository, OWNER/NAME. {error}") from error
    if "/" not in name:
        raise ConfigurationError(f"{name!r} is not the name of a repository: whose is it, OWNER/{name}?")


def in_time(hub: str, transfer: Callable[[], Result]) -> Result:
    """Return what a transfer returns. Raises what it raises, and `HubError` if it takes too long."""
    future = Future[Result]()

    def work() -> None:
        try:
            future.set_result(transfer())
        except BaseException as error:  # it is raised below
            future.set_exception(error)

    threading.Thread(target=work, name="Transfer", daemon=True).start()
    try:
        return future.result(LONGEST_TRANSFER)
    except TimeoutError as error:
        if future.done():
            raise
        raise HubError(f"{hub} has not finished within {LONGEST_TRANSFER:g} s: given up") from error


@contextlib.contextmanager
def hub_errors(api: "HfApi", repository: str) -> Iterator[None]:
    """Turn errors of the hub into a `HubError` of one line. `repository` is its name, with the revision."""
    import httpx2  # of huggingface_hub
    from huggingface_hub.errors import (
        HfHubHTTPError,
        OfflineModeIsEnabled,
        RepositoryNotFoundError,
        RevisionNotFoundError,
    )

    hub, who = api.endpoint, "`hf auth login` or the variable HF_TOKEN tells the hub who you are"
    try:
        yield
    except ArmctlError:
        raise
    except RevisionNotFoundError as error:
        raise HubError(f"{hub} has no such revision as {repository}") from error
    except RepositoryNotFoundError as error:
        raise HubError(f"{hub} has no {repository}, or it is not for you: {who}") from error
    except HfHubHTTPError as error:
        status, message = error.response.status_code, _brief(error.server_message or error.response.reason_phrase)
        hint = f". {who}" if status in (401, 403) else ""
        raise HubError(f"{hub} answers for {repository} with status {status}: {message}{hint}") from error
    except OfflineModeIsEnabled as error:
        raise HubError(f"{hub} is not asked, since HF_HUB_OFFLINE is set") from error
    except (httpx2.HTTPError, httpx2.InvalidURL) as error:
        raise HubError(f"{hub} cannot be reached, or broke off: {error or type(error).__name__}") from error
    except (ValueError, KeyError, TypeError, AttributeError, RuntimeError) as error:  # its answers make no sense
        raise HubError(
            f"{hub} did not take or give {repository}: {_brief(f'{error} {error.__cause__ or str()}')}"
        ) from error


def _brief(text: str) -> str:
    return " ".join(text.split())[:LONGEST_MESSAGE]
