"""Behaviour cloning, then PPO, which starts from the clone.

The advantages of an untrained critic would make the actor unlearn what it has cloned (see Zhu et al., 2019, and Uchendu
et al., Jump-start reinforcement learning, 2023, for the effect). So the critic is fitted to the clone's episodes first,
and a penalty, which decays, holds the actor to the clone.
"""

import functools

import numpy as np

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, Positive, options
from armctl.rl.algorithms.anchored_ppo import AnchoredPpo, AnchoredPpoOptions, improve
from armctl.rl.algorithms.bc import BcOptions
from armctl.rl.algorithms.cloning import fit
from armctl.rl.algorithms.ppo import actor_of, vec_env_for
from armctl.rl.data.demonstrations import demonstrations, examples_for
from armctl.rl.run.learner import learner
from armctl.rl.run.training import Training


@options
class ClonedPpoOptions(AnchoredPpoOptions, BcOptions):
    """Options of PPO, whose steps are environment steps, and of the cloning before it."""

    hidden_units: Count = 256
    layers: Count = 3
    evaluation_every: Count = 50_000
    cloning_steps: Count = 6_000
    """Number of gradient steps of cloning."""
    cloning_rate: Positive = 1e-3
    cloning_batch_size: Count = 256


@learner(ClonedPpoOptions)
def train(training: Training, options: ClonedPpoOptions) -> AgentCard:
    """Fit an actor and a critic to the teacher's episodes, and improve them by PPO."""
    if options.frames > 1:
        raise ConfigurationError("cloned_ppo clones from single observations: leave the option frames out")
    examples = examples_for(training, options)
    if training.newest_checkpoint() is None:
        examples.add(demonstrations(training, options, options.dataset))

    def clone(model: AnchoredPpo) -> None:
        for _ in fit(
            training, actor_of(model, training), examples, options.cloning_steps, np.random.default_rng(training.seed),
            batch_size=options.cloning_batch_size, learning_rate=options.cloning_rate,
        ):  # fmt: skip
            pass

    return improve(training, options, functools.partial(vec_env_for, training, options), clone)
