"""Proximal policy optimisation (Schulman et al. 2017), by Stable-Baselines3, on hundreds of batched worlds.

`armctl train reach_ppo` runs this. The trained agent is an ONNX graph and a JSON card.
"""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import gymnasium
import torch
from pydantic import Field
from stable_baselines3 import PPO

from armctl.agents import AgentCard
from armctl.core.options import options
from armctl.rl.actor import Actor
from armctl.rl.asymmetric import AsymmetricPolicy, AsymmetricVectorEnv
from armctl.rl.encoding import actor_in, features_of
from armctl.rl.frames import FrameOptions, shown_worlds
from armctl.rl.learning import decaying, learn
from armctl.rl.training import Count, Positive, Share, Training
from armctl.rl.vector import StableBaselinesVectorEnv
from armctl.rl.view import View
from armctl.training.learners import Callback, Recipe

Model = TypeVar("Model", bound=PPO)
ACTIVATIONS = {"elu": torch.nn.ELU, "relu": torch.nn.ReLU}


@options
class PpoOptions(FrameOptions):
    """Options of PPO. The learning rate decays linearly to a twentieth."""

    rollout_length: Count = 32
    """Control steps of each world between two updates."""
    batch_size: Count = 2048
    epochs: Count = 5
    gae_lambda: Share = 0.95
    clip_range: Positive = 0.2
    entropy: Annotated[float, Field(ge=0)] = 0.0
    """Weight of the action distribution's entropy in the loss."""
    initial_log_std: float = -0.5
    reward_scale: Positive = 0.02
    activation: Literal["elu", "relu"] = "elu"
    """After each layer of the network."""
    privileged_critic: bool = False
    """Whether the critic sees the state, which the actor does not. The agent is the actor."""


def train(
    recipe: Recipe, *, out: Path, seed: int, resume: bool = False, progress: bool = True, on_evaluation: Callback = None
) -> AgentCard:
    """Train an agent into the folder `out`. See `armctl.rl.training.Training`, also for the errors raised."""
    options = recipe.read_options(PpoOptions)
    training = Training(recipe, options, out, seed, resume, on_evaluation)
    show = functools.partial(shown, training, options)
    model = load_or_make(training, options, PPO, show)
    with training:
        return learn(training, model, actor_of(model, training), progress, show)


def load_or_make(
    training: Training, options: PpoOptions, kind: type[PPO], show: Callable[[], StableBaselinesVectorEnv]
) -> Any:
    """The model of the newest checkpoint, or an untrained one, of a `kind` of PPO, which is shown worlds by `show`."""
    venv = show()
    newest = training.newest_checkpoint()
    new = newest is None
    model = new_model(venv, training.view, options, training.seed, kind) if new else kind.load(newest, venv, "cpu")
    training.meter.watch(model)
    return model


def shown(training: Training, options: PpoOptions) -> StableBaselinesVectorEnv:
    """The training's present worlds, as a model with these options is shown them."""
    kind = AsymmetricVectorEnv if options.privileged_critic else None
    return shown_worlds(training.worlds, training.view, options, kind)


def new_model(venv: StableBaselinesVectorEnv, view: View, options: PpoOptions, seed: int, kind: type[PPO] = PPO) -> PPO:
    """An untrained model of a `kind` of PPO."""
    several = isinstance(venv.observation_space, gymnasium.spaces.Dict)
    policy: Any = "MultiInputPolicy" if several else "MlpPolicy"
    features = features_of(venv, view)
    if isinstance(venv, AsymmetricVectorEnv):
        policy, features = AsymmetricPolicy, {"view": view, **features}
    return kind(
        policy,
        venv,
        n_steps=options.rollout_length,
        batch_size=options.batch_size,
        n_epochs=options.epochs,
        learning_rate=decaying(options.learning_rate),
        gamma=options.gamma,
        gae_lambda=options.gae_lambda,
        clip_range=options.clip_range,
        ent_coef=options.entropy,
        policy_kwargs={
            **features,
            "net_arch": [options.hidden_units] * options.layers,
            "activation_fn": ACTIVATIONS[options.activation],
            "log_std_init": options.initial_log_std,
        },
        seed=seed,
        device="cpu",
    )


def actor_of(model: PPO, training: Training) -> Actor:
    """An actor that shares the model's network."""
    return actor_in(model.env, MeanAction(model.policy), training)


class MeanAction(torch.nn.Module):
    """The mean of a policy's action distribution."""

    def __init__(self, policy: torch.nn.Module) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, observation: Any) -> torch.Tensor:
        """Actions (n, ...), mostly in [-1, 1]."""
        features = self.policy.extract_features(observation, self.policy.pi_features_extractor)
        return self.policy.action_net(self.policy.mlp_extractor.forward_actor(features))
