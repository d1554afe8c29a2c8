"""Soft actor-critic (Haarnoja et al. 2018), by Stable-Baselines3, with hindsight where a task has goals.

`armctl train reach_sac` comes here.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import numpy as np
import torch
from pydantic import Field
from stable_baselines3 import SAC
from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise, VectorizedActionNoise

from armctl.agents import AgentCard
from armctl.errors import ConfigurationError
from armctl.learners import Recipe
from armctl.rl.actor import Actor
from armctl.rl.hindsight import GoalFeatures, GoalVectorEnv, HindsightBuffer, split
from armctl.rl.learning import REPLAY, learn
from armctl.rl.training import Count, Positive, Share, Training, TrainingOptions, read_options
from armctl.rl.vector import StableBaselinesVectorEnv
from armctl.tasks import ReachTask

NOISE_LASTS = 10
"""Decisions, after which noise of the past counts for a third."""


@dataclass(frozen=True)
class SacOptions(TrainingOptions):
    """Options of the learner."""

    steps: Count = 200_000
    worlds: Count = 64
    gradient_steps: Count = 8
    """After each step of all worlds."""
    batch_size: Count = 256
    learning_rate: Positive = 1e-3
    tau: Share = 0.01
    """Share of the critic that goes into its target network at each gradient step."""
    buffer_size: Count = 300_000
    """Transitions."""
    random_steps: Count = 3_000
    """Decisions that are uniformly random, at first."""
    noise: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.4
    """Of exploration that lasts, in one decision: none in the first world, and so much in the last."""
    relabelled: Annotated[int, Field(ge=0)] = 4
    """Relabelled transitions for each real one, in `armctl/ArmReach-v0`."""
    entropy: Positive = 0.1
    """Initial weight of the action distribution's entropy, which is tuned on the way."""
    reward_scale: Positive = 0.1
    evaluation_every: Count = 20_000


def train(recipe: Recipe, *, out: Path, seed: int, resume: bool = False, progress: bool = True) -> AgentCard:
    """Train an agent into the folder `out`; see `armctl.rl.training.Training`, also for the errors raised."""
    options = read_options(SacOptions, recipe)
    if options.relabelled and (recipe.shaping or recipe.reward_weights or "reward" in recipe.env_options):
        raise ConfigurationError(
            "what is relabelled earns the task's plain reward: with shaping, reward_weights or another reward, "
            "set the option relabelled to 0"
        )
    with Training(recipe, options, out, seed, resume) as training:
        venv = _vector_env(training, options)
        newest = training.newest_checkpoint()
        model = _new_model(venv, training, options) if newest is None else _load(newest, venv)
        dof = venv.dof if isinstance(venv, GoalVectorEnv) else None
        observed = training.held_out.single_observation_space
        actor = Actor(SquashedMean(model.policy, dof), training.view.action_scale, observed)
        return learn(training, model, actor, progress)


class SquashedMean(torch.nn.Module):
    """The mean of a policy's action distribution, squashed into [-1, 1]; with `dof`, of a policy that has goals."""

    def __init__(self, policy: torch.nn.Module, dof: int | None) -> None:
        super().__init__()
        self.actor, self.dof = policy.actor, dof

    def forward(self, observation: Any) -> torch.Tensor:
        """Actions (n, ...) for plain observations."""
        shown = observation if self.dof is None else split(observation, self.dof)
        return torch.tanh(self.actor.get_action_dist_params(shown)[0])


def _vector_env(training: Training, options: SacOptions) -> StableBaselinesVectorEnv:
    recipe, task = training.recipe, training.held_out.task
    given = (training.worlds, training.view.action_scale, options.reward_scale, recipe.reward_weights)
    if not (options.relabelled and type(task) is ReachTask):
        return StableBaselinesVectorEnv(*given)
    return GoalVectorEnv(task.options.tolerance, *given)


def _new_model(venv: StableBaselinesVectorEnv, training: Training, options: SacOptions) -> SAC:
    goals, view = isinstance(venv, GoalVectorEnv), training.view
    several = isinstance(venv.observation_space, gymnasium.spaces.Dict)
    # Hindsight needs episodes that have ended.
    longest = (training.held_out.max_episode_steps or 0) * options.worlds if goals else 0
    return SAC(
        "MultiInputPolicy" if several else "MlpPolicy",
        venv,
        learning_rate=options.learning_rate,
        buffer_size=options.buffer_size,
        learning_starts=max(options.random_steps, longest),
        batch_size=options.batch_size,
        tau=options.tau,
        gamma=options.gamma,
        train_freq=1,
        gradient_steps=options.gradient_steps,
        action_noise=_noise(options, venv.action_space.shape),
        ent_coef=f"auto_{options.entropy}",
        replay_buffer_class=HindsightBuffer if goals else None,
        replay_buffer_kwargs={"n_sampled_goal": options.relabelled} if goals else None,
        policy_kwargs={
            "features_extractor_class": GoalFeatures if goals else view.features,
            "features_extractor_kwargs": {"view": view} if goals else view.features_options,
            "net_arch": [options.hidden_units] * options.layers,
        },
        seed=training.seed,
        device="cpu",
    )


def _noise(options: SacOptions, shape: tuple[int, ...]) -> VectorizedActionNoise:
    """Noise of Ornstein and Uhlenbeck (1930), which takes an arm elsewhere; independent noise leaves it where it is."""
    still = np.zeros(shape)
    noises = [
        OrnsteinUhlenbeckActionNoise(still, np.full(shape, sigma), theta=1 / NOISE_LASTS, dt=1.0)
        for sigma in np.linspace(0.0, options.noise, options.worlds)
    ]
    noise = VectorizedActionNoise(noises[0], options.worlds)
    noise.noises = noises
    return noise


def _load(checkpoint: Path, venv: StableBaselinesVectorEnv) -> SAC:
    model = SAC.load(checkpoint, venv, "cpu")
    replay = checkpoint.with_name(REPLAY)
    if not replay.exists():
        raise ConfigurationError(f"the training cannot go on without {replay}")
    with warnings.catch_warnings(action="ignore"):  # episodes that were under way are cut short
        model.load_replay_buffer(replay)
    return model
