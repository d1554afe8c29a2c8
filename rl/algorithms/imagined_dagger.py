"""DAgger (Ross, Gordon and Bagnell, AISTATS 2011) in imagination: no episode is simulated, and no policy is asked.

The student moves arms that follow its commands exactly; inverse kinematics labels the states that it visits. A state
costs some 0.1 ms, so that a student of a few minutes has millions. `armctl train pose_dagger` runs this.
"""

import numpy as np
from numpy.typing import NDArray

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, NonNegative, Positive, Share, options
from armctl.rl.algorithms.cloning import fit_and_export, new_actor
from armctl.rl.data.imagined_reaching import ImaginedReaching, Imagining
from armctl.rl.networks.actor import MedianActor
from armctl.rl.networks.view import Features
from armctl.rl.run.learner import learner
from armctl.rl.run.options import TrainingOptions
from armctl.rl.run.training import Training
from armctl.tasks import OBSERVATION, ReachTask
from armctl.tasks.reach.pose import POSE_OBSERVATION


@options
class ImaginedDaggerOptions(TrainingOptions):
    """Options of DAgger in imagination."""

    family = "DAgger"
    steps: Count = 11_000
    """Number of gradient steps, after each of which the imagined arms move on by one control step."""
    worlds: Count = 100
    """Number of worlds, from whose resets targets are taken; nothing but the evaluations is simulated."""
    hidden_units: Count = 256
    layers: Count = 3
    features: Features = "invariant"
    gains: bool = True
    """The network gives gains on errors that vanish at the target, instead of actions."""
    evaluation_every: Count = 3_000
    batch_size: Count = 512
    targets: Count = 20_000
    """Number of targets."""
    arms: Count = 128
    """Number of arms that are imagined at once."""
    memory: Count = 100_000
    """Number of the latest states to learn from."""
    max_steps: Count = 60
    """Control steps of an imagined episode."""
    margin: NonNegative = 0.01
    """Distance kept by the straight motions of labels, m."""
    noise: Positive = 0.15
    """Standard deviation of the disturbance of commands, rad."""
    noise_share: Share = 0.2
    """Share of control steps in which the command is disturbed."""


@learner(ImaginedDaggerOptions, rewards=False, curriculum=False, explores=False)
def train(training: Training, options: ImaginedDaggerOptions) -> AgentCard:
    """Let inverse kinematics label what the student visits in imagination, and fit the student to it.

    A training that is resumed visits other states than one that was never interrupted.
    """
    recipe, task = training.recipe, training.held_out.task
    if recipe.teacher is not None:
        raise ConfigurationError(f"{recipe.learner} learns from inverse kinematics: it takes no teacher")
    if not isinstance(task, ReachTask) or list(task.options.parts) not in (list(OBSERVATION), list(POSE_OBSERVATION)):
        raise ConfigurationError(f"{recipe.learner} is for the observation 'paper' of ArmReach-v0 and ArmPose-v0")
    if task.options.control != "position" or training.held_out.normalized:
        raise ConfigurationError(f"{recipe.learner} needs control 'position', and actions in rad")
    how = Imagining(
        arms=options.arms, memory=options.memory, max_steps=options.max_steps, margin=options.margin,
        noise=options.noise, noise_share=options.noise_share,
    )  # fmt: skip
    actor = new_actor(training, options, gains=options.gains, kind=MedianActor)
    with training:
        examples = ImaginedReaching(task, _first_observations(training, options.targets), how)
        rng = np.random.default_rng((training.seed, 1))

        def renew(step: int) -> None:
            training.meter.add(teacher_queries=examples.advance(actor, rng))

        return fit_and_export(training, actor, examples, options.batch_size, renew)


def _first_observations(training: Training, count: int) -> NDArray[np.float32]:
    """Return the observations (count, k) with which so many training episodes begin."""
    firsts = range(0, count, training.envs.num_envs)
    return np.concatenate([training.envs.reset(seed=training.first_seed(first))[0] for first in firsts])[:count]
