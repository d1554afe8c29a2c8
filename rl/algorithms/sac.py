"""Soft actor-critic (Haarnoja et al. 2018), by Stable-Baselines3; with hindsight in tasks that declare goals.

`armctl train reach_sac` runs this. Where random actions would never succeed, a recipe's teacher acts at first, and the
actor may imitate it: `armctl train push_sac`.
"""

import warnings
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field
from stable_baselines3 import SAC
from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise, VectorizedActionNoise

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, NonNegative, Positive, Share, options
from armctl.rl.algorithms.hindsight import GoalVectorEnv, HindsightBuffer, has_goals
from armctl.rl.algorithms.sb3_training import REPLAY, decaying, learn
from armctl.rl.data.demonstrations import teacher_in
from armctl.rl.run.learner import learner
from armctl.rl.run.options import FrameOptions
from armctl.rl.run.training import Training
from armctl.rl.run.vector import EncodedVectorEnv, StableBaselinesVectorEnv, vec_env_of
from armctl.training.learners import Recipe

NOISE_TIME_CONSTANT = 10
"""Control steps in which the exploration noise decays to about a third."""


@options
class SacOptions(FrameOptions):
    """Options of SAC. The learning rate decays linearly to a twentieth."""

    family = "SAC"
    steps: Count = 200_000
    worlds: Count = 64
    gradient_steps: Count = 8
    """Gradient steps per control step of all worlds."""
    batch_size: Count = 256
    learning_rate: Positive = 1e-3
    tau: Share = 0.01
    """Soft-update coefficient of the critic's target network, per gradient step."""
    buffer_size: Count = 300_000
    """Size of the replay buffer, transitions."""
    random_steps: Count = 3_000
    """Environment steps with uniformly random actions, at first, before learning begins; or with those of the recipe's
    teacher, during which it begins."""
    imitation: NonNegative = 0.0
    """Weight in the actor's loss of minus the log-likelihood of what the teacher did in these steps (see Nair et al.,
    Overcoming exploration in reinforcement learning with demonstrations, 2018, for the effect)."""
    noise: NonNegative = 0.4
    """Scale of the correlated exploration noise in the last world; it grows from 0 in the first world."""
    relabelled: Annotated[int, Field(ge=0)] = 4
    """Relabelled transitions for each real one, in `armctl/ArmReach-v0` and `armctl/ArmPush-v0`."""
    entropy: Positive = 0.1
    """Initial weight of the action distribution's entropy. It is tuned during training."""
    target_entropy: float = -1.0
    """Entropy to which the weight is tuned, per number of an action: ln 2 is that of uniformly random actions."""
    reward_scale: Positive = 0.1
    evaluation_every: Count = 20_000


def _check(recipe: Recipe, options: SacOptions) -> None:
    if options.relabelled and (recipe.shaping or recipe.reward_weights or "reward" in recipe.options_in_training):
        raise ConfigurationError(
            "relabelled transitions earn the task's plain reward: with shaping, reward_weights or another reward, "
            "set the option relabelled to 0"
        )
    if options.imitation and (recipe.teacher is None or options.buffer_size < options.steps):
        raise ConfigurationError(
            "imitation is of a teacher, whose steps the replay buffer has to keep: name it, --teacher POLICY, and set "
            "buffer_size to steps at least"
        )


@learner(SacOptions, curriculum=False, check=_check)
def train(training: Training, options: SacOptions) -> AgentCard:
    """Improve a new actor by the rewards of all transitions so far, real ones and relabelled ones."""
    vec_env = _make_vec_env(training, options)
    newest = training.newest_checkpoint()
    model = _new_model(vec_env, training, options) if newest is None else _load(newest, vec_env, training)
    if isinstance(model, TaughtSac):
        model.follow(training, options)
    training.meter.watch(model.policy.critic.optimizer)
    with training:
        network = SquashedMean(model.policy, goals=isinstance(vec_env, GoalVectorEnv))
        return learn(training, model, vec_env.actor(network, training))


class StoredAsExecuted(SAC):
    """SAC that remembers the actions that were executed, also where a safety filter changed them.

    What it learns from is then what happens; PPO needs the proposed ones, whose likelihood it changes.
    """

    def _store_transition(self, replay_buffer: Any, buffer_action: Any, *others: Any) -> None:
        assert isinstance(self.env, StableBaselinesVectorEnv)
        super()._store_transition(replay_buffer, self.env.executed(buffer_action), *others)


class TaughtSac(StoredAsExecuted):
    """SAC in whose first steps a teacher acts, and whose actor may imitate these steps.

    Both explore by correlated noise alone: noise that is new in each step makes a hand tremble that has to be precise.
    `follow` is to be called before it learns.
    """

    def follow(self, training: Training, options: SacOptions) -> None:
        """Let a recipe's teacher act in the first steps, and add the imitation to the actor's loss."""
        self._teacher = teacher_in(training.envs.unwrapped, training.recipe, training.seed)
        self._meter, self._taught_steps = training.meter, options.random_steps
        if options.imitation:
            self.actor.optimizer.register_step_pre_hook(lambda *_: self._imitate(options.imitation))

    def likelihood(self) -> torch.Tensor:
        """Return the mean log-likelihood of the actions in a batch of the teacher's steps."""
        buffer: Any = self.replay_buffer
        rows = min(self.num_timesteps, self._taught_steps) // self.n_envs
        samples = buffer._get_samples(self.action_space.np_random.integers(rows, size=self.batch_size))
        means, log_stds, _ = self.actor.get_action_dist_params(samples.observations)
        return self.actor.action_dist.proba_distribution(means, log_stds).log_prob(samples.actions).mean()

    def _imitate(self, weight: float) -> None:
        (-weight * self.likelihood()).backward()

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_teacher", "_meter", "_taught_steps"]

    def _setup_learn(self, *args: Any, **kwargs: Any) -> Any:
        ready = super()._setup_learn(*args, **kwargs)
        self._teacher.reset(np.arange(self.n_envs, dtype=np.int32))
        return ready

    def _sample_action(self, learning_starts: int, action_noise: Any = None, n_envs: int = 1) -> Any:
        if self.num_timesteps < self._taught_steps:
            assert isinstance(self.env, StableBaselinesVectorEnv)
            self._meter.add(teacher_queries=n_envs)
            actions = self.env.actions_of(self._teacher)
        else:
            actions, _ = self.predict(self._last_obs, deterministic=True)
        actions = np.clip(actions + action_noise(), -1, 1)
        return actions, actions

    def _store_transition(self, replay_buffer: Any, buffer_action: Any, *others: Any) -> None:
        super()._store_transition(replay_buffer, buffer_action, *others)
        _, _, dones, _ = others
        self._teacher.reset(np.flatnonzero(dones).astype(np.int32))


class SquashedMean(torch.nn.Module):
    """The mean of a policy's action distribution, squashed into [-1, 1].

    A policy with `goals` sees observations by name.
    """

    def __init__(self, policy: torch.nn.Module, *, goals: bool) -> None:
        super().__init__()
        self.actor, self.goals = policy.actor, goals

    def forward(self, observation: Any) -> torch.Tensor:
        """Return actions (n, ...) for observations of the task, or stacks of them."""
        observations = {"observation": observation} if self.goals else observation
        return torch.tanh(self.actor.get_action_dist_params(observations)[0])


def _make_vec_env(training: Training, options: SacOptions) -> StableBaselinesVectorEnv:
    task = training.envs.unwrapped.task
    with_goals = options.relabelled and has_goals(task)
    if with_goals and list(task.options.parts) != list(task.options.observations["paper"]):
        raise ConfigurationError(
            "hindsight knows the observation 'paper' only: choose that, or set the option relabelled to 0"
        )
    kind = GoalVectorEnv if with_goals else EncodedVectorEnv
    return vec_env_of(training.envs, training.view, options, kind)


def _new_model(vec_env: StableBaselinesVectorEnv, training: Training, options: SacOptions) -> StoredAsExecuted:
    goals, kind = isinstance(vec_env, GoalVectorEnv), _kind(training)
    # The hindsight buffer samples from finished episodes only.
    longest = (training.held_out.max_episode_steps or 0) * options.worlds if goals else 0
    return kind(
        vec_env.policy_class,
        vec_env,
        learning_rate=decaying(options.learning_rate),
        buffer_size=options.buffer_size,
        learning_starts=longest if kind is TaughtSac else max(options.random_steps, longest),
        batch_size=options.batch_size,
        tau=options.tau,
        gamma=options.gamma,
        train_freq=1,
        gradient_steps=options.gradient_steps,
        action_noise=_noise(options, vec_env.action_space.shape),
        ent_coef=f"auto_{options.entropy}",
        target_entropy=options.target_entropy * vec_env.action_space.shape[0],
        replay_buffer_class=HindsightBuffer if goals else None,
        replay_buffer_kwargs={"n_sampled_goal": options.relabelled} if goals else None,
        policy_kwargs={
            **vec_env.policy_kwargs,
            "net_arch": [options.hidden_units] * options.layers,
        },
        seed=training.seed,
        device="cpu",
    )


def _kind(training: Training) -> type[StoredAsExecuted]:
    return StoredAsExecuted if training.recipe.teacher is None else TaughtSac


def _noise(options: SacOptions, shape: tuple[int, ...]) -> VectorizedActionNoise:
    """Return noise of Ornstein and Uhlenbeck (1930). It moves an arm; noise without correlation averages out."""
    mean = np.zeros(shape)
    noises = [
        OrnsteinUhlenbeckActionNoise(mean, np.full(shape, sigma), theta=1 / NOISE_TIME_CONSTANT, dt=1.0)
        for sigma in np.linspace(0.0, options.noise, options.worlds)
    ]
    noise = VectorizedActionNoise(noises[0], options.worlds)
    noise.noises = noises
    return noise


def _load(checkpoint: Path, vec_env: StableBaselinesVectorEnv, training: Training) -> StoredAsExecuted:
    model = _kind(training).load(checkpoint, vec_env, "cpu")
    replay = checkpoint.with_name(REPLAY)
    if not replay.exists():
        raise ConfigurationError(f"the training cannot be resumed without {replay}")
    with warnings.catch_warnings(action="ignore"):  # it warns that unfinished episodes are truncated
        model.load_replay_buffer(replay)
    return model
