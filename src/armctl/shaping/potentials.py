"""Potentials by name: each task declares its own."""

from collections.abc import Callable

from armctl.core.errors import unknown_name
from armctl.envs import TaskVectorEnv
from armctl.tasks import Potential

PotentialFactory = Callable[[TaskVectorEnv], Potential]


def potential_names(worlds: TaskVectorEnv) -> list[str]:
    """Return names of the potentials of an environment."""
    return list(worlds.task.potentials)


def make_potential(potential: str | PotentialFactory, worlds: TaskVectorEnv) -> Potential:
    """Return a potential by name, or by a function from the environment to it.

    Raises `ConfigurationError` for a name that the environment's task does not declare.
    """
    if callable(potential):
        return potential(worlds)
    if potential not in worlds.task.potentials:
        env = worlds.spec.id if worlds.spec else "this environment"
        raise unknown_name(f"shaping of {env}", potential, potential_names(worlds))
    result: Potential = worlds.task.potentials[potential](worlds.task)
    return result
