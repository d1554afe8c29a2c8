"""A world model in a latent space, and a planner in it: TD-MPC2 (Hansen, Su and Wang, ICLR 2024), small.

Latents are groups of shares that sum to one (simplicial normalisation). Rewards and values are expectations over bins
of their symmetric logarithm. A planner samples sequences of actions, sums the rewards that the model imagines and the
value of what comes after, and moves on from the best (MPPI). Its random numbers are part of the network.
"""

import itertools
from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch.nn.functional import log_softmax, one_hot, softmax

GROUP = 8
"""Shares that sum to one."""
BINS, LARGEST = 41, 6.0
"""Number of bins of rewards and values, and the largest symmetric logarithm of these."""
LOG_STD = (-5.0, 1.0)
"""Range of the logarithm of the prior's standard deviations."""
TEMPERATURE = 0.5
"""Difference of values by which a sequence's weight falls to 1/e: a quarter of the paper's, for few samples."""
SMALLEST_STD, FIRST_STD = 0.05, 2.0
"""Standard deviation of actions that planning never goes below, and that of its first round."""
LARGEST_POWER = 20.0
"""Number from which on Mish is the identity, in 32-bit floats."""
PLAN = "plan"
"""Name of the planner's memory: the actions that it means to take next."""


class Shares(torch.nn.Module):
    """Turns each `GROUP` of numbers into shares."""

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Return shares (..., k) of numbers (..., k)."""
        return softmax(values.unflatten(-1, (-1, GROUP)), dim=-1).flatten(-2)


class Mish(torch.nn.Mish):
    """Mish, x tanh(log(1 + exp(x))), exported without Softplus, which is slow in ONNX Runtime."""

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Return numbers (...) of numbers (...)."""
        if not torch.compiler.is_exporting():
            return super().forward(values)
        powers = values.clamp(max=LARGEST_POWER).exp()
        twice = powers * (powers + 2)
        return values * twice / (twice + 2)


def normed_layers(sizes: list[int], last: int, end: torch.nn.Module | None = None) -> torch.nn.Sequential:
    """Return linear layers, each normed and followed by Mish, and a last one; `end` follows that, normed too."""
    layers: list[torch.nn.Module] = []
    for inputs, outputs in itertools.pairwise(sizes):
        layers += [torch.nn.Linear(inputs, outputs), torch.nn.LayerNorm(outputs), Mish()]
    layers.append(torch.nn.Linear(sizes[-1], last))
    return torch.nn.Sequential(*layers, *([torch.nn.LayerNorm(last), end] if end else []))


def symlog(values: torch.Tensor) -> torch.Tensor:
    """Return the symmetric logarithm, sign(x) log(1 + |x|)."""
    return values.sign() * values.abs().log1p()


class Binned(torch.nn.Module):
    """Layers whose outputs are the logits of a number's bins."""

    centres: torch.Tensor

    def __init__(self, sizes: list[int]) -> None:
        super().__init__()
        self.layers = normed_layers(sizes, BINS)
        torch.nn.init.zeros_(self.layers[-1].weight)
        self.register_buffer("centres", torch.linspace(-LARGEST, LARGEST, BINS))

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return expected numbers (...,)."""
        expected = (softmax(self.layers(inputs), dim=-1) * self.centres).sum(dim=-1)
        return expected.sign() * expected.abs().expm1()

    def loss(self, inputs: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """Return the cross entropy (...,) to targets (...,), each between two bins."""
        places = (symlog(targets).clamp(-LARGEST, LARGEST) + LARGEST) * (BINS - 1) / (2 * LARGEST)
        lower = places.floor().clamp(max=BINS - 2)
        upper_share = (places - lower)[..., None]
        lower = lower.long()
        shares = (1 - upper_share) * one_hot(lower, BINS) + upper_share * one_hot(lower + 1, BINS)
        return -(shares * log_softmax(self.layers(inputs), dim=-1)).sum(dim=-1)


class WorldModel(torch.nn.Module):
    """Encoder, dynamics, reward, critics, whether an episode has ended, and a prior of actions in [-1, 1]."""

    def __init__(
        self, features: BaseFeaturesExtractor, actions: int, *, hidden: int, latent: int, critics: int
    ) -> None:
        super().__init__()
        self.features, self.actions = features, actions
        self.encoder = normed_layers([features.features_dim, hidden], latent, Shares())
        sizes = [latent + actions, hidden, hidden]
        self.dynamics = normed_layers(sizes, latent, Shares())
        self.reward = Binned(sizes)
        self.critics = torch.nn.ModuleList(Binned(sizes) for _ in range(critics))
        self.termination = normed_layers([latent, hidden, hidden], 1)
        torch.nn.init.zeros_(self.termination[-1].weight)
        torch.nn.init.zeros_(self.termination[-1].bias)
        self.prior = normed_layers([latent, hidden, hidden], 2 * actions)

    def encode(self, observations: Any) -> torch.Tensor:
        """Return latents (n, latent) of observations."""
        return self.encoder(self.features(observations))

    def spread(self, latents: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return means and log standard deviations (..., actions) of the prior, before it is squashed."""
        means, log_stds = self.prior(latents).chunk(2, dim=-1)
        low, high = LOG_STD
        return means, low + (high - low) * (log_stds.tanh() + 1) / 2

    def imagined(self, latents: torch.Tensor, actions: torch.Tensor, gamma: float) -> torch.Tensor:
        """Return the values (...,) of actions (horizon, ..., actions) from latents, and of the prior afterwards.

        What comes after an episode's end counts for nothing.
        """
        total, goes_on = torch.zeros_like(latents[..., 0]), torch.ones_like(latents[..., 0])
        for t in range(len(actions)):
            inputs = torch.cat((latents, actions[t]), dim=-1)
            total = total + gamma**t * goes_on * self.reward(inputs)
            latents = self.dynamics(inputs)
            goes_on = goes_on * (self.termination(latents)[..., 0] <= 0)
        last = torch.cat((latents, self.spread(latents)[0].tanh()), dim=-1)
        values = torch.stack([critic(last) for critic in self.critics])
        return total + gamma ** len(actions) * goes_on * values.mean(dim=0)


class Planner(torch.nn.Module):
    """Plans in a model at each control step, from the last plan on: the network of an agent.

    Of `samples` sequences of `horizon` actions, `from_prior` are those of the model's prior, the first one its means.
    """

    noise: torch.Tensor
    prior_noise: torch.Tensor

    def __init__(
        self, model: WorldModel, *, gamma: float, horizon: int, samples: int, from_prior: int, elites: int, rounds: int
    ) -> None:
        super().__init__()
        self.model, self._gamma, self._horizon, self._elites, self._rounds = model, gamma, horizon, elites, rounds
        self.memory = {PLAN: (horizon * model.actions,)}
        self.register_buffer("noise", torch.empty(rounds, horizon, samples - from_prior, model.actions))
        self.register_buffer("prior_noise", torch.empty(horizon, from_prior, model.actions))
        self.draw_noise()

    def draw_noise(self) -> None:
        """Draw other random numbers."""
        self.noise.normal_()
        self.prior_noise.normal_()[:, 0] = 0.0

    def forward(self, observations: Any, plan: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return actions (n, k) in [-1, 1], and the plan of the next control step."""
        means, _, later = self.distribution(observations, plan)
        return means, later

    def distribution(self, observations: Any, plan: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return means and standard deviations (n, k) of the first actions of the best sequences, and the next plan."""
        latents = self.model.encode(observations)[:, None]
        proposed = self._proposals(latents)
        means = plan.unflatten(1, (self._horizon, self.model.actions))
        stds = torch.full_like(means, FIRST_STD)
        many = latents.expand(-1, self.noise.shape[2] + self.prior_noise.shape[1], -1)
        for noise in self.noise:
            around = means.transpose(0, 1)[:, :, None] + stds.transpose(0, 1)[:, :, None] * noise[:, None]
            actions = torch.cat((around.clamp(-1, 1), proposed), dim=2)  # (horizon, n, samples, actions)
            values = self.model.imagined(many, actions, self._gamma)
            best, places = values.topk(self._elites, dim=1)
            weights = softmax((best - best[:, :1]) / TEMPERATURE, dim=1)[:, :, None, None]
            among = actions.permute(1, 2, 0, 3)
            chosen = among.gather(1, places[:, :, None, None].expand(-1, -1, *among.shape[2:]))
            means = (weights * chosen).sum(dim=1)
            stds = (weights * (chosen - means[:, None]).square()).sum(dim=1).sqrt().clamp(min=SMALLEST_STD)
        later = torch.cat((means[:, 1:], torch.zeros_like(means[:, :1])), dim=1)
        return means[:, 0], stds[:, 0], later.flatten(1)

    def _proposals(self, latents: torch.Tensor) -> torch.Tensor:
        """Return sequences (horizon, n, from_prior, actions) that the prior draws."""
        latents, sequence = latents.expand(-1, self.prior_noise.shape[1], -1), []
        for noise in self.prior_noise:
            means, log_stds = self.model.spread(latents)
            sequence.append((means + log_stds.exp() * noise).tanh())
            latents = self.model.dynamics(torch.cat((latents, sequence[-1]), dim=-1))
        return torch.stack(sequence)
