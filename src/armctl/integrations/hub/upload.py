"""Uploads an agent: its graph, its card, its learning curve, and a model card that is made of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from armctl import __version__
from armctl.agents import CARD, GRAPH, OnnxPolicy, read_agent
from armctl.core.errors import AgentFileError, ConfigurationError
from armctl.integrations.hub.client import check_repository, hub_api, hub_errors, in_time
from armctl.integrations.hub.model_card import model_card
from armctl.policies import agent_cards
from armctl.policies.trainings import card_path
from armctl.study.curves import CURVE, curve_path, read_curve

if TYPE_CHECKING:
    from huggingface_hub import HfApi

MODEL_CARD = "README.md"


def push(
    agent: str | Path,
    repository: str,
    *,
    private: bool = False,
    message: str | None = None,
    licence: str | None = None,
) -> str:
    """Upload an agent as one commit, into a repository OWNER/NAME that is made if need be. Returns its address.

    `agent` is an installed agent's name, the path of a card or graph, or a training's folder. It has to pass the checks
    of `pull`. `private` keeps a new repository to yourself. `message` is the commit's. `licence` is by the hub's names,
    such as `mit`.

    Raises `AgentFileError` and `ResultsError` for unusable files, `ConfigurationError` for an unknown name or if a
    private agent would become public, and `HubError`.
    """
    api = hub_api()
    check_repository(repository)
    path = _card_of(agent)
    card, graph, curve = read_agent(path), path.with_suffix(".onnx"), curve_path(path)
    OnnxPolicy(graph, card)
    files: dict[str, Path | bytes] = {GRAPH: graph, CARD: path.with_suffix(".json")}
    if curve.is_file():
        read_curve(curve)
        files[CURVE] = curve
    files[MODEL_CARD] = model_card(card, repository, licence).encode()
    default = f"{card.name}, by armctl {__version__}"
    return in_time(api.endpoint, lambda: _commit(api, repository, files, private, message or default))


def _commit(api: "HfApi", repository: str, files: Mapping[str, Path | bytes], private: bool, message: str) -> str:
    """Upload files as one commit, and return the repository's address."""
    from huggingface_hub import CommitOperationAdd, CommitOperationDelete

    with hub_errors(api, repository):
        address = api.create_repo(repository, private=private or None, exist_ok=True)
        if private and not api.model_info(repository, expand=["private"]).private:
            raise ConfigurationError(f"{address} is there already, and is public: nothing was uploaded")
        operations: list[CommitOperationAdd | CommitOperationDelete] = [
            CommitOperationAdd(path_in_repo=name, path_or_fileobj=file) for name, file in files.items()
        ]
        if CURVE not in files and api.file_exists(repository, CURVE):
            operations.append(CommitOperationDelete(CURVE))  # it is of an earlier agent
        api.create_commit(repository, operations, commit_message=message, num_threads=1)
    return str(address)


def _card_of(agent: str | Path) -> Path:
    folder = Path(agent)
    if str(agent) in agent_cards() or not folder.is_dir():
        return card_path(agent)
    if not (folder / CARD).is_file():
        raise AgentFileError(f"{folder} has no {CARD}: its training has not finished, or it is no training's folder")
    return folder / CARD
