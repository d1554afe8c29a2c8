"""Learned agents as files: an ONNX graph from observations to actions, and a JSON card that describes its training.

Nothing is unpickled, and neither file can run code: an agent from a stranger is safe to load.
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
    """An agent's results on held-out episodes of the unmodified task."""

    model_config = ConfigDict(extra="forbid")

    episodes: int
    seed: int
    success_rate: float
    success_interval: tuple[float, float]
    """95 % Wilson interval."""
    mean_return: float
    mean_steps_to_goal: float | None


class AgentCard(BaseModel):
    """How an agent was trained, and what it can be used for."""

    model_config = ConfigDict(extra="forbid")

    format: Literal["armctl-agent-1"] = "armctl-agent-1"
    name: str
    learner: str
    recipe: str | None = None
    env: str
    env_options: dict[str, Any]
    """Options of the environment that differ from the defaults."""
    shaping: str | None = None
    """Potential of the reward shaping in training; None: there was none."""
    shaping_scale: float | None = None
    reward_weights: dict[str, float] = {}
    """Weights of the task's reward terms in training; 1 where not named."""
    teacher: str | None = None
    """The policy that it learned from, if any."""
    interface: dict[str, str]
    """Properties that the task must share with the training, such as robot and control."""
    observation_shape: list[int] | dict[str, list[int]]
    """Of the observation, or of each of its arrays."""
    action_shape: list[int]
    training_steps: int
    best_after: int | None = None
    """Steps after which it performed best on validation episodes. The agent is the one after these steps."""
    training_minutes: float
    training_seed: int
    learner_options: dict[str, Any]
    """All options of the learner."""
    versions: dict[str, str]
    sha256: str
    """Checksum of the ONNX file."""
    evaluation: Evaluation | None = None


class OnnxPolicy:
    """A learned agent, run by onnxruntime. It sees only the observation."""

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
        except Exception as error:  # onnxruntime raises many kinds of exceptions for broken files
            raise AgentFileError(f"{graph} is not an ONNX graph that onnxruntime can run: {error}") from error
        graph_inputs, graph_outputs = (
            [value.name for value in values] for values in (self._session.get_inputs(), self._session.get_outputs())
        )
        expected = list(card.observation_shape) if isinstance(card.observation_shape, dict) else [INPUT]
        if (sorted(graph_inputs), graph_outputs) != (sorted(expected), [OUTPUT]):
            raise AgentFileError(
                f"{graph} maps {graph_inputs} to {graph_outputs}; by its card, it maps {expected} to ['{OUTPUT}']"
            )

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Do nothing: the agent has no memory."""

    def act(self, observations: Observations) -> NDArray[np.float32]:
        """Actions (n, ...) for observations (n, ...). A world's action does not depend on the number of worlds."""
        arrays = observations if isinstance(observations, dict) else {INPUT: observations}
        worlds = len(next(iter(arrays.values())))
        if worlds % 2:  # onnxruntime rounds the last of an odd number of rows differently
            arrays = {name: np.concatenate((values, values[-1:])) for name, values in arrays.items()}
        return np.asarray(self._session.run([OUTPUT], arrays)[0])[:worlds]


def load_agent(path: Path, worlds: TaskVectorEnv) -> OnnxPolicy:
    """Load an agent by the path of its card or graph, which are in the same folder, for the worlds of an environment.

    Raises `AgentFileError` if a file is missing or corrupt, or if the agent was made for another environment.
    """
    card = read_card(path.with_suffix(".json"))
    graph = path.with_suffix(".onnx")
    if not graph.is_file():
        raise AgentFileError(f"the agent's graph {graph} is missing")
    if sha256(graph) != card.sha256:
        raise AgentFileError(f"{graph} does not have the checksum on its card: it was changed, or damaged")
    _check_made_for(card, worlds)
    return OnnxPolicy(graph, card)


def read_card(path: Path) -> AgentCard:
    """Read and check an agent's card. Raises `AgentFileError`."""
    try:
        return AgentCard.model_validate_json(path.read_bytes())
    except OSError as error:
        raise AgentFileError(f"the agent's card {path} cannot be read: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "file"
        raise AgentFileError(f"{path} is not an agent's card: {where}: {first['msg']}") from error


def sha256(path: Path) -> str:
    """SHA-256 checksum of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _check_made_for(card: AgentCard, worlds: TaskVectorEnv) -> None:
    trained = (card.observation_shape, card.action_shape)
    here = (shapes(worlds.single_observation_space), shapes(worlds.single_action_space))
    if trained != here:
        raise AgentFileError(
            f"agent {card.name}, trained in {card.env}, maps observations {trained[0]} to actions {trained[1]}; "
            f"here they are {here[0]} and {here[1]}"
        )
    for name, value in worlds.task.interface.items():
        if (trained_for := card.interface.get(name)) != value:
            raise AgentFileError(
                f"agent {card.name} was trained for {name} {trained_for!r}, but here {name} is {value!r}"
            )


def inputs(space: gymnasium.Space[Any]) -> dict[str, gymnasium.Space[Any]]:
    """The inputs of an agent's graph for an observation space, by name."""
    return dict(space.spaces) if isinstance(space, gymnasium.spaces.Dict) else {INPUT: space}


def shapes(space: gymnasium.Space[Any]) -> Any:
    """Shape of a space in the format of a card: a list, or one for each of its arrays."""
    if isinstance(space, gymnasium.spaces.Dict):
        return {name: shapes(part) for name, part in space.spaces.items()}
    return list(space.shape or ())
