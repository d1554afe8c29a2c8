"""An agent without a memory, which PPO improves: all of its weights go on learning, from rewards instead of labels.

A clone of plans does not know what its errors cost. As in `cloned_ppo`, the critic is fitted first, to the agent's own
episodes, and a penalty, which decays, holds the actor to its start.
"""

import functools
from typing import Any

import torch

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, options
from armctl.rl.algorithms.anchored_ppo import AnchoredPpo, AnchoredPpoOptions, improve
from armctl.rl.algorithms.cloning import new_actor
from armctl.rl.algorithms.distilled_ppo import start_of
from armctl.rl.algorithms.ppo import vec_env_for
from armctl.rl.networks.recurrent import copy_weights
from armctl.rl.run.learner import learner
from armctl.rl.run.training import Training


@options
class FinetunedPpoOptions(AnchoredPpoOptions):
    """Options of PPO, whose network has the sizes of the agent from which it starts."""

    hidden_units: Count = 256
    layers: Count = 3
    evaluation_every: Count = 100_000


@learner(FinetunedPpoOptions)
def train(training: Training, options: FinetunedPpoOptions) -> AgentCard:
    """Improve by PPO what an agent does."""
    if options.frames > 1 or training.view.prepare is not None:
        raise ConfigurationError(
            "finetuned_ppo starts from an agent that sees single observations: leave the option frames out"
        )
    network: Any = new_actor(training, options).network
    _, weights = start_of(training, "finetuned_ppo", memory=[])
    copy_weights(network, weights)

    def start(model: AnchoredPpo) -> None:
        features, *layers, last = network
        policy = model.policy
        if not training.view.has_fixed_features(training.envs.single_observation_space):
            policy.features_extractor.load_state_dict(features.state_dict())
        policy.mlp_extractor.policy_net.load_state_dict(torch.nn.Sequential(*layers).state_dict())
        policy.action_net.load_state_dict(last.state_dict())

    return improve(training, options, functools.partial(vec_env_for, training, options), start)
