"""Behaviour cloning (Pomerleau 1991): supervised learning of a teacher's actions.

`armctl train reach_bc` runs this. The demonstrations are episodes that the teacher plays, or a Minari dataset.
"""

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.core.options import options
from armctl.rl.algorithms.cloning import fit_and_export, new_actor
from armctl.rl.data.demonstrations import CloningOptions, demonstrations, examples_for
from armctl.rl.run.learner import learner
from armctl.rl.run.training import Training
from armctl.training.learners import Recipe


@options
class BcOptions(CloningOptions):
    """Options of behaviour cloning."""

    dataset: str | None = None
    """Minari dataset to learn from, instead of the teacher: a folder (see `armctl collect`), or an id."""


def check_dataset(recipe: Recipe, options: BcOptions) -> None:
    """Raise `ConfigurationError` for options of a teacher's episodes where there is a dataset."""
    if recipe.training_options and options.dataset is not None:
        raise ConfigurationError("a dataset shows what it shows: training_options are for a teacher's episodes")


@learner(BcOptions, rewards=False, curriculum=False, explores=False, check=check_dataset)
def train(training: Training, options: BcOptions) -> AgentCard:
    """Fit an actor to the demonstrations."""
    examples = examples_for(training, options)
    examples.add(demonstrations(training, options, options.dataset))
    with training:
        return fit_and_export(training, new_actor(training, options), examples, options.batch_size)
