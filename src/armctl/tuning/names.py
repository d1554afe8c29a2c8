"""Names of what can be tuned, known without loading any of it."""

from pathlib import Path

from armctl.core.errors import unknown_name
from armctl.policies.configuration import SUFFIX, configurations
from armctl.training.learners import load_recipe, recipe_names


def tunable() -> list[str]:
    """Names of installed recipes and policies that have a search space."""
    return sorted([*(name for name in recipe_names() if load_recipe(name).tune), *configurations()])


def check_tunable(name: str) -> None:
    """Raise `ConfigurationError` for a name that is neither a recipe's nor that of an expert with options."""
    if name not in recipe_names() and name not in configurations() and Path(name).suffix != SUFFIX:
        raise unknown_name("recipe or expert with a search space", name, [*tunable(), "path/to/recipe.toml"])
