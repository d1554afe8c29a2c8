"""Costs of a training: decisions in simulation, a teacher's labels, gradient steps, wall and processor time."""

import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError, reason
from armctl.core.files import bounded_text, unsealed
from armctl.envs import TaskVectorEnv
from armctl.policies.filtered import FilteredWorlds
from armctl.training.run import processor_seconds

CLOCK_FORMAT = 1
"""Format of the file that a training resumes its counts from."""
COUNTS = ("decisions", "teacher_queries", "gradient_steps")
SAFETY = ("contacts", "interventions")
"""Control steps with a forbidden contact, and actions that a safety filter changed; None where nothing tells."""
TIMES = ("seconds", "processor_seconds")


class Meter:
    """Counts what a training spends, on top of what is in the `file` of a training that is `resumed`.

    Raises `ConfigurationError` if that is missing or damaged, or has another format.
    """

    def __init__(self, file: Path, resumed: bool) -> None:
        previous = _read(file) if resumed or file.exists() else dict.fromkeys((*COUNTS, *SAFETY, *TIMES), 0)
        self._counts: dict[str, int] = {name: previous[name] for name in COUNTS}
        self._safety: dict[str, int | None] = {name: previous.get(name) for name in SAFETY}
        self._seconds = previous["seconds"] - time.perf_counter()
        self._processor_seconds = previous["processor_seconds"] - processor_seconds()

    def add(self, **counts: int) -> None:
        """Add to some of `COUNTS`."""
        for name, count in counts.items():
            self._counts[name] += count

    def add_safety(self, **counts: int | None) -> None:
        """Add to some of `SAFETY`; what was unknown once stays so."""
        for name, count in counts.items():
            previous = self._safety[name]
            self._safety[name] = None if previous is None or count is None else previous + count

    @property
    def seconds(self) -> float:
        """Wall time so far, including that before each resumption."""
        return float(self._seconds + time.perf_counter())

    def read(self) -> dict[str, Any]:
        """Return all so far: `COUNTS`, `SAFETY`, `seconds`, and `processor_seconds` of all threads and processes."""
        processor = round(self._processor_seconds + processor_seconds(), 2)
        return {"seconds": self.seconds, "processor_seconds": processor, **self._counts, **self._safety}

    def watch(self, optimizer: torch.optim.Optimizer) -> None:
        """Count an optimizer's gradient steps."""
        optimizer.register_step_post_hook(lambda *_: self.add(gradient_steps=1))


def _read(file: Path) -> dict[str, Any]:
    try:
        return unsealed(bounded_text(file), CLOCK_FORMAT)
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            f"{file} cannot be read, or is damaged ({reason(error)}): choose another folder"
        ) from error


class Metered(gymnasium.vector.VectorWrapper[Any, Any, Any, Any, Any]):
    """Worlds with autoreset, whose decisions a meter counts, one for each world and control step, and contacts."""

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any], meter: Meter) -> None:
        super().__init__(env)
        self._meter, worlds = meter, env.unwrapped
        if isinstance(worlds, TaskVectorEnv):
            worlds.observers.append(self)
        else:
            meter.add_safety(contacts=None)

    def step(self, actions: ArrayLike) -> Any:
        """Make one control step in every world."""
        self._meter.add(decisions=self.num_envs)
        result, executed = self.env.step(actions), self.executed
        self._meter.add_safety(interventions=None if executed is None else int(executed[1].sum()))
        return result

    @property
    def executed(self) -> tuple[Array, NDArray[np.bool_]] | None:
        """Last actions (n, ...) after the safety filter, and whether it has changed them (n,); None without one."""
        return (self.env.executed, self.env.changed) if isinstance(self.env, FilteredWorlds) else None

    def began(self, ids: NDArray[np.int32]) -> None:
        """Take note that worlds `ids` have begun a new episode."""

    def stepped(self, awake: NDArray[np.bool_]) -> None:
        """Count contacts of the last control step."""
        worlds: Any = self.env.unwrapped
        contact = worlds.task.motion().contact
        self._meter.add_safety(contacts=None if contact is None else int((contact & awake).sum()))
