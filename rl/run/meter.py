"""Costs of a training: decisions in simulation, a teacher's labels, gradient steps, wall and processor time."""

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
from numpy.typing import ArrayLike
from stable_baselines3.common.base_class import BaseAlgorithm

from armctl.training.run import processor_seconds

COUNTS = ("decisions", "teacher_queries", "gradient_steps")


class Meter:
    """Counts what a training spends, on top of what is in the `file` of the training to resume.

    What that file lacks stays unknown (None) if the training is `resumed`.
    """

    def __init__(self, file: Path, resumed: bool) -> None:
        previous: Mapping[str, Any] = json.loads(file.read_text()) if file.exists() else {}
        self._counts: dict[str, int | None] = {name: previous.get(name, None if resumed else 0) for name in COUNTS}
        self._seconds = previous.get("seconds", 0.0) - time.perf_counter()
        processor = previous.get("processor_seconds", None if resumed else 0.0)
        self._processor_seconds = None if processor is None else processor - processor_seconds()

    def add(self, **counts: int) -> None:
        """Add to some of `COUNTS`."""
        for name, count in counts.items():
            previous = self._counts[name]
            self._counts[name] = None if previous is None else previous + count

    @property
    def seconds(self) -> float:
        """Wall time so far, including that before each resumption."""
        return float(self._seconds + time.perf_counter())

    def read(self) -> dict[str, Any]:
        """Return everything so far: `COUNTS`, `seconds`, and `processor_seconds` of all threads and child processes."""
        processor = self._processor_seconds
        seconds = None if processor is None else round(processor + processor_seconds(), 2)
        return {"seconds": self.seconds, "processor_seconds": seconds, **self._counts}

    def watch(self, model: BaseAlgorithm) -> None:
        """Count the gradient steps of a model: updates of the actor and critic of PPO, or of the critic of SAC."""
        optimizer = getattr(model.policy, "critic", model.policy).optimizer
        optimizer.register_step_post_hook(lambda *_: self.add(gradient_steps=1))


class Metered(gymnasium.vector.VectorWrapper[Any, Any, Any, Any, Any]):
    """Worlds with autoreset, whose decisions a meter counts: one for each world and control step."""

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any], meter: Meter) -> None:
        super().__init__(env)
        self._meter = meter

    def step(self, actions: ArrayLike) -> Any:
        """Make one control step in every world."""
        self._meter.add(decisions=self.num_envs)
        return self.env.step(actions)
