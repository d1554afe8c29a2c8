"""PPO that starts from a policy worth keeping: the critic is fitted first, and a penalty holds the actor to its start.

The penalty is the KL divergence from the frozen start, for which kickstarting (Schmitt et al., "Kickstarting deep
reinforcement learning", 2018) has the weight decay. For Gaussians of one standard deviation it is half the squared
difference of their means, in standard deviations.
"""

import copy
from collections.abc import Callable, Iterator
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field
from stable_baselines3 import PPO
from stable_baselines3.common.utils import explained_variance

from armctl.agents import AgentCard
from armctl.core.options import Count, NonNegative, Positive, options
from armctl.rl.algorithms.ppo import PpoOptions, actor_of, load_or_make
from armctl.rl.algorithms.sb3_training import learn
from armctl.rl.networks.view import Features
from armctl.rl.run.training import LOG, Training
from armctl.rl.run.vector import StableBaselinesVectorEnv

CRITIC_EPOCHS = 20
"""Epochs of the fit of the critic, on each rollout."""
MIN_GAIN = 0.01
"""Gain of the explained variance of returns below which a rollout is in vain for the critic."""
PATIENCE_ROLLOUTS = 2
"""Rollouts in vain until the fit ends: one may be unlike others by chance."""


@options
class AnchoredPpoOptions(PpoOptions):
    """Options of PPO that starts from a policy worth keeping."""

    steps: Count = 1_000_000
    features: Features = "invariant"
    activation: Literal["elu", "relu"] = "relu"
    critic_steps: Count = 150_000
    """Environment steps after which PPO begins at the latest; until then, only the critic learns."""
    critic_rate: Positive = 1e-3
    """Learning rate of the critic until then."""
    anchor_weight: NonNegative = 0.1
    """Weight of the penalty on the KL divergence from the start."""
    anchor_decay: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Share of the training over which that weight decays to 0, linearly."""
    learning_rate: Positive = 3e-4
    initial_log_std: float = -2.0


class AnchoredPpo(PPO):
    """PPO whose loss has `anchor_weight` times the distance from the `anchor`, a frozen copy of the policy.

    The weight decays linearly, to 0 after the share `anchor_decay` of the training.
    """

    anchor_weight = 0.0
    anchor_decay = 1.0

    def _setup_model(self) -> None:
        super()._setup_model()
        self.anchor = copy.deepcopy(self.policy).requires_grad_(False)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "anchor", "anchor_weight", "anchor_decay"]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        modules, tensors = super()._get_torch_save_params()
        return [*modules, "anchor"], tensors

    def set_kl_anchor(self) -> None:
        """Hold the actor to what it is at present."""
        self.anchor.load_state_dict(self.policy.state_dict())

    def fit_critic(self, steps: int, optimizer: torch.optim.Optimizer) -> Iterator[float]:
        """Fit the critic to the returns of the actor, which stays as it is, in rollouts of at most so many steps.

        Yields the explained variance of each rollout's returns, which the critic has not seen then, and fits it to
        them, until the variance stops growing. Returns are discounted sums of rewards to the episode's end, or to the
        rollout's, from where the critic's own values count.
        """
        _, callback = self._setup_learn(steps)
        buffer, gae_lambda = self.rollout_buffer, self.gae_lambda
        best, in_vain = -np.inf, 0
        buffer.gae_lambda = 1.0
        while in_vain < PATIENCE_ROLLOUTS and self.num_timesteps < steps:
            self.collect_rollouts(self.env, callback, buffer, self.n_steps)
            explained = float(explained_variance(buffer.values.flatten(), buffer.returns.flatten()))
            in_vain = 0 if explained > best + MIN_GAIN else in_vain + 1
            best = max(best, explained)
            yield explained
            for batch in self._batches(CRITIC_EPOCHS):
                loss = (self.policy.predict_values(batch.observations).flatten() - batch.returns).square().mean()
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
        buffer.gae_lambda = gae_lambda

    def critic_parameters(self) -> list[torch.nn.Parameter]:
        """Return the weights that only the critic has."""
        parts = ["value_net", "mlp_extractor.value_net"]
        if not self.policy.share_features_extractor:
            parts.append("vf_features_extractor")
        return [weights for part in parts for weights in self.policy.get_submodule(part).parameters()]

    def train(self) -> None:
        """Update actor and critic by the rollouts: as in PPO, with the penalty in place of PPO's options."""
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        progress = 1 - self._current_progress_remaining
        weight = self.anchor_weight * max(0.0, 1 - progress / self.anchor_decay)
        clip = self.clip_range(self._current_progress_remaining)
        terms: list[list[float]] = []
        for batch in self._batches(self.n_epochs):
            values, actor = self._evaluate(batch.observations)
            log_prob, entropy = actor.log_prob(batch.actions).sum(dim=1), actor.entropy().sum(dim=1)
            advantages = batch.advantages
            if len(advantages) > 1:
                advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
            ratio = (log_prob - batch.old_log_prob).exp()
            gain = torch.min(advantages * ratio, advantages * ratio.clamp(1 - clip, 1 + clip)).mean()
            value_loss = (values.flatten() - batch.returns).square().mean()
            distance = self._distance_of(actor, batch.observations).mean() if weight else torch.zeros(())
            loss = self.vf_coef * value_loss - gain - self.ent_coef * entropy.mean() + weight * distance
            self.policy.optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
            self.policy.optimizer.step()
            terms.append([gain.item(), value_loss.item(), distance.item()])
        self._n_updates += self.n_epochs
        for name, value in zip(("gain", "value_loss", "distance_from_anchor"), np.mean(terms, axis=0), strict=True):
            self.logger.record(f"train/{name}", value)
        self.logger.record("train/anchor_weight", weight)

    def distance_from_anchor(self, observations: Any) -> torch.Tensor:
        """Return the KL divergence (n,) of the actor from the anchor, as if their standard deviations were equal."""
        return self._distance_of(self.policy.get_distribution(observations).distribution, observations)

    def _distance_of(self, actor: torch.distributions.Normal, observations: Any) -> torch.Tensor:
        with torch.no_grad():
            anchor = self.anchor.get_distribution(observations).distribution
        return ((actor.mean - anchor.mean) / anchor.stddev).square().sum(dim=1) / 2

    def _evaluate(self, observations: Any) -> tuple[torch.Tensor, torch.distributions.Normal]:
        """Return the critic's values (n, 1) and the actor's distribution, for which features are computed once."""
        policy = self.policy
        features = policy.extract_features(observations)
        of_actor, of_critic = features if isinstance(features, tuple) else (features, features)
        actor = policy._get_action_dist_from_latent(policy.mlp_extractor.forward_actor(of_actor))
        return policy.value_net(policy.mlp_extractor.forward_critic(of_critic)), actor.distribution

    def _batches(self, epochs: int) -> Iterator[Any]:
        for _ in range(epochs):
            yield from self.rollout_buffer.get(self.batch_size)


def improve(
    training: Training,
    options: AnchoredPpoOptions,
    make_vec_env: Callable[[], StableBaselinesVectorEnv],
    start: Callable[[AnchoredPpo], None],
) -> AgentCard:
    """Train by PPO from where `start` puts a new model's actor, and finish the training.

    `make_vec_env` gives the training's present worlds as the model sees them.
    """
    new = training.newest_checkpoint() is None
    model = load_or_make(training, options, AnchoredPpo, make_vec_env)
    model.anchor_weight, model.anchor_decay = options.anchor_weight, options.anchor_decay
    actor = actor_of(model, training)
    with training:
        if new:
            start(model)
            model.set_kl_anchor()
            training.evaluate(actor, 0)
            _fit_critic(training, model, min(options.critic_steps, options.steps), options.critic_rate)
        return learn(training, model, actor, make_vec_env)


def _fit_critic(training: Training, model: AnchoredPpo, steps: int, learning_rate: float) -> None:
    """Fit the critic on episodes of the actor, which stays as it is."""
    model.set_logger(training.logger)
    assert isinstance(model.env, StableBaselinesVectorEnv)
    model.env.seed(training.first_seed())
    optimizer = torch.optim.Adam(model.critic_parameters(), learning_rate)
    training.meter.watch(optimizer)
    for explained in model.fit_critic(steps, optimizer):
        LOG.info("%s steps: the critic explains %.0f%% of returns", f"{model.num_timesteps:,}", 100 * explained)
        training.logger.record("train/explained_variance", explained)
        training.logger.dump(model.num_timesteps)
