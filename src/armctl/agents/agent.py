"""Learned agents as files: an ONNX graph from observations to actions, and a JSON card that describes its training.

Nothing is unpickled, and neither file can run code: an agent from a stranger is safe to load.
"""

import math
import os.path
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from armctl.agents.costs import Count, Seconds, TrainingCost, TuningCost, total_cost, total_tuning
from armctl.core.arrays import Observations
from armctl.core.errors import AgentFileError
from armctl.core.files import FORMAT, LARGEST_TEXT, bounded_bytes, check_format, file_checksum
from armctl.envs import Interface

if TYPE_CHECKING:
    from armctl.envs import EpisodeVectorEnv

FILES = (".onnx", ".json")
"""Suffixes of an agent's graph and card."""
GRAPH, CARD = "agent.onnx", "agent.json"
"""Names of an agent's graph and card in a training's folder, or in a repository."""
INPUT, OUTPUT, NEXT = "observation", "action", "next_"
"""Names in a graph: of its input if the observation is one array, of its first output, and before a new memory's."""


class Evaluation(BaseModel):
    """An agent's results on held-out episodes of the unmodified task."""

    model_config = ConfigDict(extra="forbid")

    episodes: int
    seed: int
    success_rate: float
    success_interval: tuple[float, float]
    """Exact 95 % interval of Clopper and Pearson."""
    mean_return: float
    mean_steps_to_goal: float | None
    """Mean over successful episodes."""
    mean_steps: float | None = None
    """Mean over all episodes. It and the next three are None if unknown."""
    std_return: float | None = None
    """Sample standard deviation of the return over episodes."""
    std_steps: float | None = None
    """Sample standard deviation of the number of control steps over episodes."""
    digest: str | None = None
    """Checksum of all episodes' outcomes and lengths, in their order."""


class Ancestor(BaseModel):
    """A policy that an agent learned from, directly or through its teachers: a network, or an expert."""

    model_config = ConfigDict(extra="forbid")

    name: str
    """Name of the policy, when it taught."""
    sha256: str | None = None
    """Checksum of the network's graph; None: it is no network, or its file is unknown."""
    recipe: str | None = None
    cost: TrainingCost
    """Cost of its own training, without its teachers; `UNTRAINED` for an expert, whose decisions as a teacher are
    among the costs of the training that it taught. `tuning` is of its own recipe or options."""

    @property
    def key(self) -> str:
        """Alike only for the same network or expert."""
        return self.sha256 or self.name


def distinct(lineage: Sequence[Ancestor]) -> list[Ancestor]:
    """Return each network and expert of a lineage once, in their order."""
    return list({ancestor.key: ancestor for ancestor in lineage}.values())


class Conversion(BaseModel):
    """Provenance of another library's model that became this agent, and how alike both act."""

    model_config = ConfigDict(extra="forbid")

    saved_with: str
    """Library and version that wrote the model's file."""
    source_sha256: str
    """Checksum of the model's file."""
    normalisation: str | None = None
    """Name of the file of the observations' statistics; None: the observations are not normalised."""
    normalisation_sha256: str | None = None
    observations: int
    """Number of observations on which both were compared."""
    largest_difference: float
    """Difference between their actions: as a share of the action's range, or of all actions if they are discrete."""


class AgentCard(BaseModel):
    """Card of an agent: how it was trained, and what it can be used for."""

    model_config = ConfigDict(extra="forbid")

    format: Literal["armctl-agent-1"] = "armctl-agent-1"
    name: str
    learner: str
    family: str | None = None
    """Kind of learning by which a suite ranks agents of several tasks together, such as `PPO`; None: unknown."""
    recipe: str | None = None
    env: str
    env_options: dict[str, Any]
    """Options of the environment that differ from the defaults."""
    training_options: dict[str, Any] = {}
    """Options of the environment that held in training only."""
    shaping: str | None = None
    """Potential of the reward shaping in training; None: there was none."""
    shaping_scale: float | None = None
    reward_weights: dict[str, float] = {}
    """Weights of the task's reward terms in training; 1 where not named."""
    curriculum: list[dict[str, Any]] = []
    """Later stages of the training, and what held in them instead."""
    filter: dict[str, Any] | None = None
    """Options of the safety filter behind which it was trained and acts; None: there is none."""
    teacher: str | None = None
    """The policy that it learned from, if any."""
    lineage: list[Ancestor] | None = None
    """All networks and experts that it learned from, directly or through its teachers, each once; None: unknown, as of
    another library's model."""
    tuning: TuningCost | None = None
    """Trials made to find its recipe; None: nothing is recorded."""
    interface: dict[str, str]
    """Properties that the task must share with the training, such as robot and control."""
    observation_shape: list[int] | dict[str, list[int]]
    """Shape of the observation, or of each of its arrays."""
    action_shape: list[int]
    memory: dict[str, list[int]] = {}
    """Memory from step to step: arrays of zeros at first, of these shapes for each world."""
    training_steps: int
    """Training steps as the learner counts them: see `TrainingCost`, which has the next four too."""
    decisions: Count | None = None
    teacher_queries: Count | None = None
    gradient_steps: Count | None = None
    processor_seconds: Seconds | None = None
    contacts: Count | None = None
    """Control steps of the training with a forbidden contact, over all worlds; None: unknown."""
    interventions: Count | None = None
    """Actions of the training that the safety filter changed; None: there was none."""
    best_after: int | None = None
    """Steps after which it performed best on validation episodes. The agent is the one after these steps."""
    training_minutes: float | None
    training_seed: int | None
    learner_options: dict[str, Any]
    """All options of the learner."""
    versions: dict[str, str]
    sha256: str
    """Checksum of the ONNX file."""
    conversion: Conversion | None = None
    """None: armctl trained it."""
    evaluation: Evaluation | None = None
    """Figures of the sealed test if a release has played it, or else of development episodes, as `seed` says."""
    development: Evaluation | None = None
    """Figures of development episodes, from before a release played the test's."""

    @field_validator(FORMAT, mode="before")
    @classmethod
    def _check_format(cls, value: Any) -> Any:
        check_format({FORMAT: value}, "armctl-agent-1")
        return value

    @property
    def judgement(self) -> Evaluation | None:
        """The evaluation by which its training judged it, and by which a recipe's trainings to publish are chosen."""
        return self.development or self.evaluation

    @property
    def sees(self) -> str:
        """Privilege for tables: the observation, unless it was trained with more, or the robot's model.

        A safety filter sees the state.
        """
        observation = self.interface.get("observation", "")
        if self.filter is not None:
            return "state"
        if self.env_options.get("observation") in ("full", "state") and observation.startswith("state"):
            return "state"
        if self.learner_options.get("features") == "model" or self.learner_options.get("commanding"):
            return "model"
        return "observation + velocities" if "joint_velocities" in observation else "observation"

    @property
    def cost(self) -> TrainingCost:
        """Cost of the training, those of its teachers, and the tuning of all their recipes."""
        counts = (self.decisions, self.teacher_queries, self.gradient_steps, self.processor_seconds)
        cost = TrainingCost(self.training_steps, self.training_minutes, *counts)
        lineage = self.lineage or []
        trained = [ancestor.cost for ancestor in distinct(lineage) if not ancestor.cost.is_untrained]
        tunings = {self.recipe or self.name: self.tuning}
        tunings |= {ancestor.recipe or ancestor.name: ancestor.cost.tuning for ancestor in lineage}
        return replace(
            cost, teachers=total_cost(trained) if trained else None, tuning=total_tuning(list(tunings.values()))
        )


class OnnxPolicy:
    """A learned agent, run by onnxruntime. It sees only the observation, and what it remembers of earlier ones."""

    sees: Any = "observation"
    reads = ("observation",)
    """Also if that shows it the state."""

    def __init__(self, graph: Path, card: AgentCard) -> None:
        from armctl.agents.graph import load_graph  # onnx takes longer to import than the rest, and few need it

        self.card, self.sees, self.family = card, card.sees, card.family
        self.training_steps, self.training_cost = card.training_steps, card.cost
        self._graph = load_graph(graph)
        observed = (
            card.observation_shape if isinstance(card.observation_shape, dict) else {INPUT: card.observation_shape}
        )
        inputs_, outputs = self._graph.inputs, list(self._graph.outputs.items())
        expected = [*observed.items(), *card.memory.items()]
        returned = [(OUTPUT, card.action_shape), *((NEXT + name, shape) for name, shape in card.memory.items())]
        if (sorted(inputs_.items()), outputs) != (sorted(expected), returned):
            raise AgentFileError(
                f"{graph} maps {inputs_} to {dict(outputs)}; by its card, it maps {dict(expected)} to {dict(returned)}"
            )
        self._memory: dict[str, NDArray[np.float32]] = {}

    @property
    def numbers(self) -> dict[str, NDArray[Any]]:
        """The graph's constants by name, such as a network's weights."""
        return self._graph.numbers

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Forget what it remembers of worlds `ids`, if it has a memory."""
        for remembered in self._memory.values():
            remembered[ids] = 0.0

    def act(self, observations: "Observations") -> NDArray[Any]:
        """Return actions (n, ...) for observations (n, ...). A world's action does not depend on other worlds."""
        arrays = observations if isinstance(observations, dict) else {INPUT: observations}
        # an environment may observe in another precision than its space says
        arrays = {name: np.asarray(values, dtype=self._graph.dtypes[name]) for name, values in arrays.items()}
        num_envs = len(next(iter(arrays.values())))
        actions, *memory = self._graph.run(arrays | self._memory_of(num_envs))
        self._memory = dict(zip(self.card.memory, memory, strict=True))
        return actions

    def _memory_of(self, num_envs: int) -> dict[str, NDArray[np.float32]]:
        """Return the memory (n, ...) of each world; zeros on the first step, or if the number of worlds has changed."""
        if any(len(remembered) == num_envs for remembered in self._memory.values()):
            return self._memory
        return {name: np.zeros((num_envs, *shape), dtype=np.float32) for name, shape in self.card.memory.items()}


def load_agent(path: Path, worlds: "EpisodeVectorEnv | Interface") -> OnnxPolicy:
    """Load an agent by the path of its card or graph, which are in the same folder, for the worlds of an environment.

    Raises `AgentFileError` if a file is missing or corrupt, or if the agent was made for another environment.
    """
    card = read_agent(path)
    _check_made_for(card, worlds)
    return OnnxPolicy(path.with_suffix(".onnx"), card)


def read_agent(path: Path) -> AgentCard:
    """Return the card of an agent whose graph is there and fits the card. Raises `AgentFileError`."""
    from armctl.agents.graph import LARGEST_FILE  # onnx takes longer to import than the rest, and few need it

    graph = path.with_suffix(".onnx")
    if not os.path.isfile(path):  # also for a name that no file can have
        raise AgentFileError(f"there is no agent {path}")
    card = read_card(path.with_suffix(".json"))
    if not graph.is_file():
        raise AgentFileError(f"the agent's graph {graph} is missing")
    if sha256(graph, LARGEST_FILE) != card.sha256:
        raise AgentFileError(f"{graph} does not have the checksum on its card: it was changed, or damaged")
    return card


def read_card(path: Path) -> AgentCard:
    """Read and check an agent's card. Raises `AgentFileError`."""
    try:
        return AgentCard.model_validate_json(bounded_bytes(path, LARGEST_TEXT))
    except OSError as error:
        raise AgentFileError(f"the agent's card {path} cannot be read: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "file"
        raise AgentFileError(f"{path} is not an agent's card: {where}: {first['msg']}") from error
    except ValueError as error:
        raise AgentFileError(f"{path} is not an agent's card: {error}") from error


def sha256(path: Path, largest: float = math.inf) -> str:
    """Return the SHA-256 checksum of a graph or model of at most `largest` bytes. Raises `AgentFileError`."""
    try:
        return file_checksum(path, largest)
    except OSError as error:
        raise AgentFileError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise AgentFileError(str(error)) from error


def _check_made_for(card: AgentCard, worlds: "EpisodeVectorEnv | Interface") -> None:
    trained = (card.observation_shape, card.action_shape)
    spaces = (shapes(worlds.single_observation_space), shapes(worlds.single_action_space))
    if trained != spaces:
        raise AgentFileError(
            f"agent {card.name}, trained in {card.env}, maps observations {trained[0]} to actions {trained[1]}; "
            f"here they are {spaces[0]} and {spaces[1]}"
        )
    if (card.env_options.get("actions") == "normalized") != worlds.normalized:
        raise AgentFileError(f"agent {card.name} was trained with other units: give actions as in its training")
    interface = worlds.interface if isinstance(worlds, Interface) else worlds.task.interface
    for name, value in interface.items():
        if (trained_for := card.interface.get(name)) != value:
            raise AgentFileError(
                f"agent {card.name} was trained for {name} {trained_for!r}, but here {name} is {value!r}"
            )


def inputs(space: gymnasium.Space[Any]) -> dict[str, gymnasium.Space[Any]]:
    """Return the inputs of an agent's graph for an observation space, by name."""
    return dict(space.spaces) if isinstance(space, gymnasium.spaces.Dict) else {INPUT: space}


def shapes(space: gymnasium.Space[Any]) -> Any:
    """Return the shape of a space in the format of a card: a list, or one for each of its arrays."""
    if isinstance(space, gymnasium.spaces.Dict):
        return {name: shapes(part) for name, part in space.spaces.items()}
    return list(space.shape or ())
