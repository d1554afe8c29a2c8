"""TD-MPC2 (Hansen, Su and Wang, ICLR 2024), small: a world model in a latent space, which the agent plans in.

The model learns from all transitions so far: its latents should foretell the next ones, rewards and values, nothing
else. The agent's graph has the planner in it (`armctl.rl.networks.world_model`).
"""

import copy
from typing import Annotated, Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from pydantic import Field
from torch.nn.functional import binary_cross_entropy_with_logits
from tqdm import tqdm

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, Positive, Share, options
from armctl.rl.networks.onnx_graph import initial_memory
from armctl.rl.networks.world_model import GROUP, Planner, WorldModel
from armctl.rl.run.disk import torch_bytes
from armctl.rl.run.learner import learner
from armctl.rl.run.options import FrameOptions
from armctl.rl.run.training import Training
from armctl.rl.run.vector import vec_env_of

CONSISTENCY, REWARD, VALUE = 20.0, 0.1, 0.1
"""Weights of the losses, as in the paper."""
LATER = 0.5
"""Weight of a loss, of that one control step earlier."""
LARGEST_GRADIENT = 20.0
ENCODER_RATE = 0.3
"""Learning rate of the encoder, of that of the other parts."""
SCALE_SHARE = 0.01
"""Share by which the scale of values moves in each gradient step."""


@options
class TdMpcOptions(FrameOptions):
    """Options of TD-MPC2."""

    family = "TD-MPC2"
    steps: Count = 300_000
    worlds: Count = 64
    hidden_units: Count = 128
    latent: Annotated[int, Field(gt=0, multiple_of=GROUP)] = 64
    """Numbers of a latent."""
    critics: Annotated[int, Field(ge=2)] = 2
    horizon: Count = 3
    """Control steps of a plan, and of the sequences from which the model learns."""
    samples: Count = 48
    """Sequences of actions in each round of planning."""
    from_prior: Count = 12
    """Those of the learned prior among them."""
    elites: Count = 8
    """Sequences from which the next round starts."""
    rounds: Count = 2
    """Rounds of planning in each control step."""
    gradient_steps: Count = 8
    """Gradient steps per control step of all worlds."""
    batch_size: Count = 256
    buffer_size: Count = 300_000
    """Size of the replay buffer, transitions; a resumed training starts with an empty one."""
    random_steps: Count = 5_000
    """Environment steps with random actions, at first; then the gradient steps that they stand for are made."""
    tau: Share = 0.01
    """Share by which the critics' targets move in each gradient step."""
    entropy: Positive = 1e-3
    """Weight of the prior's entropy."""
    reward_scale: Positive = 0.1
    evaluation_every: Count = 20_000

    def __post_init__(self) -> None:
        super().__post_init__()
        if not max(self.from_prior, self.elites) < self.samples:
            raise ConfigurationError(f"of {self.samples} samples, fewer are from the prior, and fewer are elites")


@learner(TdMpcOptions, curriculum=False)
def train(training: Training, options: TdMpcOptions) -> AgentCard:
    """Act by planning, and fit the model to what has happened."""
    if not isinstance(training.held_out.single_observation_space, spaces.Box):
        raise ConfigurationError("td_mpc2 learns from observations that are one array, not several")
    with training:
        learning = Learning(training, options)
        try:
            learning.run()
        finally:
            learning.save()
        return training.finish(learning.actor, learning.steps)


class Replay:
    """The last transitions of n worlds, in the order in which they happened."""

    def __init__(self, rows: int, num_envs: int, observation: tuple[int, ...], actions: int) -> None:
        self._size, self._next = 0, 0
        shapes = {"observations": observation, "next": observation, "actions": (actions,), "rewards": ()}
        self._arrays = {name: np.zeros((rows, num_envs, *shape), np.float32) for name, shape in shapes.items()}
        self._arrays |= {name: np.zeros((rows, num_envs), np.float32) for name in ("terminated", "done")}

    def add(self, **values: Any) -> None:
        """Add a control step: (n, ...) of each array."""
        for name, array in self._arrays.items():
            array[self._next] = values[name]
        self._next = (self._next + 1) % len(self._arrays["done"])
        self._size = min(self._size + 1, len(self._arrays["done"]))

    def draw(self, rng: np.random.Generator, size: int, horizon: int) -> dict[str, torch.Tensor]:
        """Return sequences (horizon, size, ...) from random times; `goes_on`: that no episode ended before."""
        rows, num_envs = self._arrays["done"].shape
        oldest = self._next if self._size == rows else 0
        starts = oldest + rng.integers(self._size - horizon + 1, size=size)
        places = (starts + np.arange(horizon)[:, None]) % rows, rng.integers(num_envs, size=size)
        sequences = {name: torch.as_tensor(array[places]) for name, array in self._arrays.items()}
        is_over = torch.cat((torch.zeros(1, size), sequences["done"][:-1]))
        return sequences | {"goes_on": (1 - is_over).cumprod(dim=0)}


class Learning:
    """The model, the worlds, and how the model learns. It resumes from the training's newest checkpoint."""

    def __init__(self, training: Training, options: TdMpcOptions) -> None:
        self.training, self.options, self.steps = training, options, 0
        torch.manual_seed(training.seed)
        self._envs = vec_env_of(training.envs, training.view, options)
        sight = self._envs.policy_kwargs
        self.model = WorldModel(
            sight["features_extractor_class"](self._envs.observation_space, **sight["features_extractor_kwargs"]),
            self._envs.action_space.shape[0],
            hidden=options.hidden_units, latent=options.latent, critics=options.critics,
        )  # fmt: skip
        self.planner = Planner(
            self.model, gamma=options.gamma, horizon=options.horizon, samples=options.samples,
            from_prior=options.from_prior, elites=options.elites, rounds=options.rounds,
        )  # fmt: skip
        self.actor = self._envs.actor(self.planner, training)
        self._targets = copy.deepcopy(self.model.critics).requires_grad_(False)
        self._optimizer, self._prior_optimizer = self._new_optimizers()
        training.meter.watch(self._optimizer)
        self._scale = torch.ones(())
        self._saved = {
            "planner": self.planner, "targets": self._targets, "optimizer": self._optimizer,
            "prior_optimizer": self._prior_optimizer,
        }  # fmt: skip
        if (newest := training.newest_checkpoint()) is not None:
            states = torch.load(newest, weights_only=True)
            for name, part in self._saved.items():
                part.load_state_dict(states[name])
            self._scale, self.steps = states["scale"], int(newest.stem)

    def save(self) -> None:
        """Write a checkpoint."""
        states = {name: part.state_dict() for name, part in self._saved.items()}
        self.training.checkpoint(self.steps, torch_bytes(states | {"scale": self._scale}))

    def run(self) -> None:
        """Act and learn until the steps are done."""
        options, training, n = self.options, self.training, self._envs.num_envs
        rng = np.random.default_rng((training.seed, self.steps))
        rows = max(options.buffer_size // n, options.horizon)
        actions = self._envs.action_space.shape[0]
        replay = Replay(rows, n, self._envs.observation_space.shape, actions)
        self._envs.seed(training.first_seed(self.steps))
        observations, plan = self._envs.reset(), initial_memory(self.planner.memory, n)[0]
        is_new, start, due = self.steps == 0, self.steps, 0
        first = start + max(options.random_steps, options.horizon * n)
        with tqdm(
            total=options.steps, initial=start, desc="td_mpc2", leave=False, disable=not training.shows_bars
        ) as bar:
            while self.steps < options.steps:
                if training.due(self.steps):
                    self.save()
                    training.evaluate(self.actor, self.steps)
                if is_new and self.steps < options.random_steps:
                    proposed = rng.uniform(-1, 1, (n, actions)).astype(np.float32)
                else:
                    proposed, plan = self._explore(observations, plan)
                previous = observations
                observations, rewards, done, infos = self._envs.step(proposed)
                ends = np.flatnonzero(done)
                final, terminated = np.array(observations), np.array(done)
                for i in ends:
                    final[i] = infos[i]["terminal_observation"]
                    terminated[i] = not infos[i]["TimeLimit.truncated"]
                plan[ends] = 0.0
                replay.add(
                    observations=previous, next=final, actions=self._envs.executed(proposed), rewards=rewards,
                    terminated=terminated, done=done,
                )  # fmt: skip
                self.steps += n
                bar.update(n)
                due += options.gradient_steps
                while due and self.steps >= first:
                    self._learn(replay.draw(rng, options.batch_size, options.horizon))
                    due -= 1

    @torch.no_grad()
    def _explore(self, observations: NDArray[Any], plan: torch.Tensor) -> tuple[NDArray[np.float32], torch.Tensor]:
        """Return random actions (n, k) from the best ones, and the next plans. Each draws its own random numbers."""
        self.planner.draw_noise()
        means, stds, later = self.planner.distribution(torch.as_tensor(observations), plan)
        return (means + stds * torch.randn_like(stds)).clamp(-1, 1).numpy(), later

    def _learn(self, batch: dict[str, torch.Tensor]) -> None:
        """Make a gradient step of the model, and one of its prior."""
        latents = self._fit_model(batch)
        self._fit_prior(latents, batch["goes_on"])
        with torch.no_grad():
            for target, source in zip(self._targets.parameters(), self.model.critics.parameters(), strict=True):
                target.lerp_(source, self.options.tau)

    def _fit_model(self, batch: dict[str, torch.Tensor]) -> torch.Tensor:
        """Fit all but the prior, and return the latents (horizon, n, latent) that the model foretells for a batch."""
        model, options, loss = self.model, self.options, torch.zeros(())
        with torch.no_grad():
            following = model.encode(batch["next"].flatten(0, 1)).unflatten(0, batch["done"].shape)
            best = torch.cat((following, model.spread(following)[0].tanh()), dim=-1)
            ahead = torch.min(*(self._targets[i](best) for i in torch.randperm(len(self._targets))[:2]))
            returns = batch["rewards"] + options.gamma * (1 - batch["terminated"]) * ahead
        latent, latents = model.encode(batch["observations"][0]), []
        for t, goes_on in enumerate(batch["goes_on"]):
            latents.append(latent.detach())
            inputs = torch.cat((latent, batch["actions"][t]), dim=-1)
            latent = model.dynamics(inputs)
            losses = CONSISTENCY * (latent - following[t]).square().mean(dim=-1)
            end_logits = model.termination(latent)[..., 0]
            losses = losses + binary_cross_entropy_with_logits(end_logits, batch["terminated"][t], reduction="none")
            losses = losses + REWARD * model.reward.loss(inputs, batch["rewards"][t])
            values = sum(critic.loss(inputs, returns[t]) for critic in model.critics)
            losses = losses + VALUE * values / len(model.critics)
            loss = loss + LATER**t * (losses * goes_on).mean()
        self._descend(self._optimizer, loss)
        return torch.stack(latents)

    def _fit_prior(self, latents: torch.Tensor, goes_on: torch.Tensor) -> None:
        """Fit the prior to the critics' values, in the unit of their spread, and to its entropy."""
        means, log_stds = self.model.spread(latents)
        noise = torch.randn_like(means)
        actions = (means + log_stds.exp() * noise).tanh()
        log_likelihoods = (-noise.square() / 2 - log_stds - (1 - actions.square() + 1e-6).log()).sum(dim=-1)
        inputs = torch.cat((latents, actions), dim=-1)
        values = torch.stack([critic(inputs) for critic in self.model.critics]).mean(dim=0)
        low, high = values.detach()[0].quantile(torch.tensor([0.05, 0.95]))
        self._scale.lerp_((high - low).clamp(min=1.0), SCALE_SHARE)
        weights = LATER ** torch.arange(len(latents))[:, None] * goes_on
        loss = (weights * (self.options.entropy * log_likelihoods - values / self._scale)).mean()
        self._descend(self._prior_optimizer, loss)

    def _new_optimizers(self) -> tuple[torch.optim.Optimizer, torch.optim.Optimizer]:
        model, rate = self.model, self.options.learning_rate
        seeing = [*model.features.parameters(), *model.encoder.parameters()]
        others = [model.dynamics, model.reward, model.critics, model.termination]
        groups = [
            {"params": seeing, "lr": ENCODER_RATE * rate},
            {"params": [parameter for part in others for parameter in part.parameters()]},
        ]
        return torch.optim.Adam(groups, rate), torch.optim.Adam(model.prior.parameters(), rate)

    @staticmethod
    def _descend(optimizer: torch.optim.Optimizer, loss: torch.Tensor) -> None:
        optimizer.zero_grad()
        loss.backward()
        parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        torch.nn.utils.clip_grad_norm_(parameters, LARGEST_GRADIENT)
        optimizer.step()
