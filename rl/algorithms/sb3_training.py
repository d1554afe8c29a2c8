"""The training loop of Stable-Baselines3's learners, with evaluations and checkpoints."""

import io
from collections.abc import Callable

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from armctl.agents import AgentCard
from armctl.core.files import write_atomically
from armctl.rl.networks.actor import Actor
from armctl.rl.run.training import CHECKPOINTS, Training
from armctl.rl.run.vector import StableBaselinesVectorEnv

REPLAY = "replay_buffer.pkl"


def decaying(rate: float) -> Callable[[float], float]:
    """Return a learning rate that decays linearly to a twentieth of `rate`: a function of the remaining share."""
    return lambda remaining: rate * max(remaining, 0.05)


def learn(
    training: Training,
    model: BaseAlgorithm,
    actor: Actor,
    make_vec_env: Callable[[], StableBaselinesVectorEnv] | None = None,
) -> AgentCard:
    """Train the model for the remaining steps, and finish the training.

    `make_vec_env` gives the training's present worlds as the model sees them; a learner without curricula needs none.
    An interrupt or an error leaves a checkpoint. `actor`, which shares the model's network, is evaluated and exported.
    """
    model.set_logger(training.logger)
    assert isinstance(model.env, StableBaselinesVectorEnv)
    model.env.seed(training.first_seed(model.num_timesteps))
    callback = TrainingCallback(training, actor, make_vec_env)
    try:
        remaining = training.options.steps - model.num_timesteps
        if remaining > 0:
            model.learn(remaining, callback=callback, reset_num_timesteps=False, progress_bar=training.shows_bars)
    finally:
        _checkpoint(training, model)
    return training.finish(actor, model.num_timesteps)


def _checkpoint(training: Training, model: BaseAlgorithm) -> None:
    """Write a checkpoint. The replay buffer is large: only the newest is kept."""
    if isinstance(model, OffPolicyAlgorithm):
        write_atomically(training.out / CHECKPOINTS / REPLAY, model.save_replay_buffer)
    buffer = io.BytesIO()  # a file would have torch fail in ways of its own on a full disk
    model.save(buffer)
    training.checkpoint(model.num_timesteps, buffer.getvalue())


class TrainingCallback(BaseCallback):
    """Saves a checkpoint and evaluates the actor whenever this is due, and changes worlds with the curriculum."""

    def __init__(
        self, training: Training, actor: Actor, make_vec_env: Callable[[], StableBaselinesVectorEnv] | None
    ) -> None:
        super().__init__()
        self._training, self._actor, self._make_vec_env = training, actor, make_vec_env

    def _on_rollout_start(self) -> None:
        if self._training.due(self.num_timesteps):
            _checkpoint(self._training, self.model)
            self._training.evaluate(self._actor, self.num_timesteps)

    def _on_rollout_end(self) -> None:
        if self._make_vec_env and self._training.enter_stage(self.num_timesteps):
            vec_env = self._make_vec_env()
            vec_env.seed(self._training.first_seed(self.num_timesteps))
            self.model.set_env(vec_env)
            self.model._last_obs = vec_env.reset()
            self.model._last_episode_starts = np.ones(vec_env.num_envs, dtype=bool)

    def _on_step(self) -> bool:
        return True
