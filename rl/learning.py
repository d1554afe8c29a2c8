"""What the learners of Stable-Baselines3 share: they learn, and are judged and kept on the way."""

from pathlib import Path
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from armctl.agents import AgentCard
from armctl.rl.actor import Actor
from armctl.rl.training import Training, write_whole
from armctl.rl.vector import StableBaselinesVectorEnv

REPLAY = "replay_buffer.pkl"


def learn(training: Training, model: BaseAlgorithm, actor: Actor, progress: bool) -> AgentCard:
    """Let the model learn what is left of the training, and finish it.

    However it ends, a checkpoint is left. `actor` is what is judged and exported: it shares the model's network.
    """
    model.set_logger(training.logger)
    assert isinstance(model.env, StableBaselinesVectorEnv)
    model.env.seed(training.first_seed(model.num_timesteps))
    watch = EvalCheckpointCallback(training, actor)
    try:
        remaining = training.options.steps - model.num_timesteps
        if remaining > 0:
            model.learn(remaining, callback=watch, reset_num_timesteps=False, progress_bar=progress)
    finally:
        training.checkpoint(model.num_timesteps, lambda path: save(model, path))
    return training.finish(actor, model.num_timesteps)


def save(model: BaseAlgorithm, path: Path) -> None:
    """Write a checkpoint; the replay buffer, which is large, is kept for the newest alone."""
    if isinstance(model, OffPolicyAlgorithm):
        write_whole(path.with_name(REPLAY), model.save_replay_buffer)
    model.save(path)


class EvalCheckpointCallback(BaseCallback):
    """Checkpoints and evaluations, when they are due."""

    def __init__(self, training: Training, actor: Actor) -> None:
        super().__init__()
        self._watched, self._actor = training, actor

    def _on_rollout_start(self) -> None:
        if self._watched.due(self.num_timesteps):
            self._watched.checkpoint(self.num_timesteps, self._save)
            self._watched.evaluate(self._actor, self.num_timesteps)

    def _save(self, path: Path) -> Any:
        save(self.model, path)

    def _on_step(self) -> bool:
        return True
