"""The record of an episode, and its row in `episodes.csv`."""

import json
import math
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.episodes.metrics import Metrics, warm_times

COLUMNS = (
    "policy", "env", "episode", "seed", "outcome", "success", "feasible", "return", "reward_terms", "length",
    "lower_bound_steps", "optimality_gap", "tracking_error", *(field.name for field in fields(Metrics)),
    "reset_ms", "worlds", "workers", "run",
)  # fmt: skip
TIME_COLUMNS = (
    "missed_deadlines", "decision_ms_p50", "decision_ms_p99", "decision_ms_max", "first_call_ms", "reset_ms",
    "worlds", "workers", "run",
)  # fmt: skip
"""The columns that depend on the machine, and on how it was used. All others are the same whenever and wherever an
episode is played."""

LARGEST_RETURN = 1e100
"""Beyond what the environments pay in any episode; its square, and the sum of many such, are still numbers."""


@dataclass(frozen=True)
class EpisodeResult:
    """The record of one episode. `env.reset(seed=seed, options={"episode": episode})` starts it again."""

    policy: str
    env: str
    episode: int
    seed: int
    outcome: str
    success: bool | None
    """None if the environment does not say."""
    feasible: bool
    total_reward: float
    reward_terms: dict[str, float]
    """The sum of each reward term; the return is the sum of these."""
    length: int
    lower_bound_steps: float
    """Lower bound on the number of control steps until success; NaN if unknown (see `Task.min_time`)."""
    tracking_error: float
    """m, mean distance to a moving target since it was first reached; NaN in other tasks."""
    metrics: Metrics
    worlds: int
    """Number of worlds that shared the policy's calls. Decision times are these calls', divided by the number of those
    in which it decides."""
    workers: int
    """Number of processes that played at a time."""
    decision_ms: NDArray[np.float64]
    """(length,) decision times: wall time of each call of the policy, to 0.1 us.

    NaN in control steps in which the policy was still computing (`RealTime`)."""
    run: str = ""
    """Id of the run that played it (see `Run`); empty if that is unknown."""
    reset_ms: float = math.nan
    """Wall time of the policy's reset at the beginning; of several worlds at once, divided by their number."""
    recording: Any = field(default=None, repr=False, compare=False)
    """Recording of the episode, by worlds that record; it is in no table and no file of results."""

    @property
    def optimality_gap(self) -> float:
        """Relative excess of the length over the least possible; NaN unless that is known, and it was a success."""
        return self.length / self.lower_bound_steps - 1 if self.success and self.lower_bound_steps > 0 else math.nan

    @property
    def warm_ms(self) -> NDArray[np.float64]:
        """The decision times without that of the policy's first decision in its process (see `warm_times`)."""
        return warm_times(self.decision_ms, not math.isnan(self.metrics.first_call_ms))

    def row(self) -> dict[str, Any]:
        """Return the episode as a row of `episodes.csv`."""
        values = (
            self.policy, self.env, self.episode, self.seed, self.outcome, self.success, self.feasible,
            self.total_reward, json.dumps(self.reward_terms), self.length, self.lower_bound_steps, self.optimality_gap,
            self.tracking_error,
            *vars(self.metrics).values(), self.reset_ms, self.worlds, self.workers, self.run,
        )  # fmt: skip
        return dict(zip(COLUMNS, values, strict=True))


@dataclass(frozen=True)
class FailedEpisode(EpisodeResult):
    """An episode with the outcome `ERROR`, in the process that played it: what is written does not say why."""

    message: str = ""
    """The policy's error, and its place."""
    traceback: str = ""
