"""Costs of a training: decisions in simulation, a teacher's labels, gradient steps, wall and processor time."""

import time
from pathlib import Path
from typing import Any

import gymnasium
import torch
from numpy.typing import ArrayLike

from armctl.core.errors import ConfigurationError, reason
from armctl.core.files import bounded_text, unsealed
from armctl.training.run import processor_seconds

CLOCK_FORMAT = 1
"""Format of the file that a training resumes its counts from."""
COUNTS = ("decisions", "teacher_queries", "gradient_steps")
TIMES = ("seconds", "processor_seconds")


class Meter:
    """Counts what a training spends, on top of what is in the `file` of a training that is `resumed`.

    Raises `ConfigurationError` if that is missing or damaged, or has another format.
    """

    def __init__(self, file: Path, resumed: bool) -> None:
        previous = _read(file) if resumed or file.exists() else dict.fromkeys((*COUNTS, *TIMES), 0)
        self._counts: dict[str, int] = {name: previous[name] for name in COUNTS}
        self._seconds = previous["seconds"] - time.perf_counter()
        self._processor_seconds = previous["processor_seconds"] - processor_seconds()

    def add(self, **counts: int) -> None:
        """Add to some of `COUNTS`."""
        for name, count in counts.items():
            self._counts[name] += count

    @property
    def seconds(self) -> float:
        """Wall time so far, including that before each resumption."""
        return float(self._seconds + time.perf_counter())

    def read(self) -> dict[str, Any]:
        """Return everything so far: `COUNTS`, `seconds`, and `processor_seconds` of all threads and child processes."""
        processor = round(self._processor_seconds + processor_seconds(), 2)
        return {"seconds": self.seconds, "processor_seconds": processor, **self._counts}

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
    """Worlds with autoreset, whose decisions a meter counts: one for each world and control step."""

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any], meter: Meter) -> None:
        super().__init__(env)
        self._meter = meter

    def step(self, actions: ArrayLike) -> Any:
        """Make one control step in every world."""
        self._meter.add(decisions=self.num_envs)
        return self.env.step(actions)
