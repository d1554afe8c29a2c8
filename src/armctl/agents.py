"""Learned agents as files: an ONNX graph from observations to actions, and a JSON card that says where it comes from.

Nothing is unpickled, and no code runs from either file: an agent from a stranger is safe to load.
"""

import hashlib
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import onnxruntime
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from armctl.envs import TaskVectorEnv
from armctl.errors import AgentFileError
from armctl.tasks import Observations

INPUT, OUTPUT = "observation", "action"


class Evaluation(BaseModel):
    """How an agent did on held-out episodes of the plain task."""

    model_config = ConfigDict(extra="forbid")

    episodes: int
    seed: int
    success_rate: float
    success_interval: tuple[float, float]
    """95 % Wilson interval."""
    mean_return: float
    mean_steps_to_goal: float | None


class AgentCard(BaseModel):
    """Where a learned agent comes from, and what it may be used for."""

    model_config = ConfigDict(extra="forbid")

    format: Literal["armctl-agent-1"] = "armctl-agent-1"
    name: str
    learner: str
    recipe: str | None = None
    env: str
    env_options: dict[str, Any]
    """Options of the environment that it acts in; the rest are defaults."""
    shaping: str | None = None
    """Potential of the reward on the way that it was trained with."""
    shaping_scale: float | None = None
    reward_weights: dict[str, float] = {}
    """Weights of the task's reward terms in training; 1 where not named."""
    teacher: str | None = None
    """The policy that it learned from."""
    interface: dict[str, str]
    """What must be the same wherever it acts, such as robot and control."""
    observation_shape: list[int] | dict[str, list[int]]
    """Of the observation, or of each of its arrays."""
    action_shape: list[int]
    training_steps: int
    best_after: int | None = None
    """Steps after which it did best on episodes held out for that: this agent is of then."""
    training_minutes: float
    training_seed: int
    learner_options: dict[str, Any]
    """What the learner was told."""
    versions: dict[str, str]
    sha256: str
    """Of the ONNX file."""
    evaluation: Evaluation | None = None


class OnnxPolicy:
    """A learned agent, run by onnxruntime. It sees the observation alone."""

    sees: Literal["observation", "state"] = "observation"

    def __init__(self, graph: Path, card: AgentCard) -> None:
        self.card = card
        self.training_steps = card.training_steps
        self.training_minutes = card.training_minutes
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = onnxruntime.InferenceSession(graph.read_bytes(), options, ["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime has an exception for each way a file can be broken
            raise AgentFileError(f"{graph} is not an ONNX graph that onnxruntime can run: {error}") from error
        reads, gives = (
            [value.name for value in values] for values in (self._session.get_inputs(), self._session.get_outputs())
        )
        shown = list(card.observation_shape) if isinstance(card.observation_shape, dict) else [INPUT]
        if (sorted(reads), gives) != (sorted(shown), [OUTPUT]):
            raise AgentFileError(f"{graph} maps {reads} to {gives}; by its card, it maps {shown} to ['{OUTPUT}']")

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Nothing to forget: the agent has no memory."""

    def act(self, observations: Observations) -> NDArray[np.float32]:
        """Actions (n, ...) for observations (n, ...), the same for a world whatever the number of worlds."""
        shown = observations if isinstance(observations, dict) else {INPUT: observations}
        worlds = len(next(iter(shown.values())))
        if worlds % 2:  # onnxruntime rounds the last of an odd number of rows in another way than all others
            shown = {name: np.concatenate((values, values[-1:])) for name, values in shown.items()}
        return np.asarray(self._session.run([OUTPUT], shown)[0])[:worlds]


def load_agent(path: Path, worlds: TaskVectorEnv) -> OnnxPolicy:
    """Load an agent by the path of its card or graph, which lie side by side, for the worlds of an environment.

    Raises `AgentFileError` if a file is missing or corrupt, or the agent was made for another environment.
    """
    card = read_card(path.with_suffix(".json"))
    graph = path.with_suffix(".onnx")
    if not graph.is_file():
        raise AgentFileError(f"the agent's graph {graph} is missing")
    if sha256(graph) != card.sha256:
        raise AgentFileError(f"{graph} is not the file that its card was written for: it was changed, or damaged")
    _check_made_for(card, worlds)
    return OnnxPolicy(graph, card)


def read_card(path: Path) -> AgentCard:
    """Read and check an agent's card; raises `AgentFileError`."""
    try:
        return AgentCard.model_validate_json(path.read_bytes())
    except OSError as error:
        raise AgentFileError(f"the agent's card {path} cannot be read: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "file"
        raise AgentFileError(f"{path} is not an agent's card: {where}: {first['msg']}") from error


def sha256(path: Path) -> str:
    """Checksum of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _check_made_for(card: AgentCard, worlds: TaskVectorEnv) -> None:
    trained = (card.observation_shape, card.action_shape)
    here = (shapes(worlds.single_observation_space), shapes(worlds.single_action_space))
    if trained != here:
        raise AgentFileError(
            f"agent {card.name} maps observations {trained[0]} to actions {trained[1]}; "
            f"here they are {here[0]} and {here[1]}"
        )
    for name, value in worlds.task.interface.items():
        if (learnt := card.interface.get(name)) != value:
            raise AgentFileError(f"agent {card.name} was trained for {name} {learnt!r}, and this is {name} {value!r}")


def inputs(space: gymnasium.Space[Any]) -> dict[str, gymnasium.Space[Any]]:
    """What an agent's graph reads of an observation space, by input name."""
    return dict(space.spaces) if isinstance(space, gymnasium.spaces.Dict) else {INPUT: space}


def shapes(space: gymnasium.Space[Any]) -> Any:
    """Shape of a space as a card has it: a list, or one for each of its arrays."""
    if isinstance(space, gymnasium.spaces.Dict):
        return {name: shapes(part) for name, part in space.spaces.items()}
    return list(space.shape or ())
