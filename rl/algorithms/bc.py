"""Behaviour cloning (Pomerleau 1991): supervised learning of a teacher's actions.

`armctl train reach_bc` runs this. The demonstrations are episodes that the teacher plays, or a Minari dataset.
"""

from pathlib import Path

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.core.options import options
from armctl.rl.algorithms.cloning import check_teaching, fit_and_export, new_actor
from armctl.rl.data.demonstrations import CloningOptions, demonstrations, examples_for
from armctl.rl.run.training import Training, check_no_curriculum
from armctl.training.learners import Callback, Recipe


@options
class BcOptions(CloningOptions):
    """Options of behaviour cloning."""

    dataset: str | None = None
    """Minari dataset to learn from, instead of the teacher: a folder (see `armctl collect`), or an id."""


def train(
    recipe: Recipe, *, out: Path, seed: int, resume: bool = False, progress: bool = True, on_evaluation: Callback = None
) -> AgentCard:
    """Train an agent into the folder `out`. See `armctl.rl.run.training.Training`, also for the errors raised."""
    options = recipe.read_options(BcOptions)
    check_teaching(recipe)
    check_no_curriculum(recipe)
    if recipe.training_options and options.dataset is not None:
        raise ConfigurationError("a dataset shows what it shows: training_options are for a teacher's episodes")
    training = Training(recipe, options, out, seed, resume, on_evaluation)
    examples = examples_for(training, options)
    examples.add(demonstrations(training, options, options.dataset, progress))
    with training:
        return fit_and_export(training, new_actor(training, options), examples, options.batch_size, progress)
