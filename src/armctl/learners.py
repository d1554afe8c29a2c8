"""How learners are found: functions that train an agent, under the entry-point group `armctl.learners`."""

from collections.abc import Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

from armctl.agents import AgentCard
from armctl.errors import ConfigurationError, unknown_name

GROUP = "armctl.learners"


class Learner(Protocol):
    """Trains an agent into the folder `out`, or goes on with one that is there."""

    def __call__(  # noqa: D102
        self, env: str, *, out: Path, steps: int | None, seed: int, resume: bool, env_options: Mapping[str, Any]
    ) -> AgentCard: ...


def learner_names() -> list[str]:
    """Names of all installed learners."""
    return sorted(entry_points(group=GROUP).names)


def load_learner(name: str) -> Learner:
    """The installed learner of that name; raises `ConfigurationError` without it, or without the extra `rl`."""
    entries = entry_points(group=GROUP)
    if name not in entries.names:
        raise unknown_name("learner", name, entries.names)
    try:
        return entries[name].load()  # type: ignore[no-any-return]
    except ModuleNotFoundError as error:
        how = "pip install 'armctl[rl]', or pip install -e '.[rl]' in a clone"
        raise ConfigurationError(f"training needs {error.name}: {how}") from error
