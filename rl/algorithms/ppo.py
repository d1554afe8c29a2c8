"""Proximal policy optimisation (Schulman et al. 2017), by Stable-Baselines3, on hundreds of batched worlds.

`armctl train reach_ppo` runs this. The trained agent is an ONNX graph and a JSON card.
"""

import functools
from collections.abc import Callable
from typing import Any, Literal, TypeVar

import torch
from stable_baselines3 import PPO

from armctl.agents import AgentCard
from armctl.core.options import Count, NonNegative, Positive, Share, options
from armctl.rl.algorithms.asymmetric import AsymmetricVectorEnv
from armctl.rl.algorithms.sb3_training import decaying, learn
from armctl.rl.networks.actor import Actor
from armctl.rl.run.learner import learner
from armctl.rl.run.options import FrameOptions
from armctl.rl.run.training import Training
from armctl.rl.run.vector import EncodedVectorEnv, StableBaselinesVectorEnv, vec_env_of

Model = TypeVar("Model", bound=PPO)
ACTIVATIONS = {"elu": torch.nn.ELU, "relu": torch.nn.ReLU}


@options
class PpoOptions(FrameOptions):
    """Options of PPO. The learning rate decays linearly to a twentieth."""

    family = "PPO"
    rollout_length: Count = 32
    """Control steps of each world between two updates."""
    batch_size: Count = 2048
    epochs: Count = 5
    gae_lambda: Share = 0.95
    clip_range: Positive = 0.2
    entropy: NonNegative = 0.0
    """Weight of the action distribution's entropy in the loss."""
    initial_log_std: float = -0.5
    reward_scale: Positive = 0.02
    activation: Literal["elu", "relu"] = "elu"
    """Activation after each layer of the network."""
    privileged_critic: bool = False
    """Privilege of the critic: it sees the state, which the actor does not. The agent is the actor."""


@learner(PpoOptions)
def train(training: Training, options: PpoOptions) -> AgentCard:
    """Improve a new actor by the rewards of its own episodes."""
    make_vec_env = functools.partial(vec_env_for, training, options)
    model = load_or_make(training, options, PPO, make_vec_env)
    with training:
        return learn(training, model, actor_of(model, training), make_vec_env)


def load_or_make(
    training: Training,
    options: PpoOptions,
    kind: type[PPO],
    make_vec_env: Callable[[], StableBaselinesVectorEnv],
) -> Any:
    """Load the model of the newest checkpoint, or make an untrained one, of a `kind` of PPO."""
    vec_env, newest = make_vec_env(), training.newest_checkpoint()
    model = new_model(vec_env, options, training.seed, kind) if newest is None else kind.load(newest, vec_env, "cpu")
    training.meter.watch(model.policy.optimizer)
    return model


def vec_env_for(training: Training, options: PpoOptions) -> StableBaselinesVectorEnv:
    """Return the training's present worlds, as a model with these options sees them."""
    kind = AsymmetricVectorEnv if options.privileged_critic else EncodedVectorEnv
    return vec_env_of(training.envs, training.view, options, kind)


def new_model(vec_env: StableBaselinesVectorEnv, options: PpoOptions, seed: int, kind: type[PPO] = PPO) -> PPO:
    """Make an untrained model of a `kind` of PPO."""
    return kind(
        vec_env.policy_class,
        vec_env,
        n_steps=options.rollout_length,
        batch_size=options.batch_size,
        n_epochs=options.epochs,
        learning_rate=decaying(options.learning_rate),
        gamma=options.gamma,
        gae_lambda=options.gae_lambda,
        clip_range=options.clip_range,
        ent_coef=options.entropy,
        policy_kwargs={
            **vec_env.policy_kwargs,
            "net_arch": [options.hidden_units] * options.layers,
            "activation_fn": ACTIVATIONS[options.activation],
            "log_std_init": options.initial_log_std,
        },
        seed=seed,
        device="cpu",
    )


def actor_of(model: PPO, training: Training) -> Actor:
    """Return an actor that shares the model's network."""
    return model.env.actor(MeanAction(model.policy), training)


class MeanAction(torch.nn.Module):
    """The mean of a policy's action distribution."""

    def __init__(self, policy: torch.nn.Module) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, observation: Any) -> torch.Tensor:
        """Return actions (n, ...), mostly in [-1, 1]."""
        features = self.policy.extract_features(observation, self.policy.pi_features_extractor)
        return self.policy.action_net(self.policy.mlp_extractor.forward_actor(features))
