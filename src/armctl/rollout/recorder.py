"""Records the episodes that are being played in n worlds."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import InvalidAction, described, formatted
from armctl.envs import ERROR, EpisodeVectorEnv
from armctl.episodes.metrics import EpisodeTimes, metrics
from armctl.episodes.record import EpisodeResult, FailedEpisode
from armctl.rollout.decision_times import TimedPolicy
from armctl.tasks import MotionSample


class EpisodeRecorder:
    """Records the current episode of each of n worlds."""

    def __init__(
        self,
        timed: TimedPolicy,
        env: EpisodeVectorEnv,
        seed: int,
        name: str,
        lower_bound_steps: dict[int, float],
    ) -> None:
        n = env.num_envs
        self._timed, self._task, self._seed, self._name = timed, env.task, seed, name
        self._lower_bound_steps = lower_bound_steps
        self._env_id, self._outcomes = env.spec.id if env.spec else type(env).__name__, env.outcomes
        self._numbers, self._first_step = np.zeros((2, n), dtype=np.int64)
        self._starts = np.zeros((n, 3))
        self._feasible = np.ones(n, dtype=bool)
        self._failures_before = np.zeros(n, dtype=np.int64)
        self._interventions_before = np.zeros((2, n))
        self._reward_sums: dict[str, NDArray[np.float64]] = {}
        self._returns = np.zeros(n)
        self._decision_ms: list[NDArray[np.float64]] = []
        self._actions: list[Any] = []
        self._motions: list[MotionSample] = []

    def begin(self, began: NDArray[np.bool_], numbers: NDArray[np.int64], infos: Mapping[str, Any]) -> None:
        """Note that the worlds in the mask `began` (n,) have started the episodes `numbers` (n,)."""
        self._numbers[began] = numbers[began]
        self._first_step[began] = len(self._motions)
        self._starts[began] = self._task.motion().position[began]
        self._feasible = infos.get("feasible", self._feasible)
        self._failures_before[began] = self._failures()[began]
        self._interventions_before[:, began] = self._interventions()[:, began]
        for sums in (self._returns, *self._reward_sums.values()):
            sums[began] = 0.0
        for i in np.flatnonzero(began):
            if (number := int(numbers[i])) not in self._lower_bound_steps:
                time = self._task.min_time(int(i))
                steps = np.ceil(time / self._task.control_period - 1e-9) if math.isfinite(time) else math.nan
                self._lower_bound_steps[number] = float(np.maximum(1.0, steps))

    def step(
        self, actions: Any, decision_ms: NDArray[np.float64], rewards: NDArray[np.float64], infos: Mapping[str, Any]
    ) -> None:
        """Note a control step of all worlds."""
        self._actions.append(np.array(actions) if isinstance(actions, np.ndarray) else list(actions))
        self._decision_ms.append(decision_ms)
        self._motions.append(self._task.motion())
        self._returns += rewards
        self._reward_sums = {
            name: self._reward_sums.get(name, 0.0) + values for name, values in infos["reward_terms"].items()
        }

    def steps(self, i: int) -> int:
        """Return the number of control steps of the episode in world i so far."""
        return len(self._motions) - int(self._first_step[i])

    def actions(self, i: int) -> list[Any]:
        """Return the actions in world i's episode so far."""
        return [actions[i] for actions in self._actions[self._first_step[i] :]]

    def result(self, i: int, infos: Mapping[str, Any]) -> EpisodeResult:
        """Return the record of the episode that has just ended in world i."""
        success = infos["is_success"][i]
        tracked = "tracking" in infos and infos["tracking"][i]
        return EpisodeResult(
            **self._record(i),
            outcome=self._outcomes[infos["outcome_id"][i]],
            success=None if success is None else bool(success),
            tracking_error=float(infos["tracking_error"][i]) if tracked else math.nan,
            recording=infos["recordings"][i] if "recordings" in infos else None,
        )

    def failed(self, i: int, error: BaseException) -> FailedEpisode:
        """Return the record of world i's episode, in which the policy has just failed: a loss, whatever its return."""
        return FailedEpisode(
            **self._record(i),
            outcome=ERROR,
            success=False,
            tracking_error=math.nan,
            message=str(error) if isinstance(error, InvalidAction) else described(error),
            traceback=formatted(error),
        )

    def discard_old_steps(self, playing: NDArray[np.bool_]) -> None:
        """Drop the steps that precede all current episodes."""
        over = min(self._first_step[playing], default=0)
        del self._decision_ms[:over], self._motions[:over], self._actions[:over]
        self._first_step -= over

    def _record(self, i: int) -> dict[str, Any]:
        """Fields of a result that are known however the episode in world i has ended."""
        steps = slice(self._first_step[i], None)
        decision_ms = np.array([spent[i] for spent in self._decision_ms[steps]])
        motions, (num_envs, workers) = self._motions[steps], self._timed.setting
        return {
            "policy": self._name,
            "env": self._env_id,
            "episode": int(self._numbers[i]),
            "seed": self._seed,
            "feasible": bool(self._feasible[i]),
            "total_reward": float(self._returns[i]),
            "reward_terms": {name: float(sums[i]) for name, sums in self._reward_sums.items()} if motions else {},
            "length": len(motions),
            "lower_bound_steps": self._lower_bound_steps[int(self._numbers[i])],
            "metrics": metrics(
                self._task,
                i,
                self._starts[i],
                motions,
                EpisodeTimes(
                    decision_ms,
                    float(self._timed.reset_ms[i]),
                    bool(self._timed.first_call[i]),
                    self._timed.slow_down if self._timed.setting == (1, 1) else None,
                ),
                int(self._failures()[i] - self._failures_before[i]),
                tuple((self._interventions() - self._interventions_before)[:, i].tolist()),
            ),
            "worlds": num_envs,
            "workers": workers,
            "reset_ms": float(self._timed.reset_ms[i]),
            "decision_ms": decision_ms,
        }

    def _interventions(self) -> NDArray[np.float64]:
        """(2, n) number of a safety filter's interventions in each world, and the sums of their sizes; else NaN."""
        policy = self._timed.policy
        counts = (getattr(policy, name, np.nan) for name in ("interventions", "intervention_sizes"))
        return np.array([np.broadcast_to(count, len(self._numbers)) for count in counts], dtype=float)

    def _failures(self) -> NDArray[np.int64]:
        """(n,) number of solver failures in each world; 0 for policies that do not count them."""
        return np.broadcast_to(getattr(self._timed.policy, "failures", 0), len(self._numbers)).copy()
