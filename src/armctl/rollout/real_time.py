"""A world that does not wait: a decision that takes longer than the control period takes effect when it is ready.

A decision of at most one control period takes effect at once, as everywhere else. A longer one takes effect at the
first control step after it is ready; until then the last command goes on, and the policy, which is still computing, is
not asked. Then it is asked again, with what it observes then. Before its first command, the robot gets the idle action.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Observations
from armctl.core.errors import ConfigurationError
from armctl.core.files import digest
from armctl.disturbances import Disturbance, DisturbanceSpec
from armctl.envs import EpisodeVectorEnv
from armctl.episodes.output import DECISIONS
from armctl.episodes.record import EpisodeResult
from armctl.episodes.stored import MEASURED, STORE, UNDISTURBED, read_store
from armctl.policies import Actions, Policy
from armctl.rollout.decision_times import Errors, TimedPolicy

SLOW_DOWN = DisturbanceSpec(
    Disturbance, "a slower computer, in real time", "times the decision times; 0: the world waits",
    (0, 1, 2, 5, 10, 30), 1e4,
)  # fmt: skip
"""Axis of a sweep. It changes nothing in the simulation, but the times at which decisions take effect."""
TOLERANCE = 1e-9
"""Rounding error of a number of control periods: a decision of exactly two is not one of three."""


@dataclass(frozen=True)
class RecordedTimes:
    """The times of an episode's decisions, in their order."""

    ms: tuple[float, ...]
    first_call: bool
    """True if the first one was the policy's first in its process."""
    reset_ms: float = 0.0
    """Time of the reset before the first one."""

    def again(self) -> Iterator[float]:
        """Yield the times, ms. After the last one they repeat, without the first, which may include extra work."""
        return itertools.chain(self.ms, itertools.cycle(self.ms[1:] or self.ms))


@dataclass(frozen=True)
class RealTime:
    """Decision times in a world that does not wait."""

    slow_down: float = 1.0
    """Factor by which decisions take longer than they were measured."""
    latency: str = MEASURED
    """`measured`, or the folder in which the times were recorded."""
    recorded: Mapping[str, Mapping[int, RecordedTimes]] | None = None
    """Recorded times by policy and episode; None if they are measured."""

    def of(self, policy: str, episodes: Sequence[int]) -> "RealTime":
        """Return the same for some episodes of one policy."""
        if self.recorded is None:
            return self
        return replace(self, recorded={policy: {episode: self.recorded[policy][episode] for episode in episodes}})

    def missing_recordings(self, policies: Iterable[str], episodes: int) -> dict[str, int]:
        """Return the policies without recorded times for all episodes, and the first missing episode of each."""
        if self.recorded is None:
            return {}
        missing = {
            name: next((k for k in range(episodes) if k not in self.recorded.get(name, {})), None) for name in policies
        }
        return {name: episode for name, episode in missing.items() if episode is not None}

    def identity(self, policies: Iterable[str]) -> dict[str, Any]:
        """Return what determines the episodes. A recording counts by its first episode: it may be extended later."""
        latency = MEASURED
        if self.recorded is not None:
            first = {name: self.recorded[name][0] for name in policies}
            latency = digest({name: [*times.ms, times.first_call, times.reset_ms] for name, times in first.items()})
        return {"latency": latency, "slow_down": self.slow_down}

    def in_words(self, period: float) -> str:
        """Return a remark about a comparison."""
        times = "as measured here" if self.recorded is None else f"as recorded in {self.latency}"
        scale = f", {self.slow_down:g} times as long" if self.slow_down != 1 else ""
        return (
            f"In real time: a decision that takes longer than the control period, {1e3 * period:g} ms, takes effect "
            f"when it is ready. Decisions take their time {times}{scale}."
        )


class RealTimePolicy(TimedPolicy):
    """A policy in one world that does not wait for its decisions. Planning at the reset is part of the first one.

    Its first decision in a process is recorded separately, and takes effect at once.
    """

    def __init__(self, policy: Policy, worlds: Any, real_time: RealTime, name: str) -> None:
        super().__init__(policy, 1)
        self.slow_down = real_time.slow_down
        self._recorded = None if real_time.recorded is None else real_time.recorded[name]
        self._period_ms = 1e3 * worlds.control_period
        self._idle = np.array(worlds.idle_action)[None]
        self._replayed: Iterator[float] | None = None
        self._pending: Any = None
        """Command that is still computed."""
        self._steps_left = 0
        """Control steps until it is ready."""

    def reset(self, ids: NDArray[np.int32], episodes: Sequence[int]) -> Errors:
        """Start an episode; a command that was still computed is dropped."""
        errors = super().reset(ids, episodes)
        self._command, self._pending, self._steps_left = self._idle.copy(), None, 0
        self._begins = True
        if self._recorded is not None:
            recorded = self._recorded[episodes[0]]
            self._replayed, self.first_call[0] = recorded.again(), recorded.first_call
            self.reset_ms[0] = recorded.reset_ms
        return errors

    def act(self, observations: Observations) -> tuple[Actions, NDArray[np.float64], Errors]:
        """Return the command of this control step, (1, ...), and the time of the decision that begins, if one does."""
        self._steps_left = max(0, self._steps_left - 1)
        if self._steps_left:
            return self._command, np.array([math.nan]), Errors()
        if self._pending is not None:
            self._command, self._pending = self._pending, None
        decided, spent, errors = super().act(observations)
        if errors:
            return decided, spent, errors
        if self._replayed is not None:
            spent = np.array([next(self._replayed)])
        waited = spent[0] + (self.reset_ms[0] if self._begins else 0.0)
        periods = self.slow_down * waited / self._period_ms
        if periods <= 1 + TOLERANCE or (self._begins and self.first_call[0]):
            self._command = _copied(decided)
        else:
            self._pending, self._steps_left = _copied(decided), math.ceil(periods - TOLERANCE)
        self._begins = False
        return self._command, spent, errors


def real_time_of(real_time: str | Path | None, slow_down: float, env: str, seed: int) -> RealTime | None:
    """Return the decision times that the arguments of `compare` request; None for a world that waits.

    Raises `ConfigurationError`, and `ResultsError` for a damaged recording.
    """
    usable = isinstance(slow_down, (int, float)) and not isinstance(slow_down, bool)
    if not (usable and 0 < slow_down <= SLOW_DOWN.highest):
        raise ConfigurationError(f"slow_down is a number above 0 and up to {SLOW_DOWN.highest:g}, not {slow_down!r}")
    if real_time is None:
        if slow_down != 1:
            raise ConfigurationError("slow_down is for real time: add real_time='measured' (--real-time measured)")
        return None
    if str(real_time) == MEASURED:
        return RealTime(float(slow_down))
    return read_recording(Path(real_time), float(slow_down), env, seed)


def read_recording(path: Path, slow_down: float, env: str, seed: int) -> RealTime:
    """Return the decision times in the results of a comparison: its folder, or a file in it.

    Raises `ConfigurationError` for results of another environment or seed, and for times that are no latencies, and
    `ResultsError` for damaged results.
    """
    folder = path.parent if path.name in (STORE, DECISIONS) else path
    if not (folder / STORE).exists():
        raise ConfigurationError(
            f"real time takes '{MEASURED}', or a folder with a comparison's results, whose decision times it repeats, "
            f"not {path}"
        )
    cells = read_store(folder).cells
    undisturbed = [cell for name, cell in cells.items() if name.rpartition("/")[2] == UNDISTURBED]
    if not undisturbed:
        raise ConfigurationError(f"{folder} holds no undisturbed episodes, whose decision times could be repeated")
    stored = next((cell for cell in undisturbed if cell.identity.get("env") == env), undisturbed[0])
    for name, value in {"env": env, "seed": seed}.items():
        if (recorded := stored.identity.get(name)) != value:
            raise ConfigurationError(
                f"the decision times in {folder} are of another comparison: {name} {recorded} there, {value} here"
            )
    return RealTime(slow_down, str(folder), recorded_times(stored.episodes))


def recorded_times(results: Iterable[EpisodeResult]) -> dict[str, dict[int, RecordedTimes]]:
    """Return the decision times of episodes, by policy and episode.

    Raises `ConfigurationError` if they are not latencies.
    """
    by_policy: dict[str, dict[int, RecordedTimes]] = {}
    for result in results:
        if (result.worlds, result.workers) != (1, 1):
            raise ConfigurationError(
                f"the decision times of {result.policy} in episode {result.episode} are no latencies: they were taken "
                f"with {result.worlds} worlds and {result.workers} workers. Record with one world and one worker"
            )
        times = result.decision_ms[~np.isnan(result.decision_ms)].tolist()
        reset_ms = 0.0 if math.isnan(result.reset_ms) else result.reset_ms
        first_call = not math.isnan(result.metrics.first_call_ms)
        recorded = RecordedTimes(tuple(times) or (0.0,), first_call, reset_ms)
        by_policy.setdefault(result.policy, {})[result.episode] = recorded
    return by_policy


def check_recorded(real_time: RealTime, policies: Iterable[str], episodes: int) -> None:
    """Raise `ConfigurationError` if a policy has no recorded times in one of the episodes."""
    for name, episode in real_time.missing_recordings(policies, episodes).items():
        raise ConfigurationError(
            f"{real_time.latency} has no decision times of {name} in episode {episode}: record these episodes first"
        )


def check_measurable(num_envs: int, workers: int) -> None:
    """Raise `ConfigurationError` unless decision times are latencies."""
    if (num_envs, workers) != (1, 1):
        raise ConfigurationError(
            f"measured real time needs one world and one worker, not {num_envs} and {workers}: give recorded times, "
            "a results folder of one world and one worker (--real-time DIR), to play with more workers"
        )


def check_real_time(env: str, worlds: EpisodeVectorEnv) -> None:
    """Raise `ConfigurationError` for an environment in which nothing can come late."""
    if worlds.task.control_period is None:
        raise ConfigurationError(
            f"{env} does not say its control period, s, which real time needs: give the environment an attribute dt"
        )
    if not isinstance(worlds.single_action_space, gymnasium.spaces.Box):
        raise ConfigurationError(
            f"real time needs actions that are numbers, to have one until the first decision is ready; those of {env} "
            f"are {worlds.single_action_space}"
        )


def _copied(actions: Any) -> Any:
    """Return a copy of actions that the policy may write over."""
    return np.array(actions) if isinstance(actions, np.ndarray) else actions
