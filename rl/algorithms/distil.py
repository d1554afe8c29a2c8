"""Distillation of a teacher into a student with a memory: online imitation by a recurrent network.

The student acts, and the teacher, who may see more, labels each state that it gets into, as in DAgger (Ross, Gordon and
Bagnell, AISTATS 2011); what the student does not see it has to infer from what it remembers (Lee et al., Learning
quadrupedal locomotion over challenging terrain, Science Robotics 2020). The student learns from the last control steps,
through which gradients flow back (truncated backpropagation through time), and then forgets their labels. It may start
from an agent that was distilled before, for an easier task or from other features of the same number.

Under disturbances, the teacher sees none of them: it labels undisturbed observations or the true state. Where actions
are late, the label of an observation is the teacher's action in the state in which the student's will arrive.
"""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from tqdm import tqdm

from armctl.agents import AgentCard, OnnxPolicy
from armctl.core.arrays import map_arrays
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, Positive, options
from armctl.envs import make_worlds
from armctl.kinematics import ArmModel
from armctl.policies import Policy, make_policy
from armctl.rl.algorithms.cloning import LAST_RATE
from armctl.rl.data.demonstrations import teacher_in
from armctl.rl.networks.actor import Actor, tensors
from armctl.rl.networks.commanding import CommandingNetwork, layout_of
from armctl.rl.networks.onnx_graph import initial_memory
from armctl.rl.networks.recurrent import RecurrentNetwork, copy_weights
from armctl.rl.networks.view import Features, Unscaled
from armctl.rl.run.disk import torch_bytes
from armctl.rl.run.learner import learner
from armctl.rl.run.meter import Metered
from armctl.rl.run.options import TrainingOptions
from armctl.rl.run.training import Training

Steps = Annotated[int, Field(ge=0)]


@options
class DistilOptions(TrainingOptions):
    """Options of distillation, whose steps are environment steps."""

    family = "distillation"
    steps: Count = 2_000_000
    layers: Count = 1
    """Layers between the memory and the actions."""
    memory_units: Count = 128
    """Count of numbers that the student remembers."""
    length: Count = 32
    """Control steps of each world that are learned from at once, and through which gradients flow back."""
    epochs: Count = 4
    """Number of times that these are learned from."""
    minibatches: Count = 1
    """Groups of worlds into which they are split, with a gradient step for each."""
    mixed_steps: Steps = 200_000
    """Environment steps until the student acts alone. Until then, each action is the teacher's with a probability that
    decays linearly from 1."""
    largest_gradient: Positive = 1.0
    """Norm to which gradients are clipped."""
    start: str | None = None
    """Agent from whose weights the student starts, trained by distil with the same sizes, or without a memory and with
    one layer more than `layers`; None: random weights."""
    commanding: bool = False
    """Actions are relative to the student's own last command instead of the joints that it observes, with their noise;
    for arms that are commanded by joint positions."""
    features: Features = "invariant"
    evaluation_every: Count = 100_000

    def __post_init__(self) -> None:
        if self.minibatches > self.worlds:
            raise ConfigurationError(f"{self.worlds} worlds cannot be split into {self.minibatches} minibatches")


@learner(DistilOptions, rewards=False)
def train(training: Training, options: DistilOptions) -> AgentCard:
    """Let the teacher label what the student does, and teach the student by the labels."""
    for stage in training.recipe.stages:
        with closing(make_worlds(stage.env, 1, stage.options_in_training)) as envs:
            teacher_in(envs, stage, training.seed)  # raises an error now rather than in hours
    with training:
        student = Student(training, options)
        try:
            student.learn()
        finally:
            student.save()
        return training.finish(student.actor, student.steps)


class Student:
    """A recurrent network, and how it learns. It resumes from the training's newest checkpoint."""

    def __init__(self, training: Training, options: DistilOptions) -> None:
        self.training, self.options, self.steps = training, options, 0
        torch.manual_seed(training.seed)
        space = training.held_out.single_observation_space
        self.network, scale = network_for(training, options)
        if options.start is not None:
            start = make_policy(options.start, training.held_out)
            numbers = start.numbers if isinstance(start, OnnxPolicy) else {}
            copy_weights(self.network, {name: torch.tensor(values) for name, values in numbers.items()})
        self.actor = Actor(self.network, scale, space, self.network.memory)
        self._optimizer = torch.optim.Adam(self.network.parameters())
        training.meter.watch(self._optimizer)
        if (newest := training.newest_checkpoint()) is not None:
            saved = torch.load(newest, weights_only=True)
            self.actor.load_state_dict(saved["actor"])
            self._optimizer.load_state_dict(saved["optimizer"])
            self.steps = int(newest.stem)

    def save(self) -> None:
        """Write a checkpoint."""
        saved = {"actor": self.actor.state_dict(), "optimizer": self._optimizer.state_dict()}
        self.training.checkpoint(self.steps, torch_bytes(saved))

    def learn(self) -> None:
        """Learn from the teacher in the training's worlds until the steps are done."""
        training, total = self.training, self.options.steps
        batch = self._new_batch()
        with tqdm(total=total, initial=self.steps, desc="distil", leave=False, disable=not training.shows_bars) as bar:
            while self.steps < total:
                if training.due(self.steps):
                    self.save()
                    training.evaluate(self.actor, self.steps)
                if training.enter_stage(self.steps):
                    batch = self._new_batch()
                batch.play()
                for rows in batch.minibatches(self.options.epochs, self.options.minibatches):
                    self._descend(batch.loss(rows))
                steps = self.options.length * training.envs.num_envs
                self.steps += steps
                bar.update(steps)

    def _new_batch(self) -> "DistillationBatch":
        envs = self.training.envs
        return DistillationBatch(self, envs, teacher_in(envs.unwrapped, self.training.stage, self.training.seed))

    def _descend(self, loss: torch.Tensor) -> None:
        for group in self._optimizer.param_groups:
            group["lr"] = self.options.learning_rate * max(1 - self.steps / self.options.steps, LAST_RATE)
        self._optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.options.largest_gradient)
        self._optimizer.step()
        self.training.logger.record("train/loss", loss.item())


def network_for(training: Training, options: DistilOptions) -> tuple[RecurrentNetwork, torch.nn.Module]:
    """Return a student's network with random weights, and the map from its actions to the environment's."""
    view, envs = training.view, training.held_out
    features = view.extractor(envs.single_observation_space)
    sizes = {"hidden_units": options.hidden_units, "layers": options.layers, "memory_units": options.memory_units}
    if not options.commanding:
        return RecurrentNetwork(features, actions=envs.single_action_space.shape[0], **sizes), view.action_scale
    task, declared = envs.task, envs.task.learner_view
    if declared.relative_to is None or envs.normalized:
        raise ConfigurationError("commanding is for arms that are commanded by joint positions, and observe their own")
    network = CommandingNetwork(
        features, layout_of(task), ArmModel(task.robot).geometry(), idle=task.idle_action,
        largest_move=declared.largest_move, **sizes,
    )  # fmt: skip
    return network, Unscaled()


@dataclass
class LabelledStep:
    """A control step in n worlds."""

    observations: Any
    inputs: Any
    """Inputs of the student's network, from observations and memory."""
    labels: torch.Tensor
    """(n, k) actions of the teacher in the present states."""
    ongoing: torch.Tensor
    """(n, 1): True where the episode goes on."""
    delays: torch.Tensor
    """(n,) control steps after which the student's actions arrive."""
    targets: torch.Tensor = field(init=False)
    """(n, k) actions of the network for the labels of the states in which the student's actions arrive."""
    is_labelled: torch.Tensor = field(init=False)
    """(n,): False where an episode, or the batch, ends before the action arrives."""


class DistillationBatch:
    """A student's episodes in worlds with autoreset, labelled by a teacher who is in the same worlds."""

    def __init__(self, student: Student, envs: Metered, teacher: Policy) -> None:
        self._student, self._envs, self._teacher = student, envs, teacher
        training = student.training
        self._rng = np.random.default_rng((training.seed, student.steps))
        self._observations, _ = envs.reset(seed=training.first_seed(student.steps))
        teacher.reset(np.arange(envs.num_envs, dtype=np.int32))
        self._memory = initial_memory(student.network.memory, envs.num_envs)

    def play(self) -> None:
        """Make the next control steps."""
        self._initial_memory = self._memory
        with torch.no_grad():
            self._steps = [self._step() for _ in range(self._student.options.length)]
        for t in range(len(self._steps)):
            self._label(t)

    def minibatches(self, epochs: int, count: int) -> Iterator[NDArray[np.intp]]:
        """Yield all worlds in `count` random groups, other ones in each epoch."""
        for _ in range(epochs):
            yield from np.array_split(self._rng.permutation(self._envs.num_envs), count)

    def loss(self, rows: NDArray[np.intp]) -> torch.Tensor:
        """Return the mean squared difference to the labels in some worlds, in the network's unit."""
        network = self._student.network
        inputs = [map_arrays(lambda values: values[rows], step.inputs) for step in self._steps]
        ongoing = [step.ongoing[rows] for step in self._steps]
        targets = torch.stack([step.targets[rows] for step in self._steps])
        is_labelled = torch.stack([step.is_labelled[rows] for step in self._steps])
        actions = network.replay(inputs, ongoing, self._initial_memory[0][rows])
        return (network.errors(actions, targets).mean(dim=2) * is_labelled).mean()

    def _step(self) -> "LabelledStep":
        """Make a control step."""
        student, observations, envs = self._student, tensors(self._observations), self._envs.unwrapped
        inputs = student.network.inputs(observations, *self._memory)
        actions, *self._memory = student.network(observations, *self._memory)
        labels = self._teacher.act(self._observations)
        student.training.meter.add(teacher_queries=len(labels))
        delay = envs.disturbances.get("delay")
        delays = np.zeros(len(labels)) if delay is None else delay.levels.copy()
        executed, done = self._act(student.actor.scale(observations, actions).numpy(), labels)
        ongoing = torch.as_tensor(~done)[:, None]
        memory = student.network.remember(self._memory, torch.as_tensor(executed))
        self._memory = [remembered * ongoing for remembered in memory]
        labels = torch.as_tensor(labels, dtype=torch.float32)
        return LabelledStep(observations, inputs, labels, ongoing, torch.as_tensor(delays))

    def _label(self, t: int) -> None:
        """Give step t its labels: where actions are late, those of the step in which they arrive."""
        step, *later_steps = self._steps[t:]
        scale, ongoing = self._student.actor.scale, step.ongoing[:, 0]
        step.targets, step.is_labelled = scale.inverse(step.observations, step.labels), step.delays == 0
        for delay, later in enumerate(later_steps[: int(step.delays.max())], start=1):
            arrives = (step.delays == delay) & ongoing
            targets = scale.inverse(step.observations, later.labels)
            step.targets = torch.where(arrives[:, None], targets, step.targets)
            step.is_labelled = step.is_labelled | arrives
            ongoing = ongoing & later.ongoing[:, 0]

    def _act(self, actions: NDArray[Any], labels: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Take the student's actions (n, k), or the teacher's, and return them, and whose episode is done, (n,)."""
        mixed = self._student.options.mixed_steps
        share = 1 - self._student.steps / mixed if mixed else 0.0
        chosen = self._rng.random(len(labels)) < share
        executed = np.where(chosen[:, None], labels, actions)
        step = self._envs.step(executed)
        self._observations, done = step[0], step[2] | step[3]
        if done.any():
            self._teacher.reset(np.flatnonzero(done).astype(np.int32))
        return executed, done
