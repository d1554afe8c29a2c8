"""Behaviour cloning of a follower of plans, made without simulation: layouts, ways and states are all kinematic.

`armctl train obstacles_plan_bc` runs this. States come from followers of the plans whose commands are disturbed (Laskey
et al., DART: Noise injection for robust imitation learning, CoRL 2017).
"""

import numpy as np

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, NonNegative, Positive, Share, options
from armctl.kinematics import ArmModel, ArmShapes
from armctl.rl.algorithms.cloning import fit_and_export, new_actor
from armctl.rl.data import solved_layouts
from armctl.rl.data.followed_plans import EncodedPlans, FollowedPlans, Following
from armctl.rl.data.solved_scenes import SceneSolver
from armctl.rl.networks.actor import Actor, EncodedActor
from armctl.rl.networks.view import Features
from armctl.rl.run.learner import learner
from armctl.rl.run.options import TrainingOptions
from armctl.rl.run.training import Training
from armctl.tasks import ReachObstaclesTask, ReachScenesTask

LAYOUTS = "layouts"
"""Folder of a training's layouts, in its own."""


@options
class PlanBcOptions(TrainingOptions):
    """Options of behaviour cloning from plans."""

    family = "BC"
    steps: Count = 6_000
    """Number of gradient steps."""
    worlds: Count = 1
    """Number of worlds, in which nothing but the evaluations is simulated."""
    hidden_units: Count = 384
    layers: Count = 3
    features: Features = "model"
    evaluation_every: Count = 1_500
    batch_size: Count = 1024
    layouts: Count = 60_000
    """Number of layouts in which a way is planned."""
    parts: Count = 6
    """Number of parts of the layouts, of which one at a time is followed again, with other noise."""
    renewals: Count = 6
    """Number of parts that are followed again, after all have been followed once."""
    margin: Positive = 0.02
    """Distance kept by the straight motions of labels, m."""
    largest_move: Positive = 0.3
    """Largest move of a joint in a label, rad: with larger ones, arms go too fast to turn at a corner."""
    noise: Positive = 0.15
    """Largest standard deviation of the disturbance of commands, rad."""
    noise_power: NonNegative = 0.0
    """Power of a uniform random number by which a follower's noise is less; 0: all have the same."""
    noise_share: Share = 0.5
    """Share of control steps in which the command is disturbed."""
    late_share: Share = 0.0
    """Share of followers that begin at some waypoint of their way."""
    max_steps: Count = 75
    """Control steps after which a follower stops."""
    straight: bool = False
    """Moves of labels are such that joints move in proportion, as the motions that were checked do."""


@learner(PlanBcOptions, rewards=False, curriculum=False, explores=False)
def train(training: Training, options: PlanBcOptions) -> AgentCard:
    """Plan in layouts, and fit an actor to followers of the plans."""
    recipe = training.recipe
    if recipe.teacher is not None:
        raise ConfigurationError(f"{recipe.learner} learns from plans of its own: it takes no teacher")
    task = training.held_out.task
    if not isinstance(task, ReachObstaclesTask) or list(task.options.parts) != list(task.options.observations["paper"]):
        raise ConfigurationError(
            f"{recipe.learner} is for armctl/ArmReachObstacles-v0 and armctl/ArmScenes-v0, with observation 'paper'"
        )
    if task.options.control != "position" or not options.relative:
        raise ConfigurationError(f"{recipe.learner} needs control 'position' and relative actions")
    with training:
        tolerance, folder, seed = task.options.tolerance, training.out / LAYOUTS, training.seed
        solved_layouts.make(folder, options.layouts, _solver(task, seed), training.shows_bars)
        how = Following(
            tolerance=tolerance, largest_move=options.largest_move, margin=options.margin, noise=options.noise,
            noise_share=options.noise_share, noise_power=options.noise_power, late_share=options.late_share,
            max_steps=options.max_steps, straight=options.straight,
        )  # fmt: skip
        shapes, layouts = ArmShapes(ArmModel(task.robot)), solved_layouts.read(folder)
        if training.view.has_fixed_features(training.held_out.single_observation_space):
            actor: Actor = new_actor(training, options, kind=EncodedActor)
            examples: FollowedPlans = EncodedPlans(shapes, layouts, options.parts, how, actor)
        else:
            actor = new_actor(training, options)
            examples = FollowedPlans(shapes, layouts, options.parts, how)
        rounds, every = 0, max(1, options.steps // (options.renewals + 1))

        def renew(step: int) -> None:
            nonlocal rounds
            is_repeated = step > 0 and rounds == 0  # labelled before an interrupt
            while rounds < options.parts + min(step, options.steps - 1) // every:
                labelled = examples.renew(rounds, np.random.default_rng((seed, 1, rounds)))
                training.meter.add(teacher_queries=0 if is_repeated else labelled)
                rounds += 1

        return fit_and_export(training, actor, examples, options.batch_size, renew)


def _solver(task: ReachObstaclesTask, seed: int) -> solved_layouts.LayoutSolver:
    """Return what draws the layouts of a training seed."""
    if isinstance(task, ReachScenesTask):
        return SceneSolver(task.robot, task.options, seed)
    return solved_layouts.ObstacleLayoutSolver(task.robot, task.options.tolerance, seed)
