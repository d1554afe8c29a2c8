"""Plays episodes with one policy, and records a result for each."""

import itertools
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.utils.env_checker import data_equivalence
from numpy.typing import NDArray

from armctl import DEFAULT_ENV
from armctl.core.errors import (
    FAILURES,
    ConfigurationError,
    ConnectionFailed,
    Disqualified,
    EnvironmentFailed,
    InvalidAction,
    TookTooLong,
    described,
)
from armctl.core.seeds import Seed, evaluation_seed
from armctl.core.time_limit import time_limit
from armctl.envs import EpisodeVectorEnv, chosen_policy_seed
from armctl.episodes.failures import PolicyDisqualified, PolicyFailed, until_unplayable
from armctl.episodes.record import EpisodeResult, FailedEpisode
from armctl.episodes.table import EpisodeTable
from armctl.policies import ControllersFailed, Policy, PolicyFactory, WorldsByInterface, policy_name
from armctl.policies.policy import PlaysApart
from armctl.rollout.construction import build_policy
from armctl.rollout.decision_times import Errors, TimedPolicy
from armctl.rollout.recorder import EpisodeRecorder
from armctl.runtime.state_guard import StateGuard

if TYPE_CHECKING:
    import pandas as pd

MAX_COUNTS = {"episodes": 10_000_000, "worlds": 100_000}
"""Larger numbers are mistakes, or a stranger's: they would fill the memory before anything is played."""


class _UnknownWorldFailed(Exception):
    """A policy that acts in all worlds at once has failed, in one of them or in more."""

    def __init__(self, error: BaseException) -> None:
        super().__init__(error)
        self.error = error


@dataclass(frozen=True)
class _Attempt:
    """An episode that was being played when a policy failed in an unknown world."""

    actions: list[Any]
    record: FailedEpisode
    """Result if the policy acts otherwise when the episode is played again."""


class _ActedOtherwise(Exception):
    """A policy acts otherwise in an episode than before."""

    def __init__(self, attempt: _Attempt) -> None:
        super().__init__(attempt.record.message)
        self.attempt = attempt


def rollouts(
    policy: Policy | TimedPolicy,
    env: EpisodeVectorEnv,
    episodes: int | Sequence[int],
    seed: int,
    name: str = "policy",
    lower_bound_steps: dict[int, float] | None = None,
) -> Iterator[EpisodeResult]:
    """Play episodes of `seed` in the worlds of `env`, and yield the result of each as it ends.

    `episodes` is their count, or their numbers. `lower_bound_steps`, by episode, is read and extended, so that policies
    can share it. A decision time is the duration of the policy's call divided by the number of worlds in which it
    decides. `TimedPolicy` is for a policy that has decided before, or whose decisions come late.

    An episode in which the policy raises an error or returns an invalid action ends as a `FailedEpisode`, a loss, and
    the next one begins. `until_unplayable` and `unless_failed` handle these.

    Raises `PolicyDisqualified` if the policy writes to the world, and `EnvironmentFailed` if the environment fails.
    """
    timed = policy if isinstance(policy, TimedPolicy) else TimedPolicy(policy, env.num_envs)
    recorder = EpisodeRecorder(timed, env, seed, name, {} if lower_bound_steps is None else lower_bound_steps)
    return _Player(timed, env, recorder, seed, name).play(range(episodes) if isinstance(episodes, int) else episodes)


class _Player:
    """Plays episodes of one policy in n worlds."""

    def __init__(
        self, timed: TimedPolicy, env: EpisodeVectorEnv, recorder: EpisodeRecorder, seed: int, name: str
    ) -> None:
        self._timed, self._env, self._recorder, self._seed, self._name = timed, env, recorder, seed, name
        guard = StateGuard(env, timed.policy.sees == "state", getattr(timed.policy, "foresight", ()))
        plays_apart = isinstance(timed.policy, PlaysApart)  # it has no world, and a limit of its own
        self._guarded = _out_of_reach if plays_apart else guard.assert_unchanged
        self._limit = None if plays_apart else timed.timeout
        self._limit_of_env = environment_limit(env, timed.timeout)
        self._numbers = np.zeros(env.num_envs, dtype=np.int64)
        """(n,) the episode of each world."""
        self._playing = np.zeros(env.num_envs, dtype=bool)
        """(n,) in which worlds an episode is played whose result counts."""

    def play(self, episodes: Sequence[int]) -> Iterator[EpisodeResult]:
        """Yield the results of the episodes as they end."""
        n, waiting = self._env.num_envs, iter(episodes)
        while first := list(itertools.islice(waiting, n)):
            numbers = np.array([*first, *first[:1] * (n - len(first))])
            try:
                yield from self._stream(numbers, np.arange(n) < len(first), waiting)
            except _UnknownWorldFailed as failure:
                yield from self._find_failed(failure.error)

    def _stream(
        self,
        numbers: NDArray[np.int64],
        playing: NDArray[np.bool_],
        waiting: Iterator[int],
        attempts: Mapping[int, _Attempt] | None = None,
    ) -> Iterator[EpisodeResult]:
        """Start the episodes `numbers` (n,), play those of the mask `playing` (n,), and then those that are `waiting`.

        The other worlds stand still. `attempts` are first attempts, by episode. Raises `_UnknownWorldFailed`.
        """
        self._numbers, self._playing = numbers, playing
        starting = np.ones(len(numbers), dtype=bool)
        seeds: list[int] | None = [self._seed] * len(numbers)
        while playing.any():
            errors = Errors()
            if starting.any():
                self._begin(starting, seeds)
                errors, seeds = self._reset(starting), None
                self._env.unwrapped.abandon(np.flatnonzero(~playing))
            if acts := not errors:
                actions, decision_ms, errors = self._act(attempts or {})
            over = np.isin(np.arange(len(numbers)), list(errors)) & playing
            for i in np.flatnonzero(over):
                error = errors[int(i)]
                yield (
                    error.attempt.record if isinstance(error, _ActedOtherwise) else self._recorder.failed(int(i), error)
                )
            if acts and (playing & ~over).any():
                self._env.unwrapped.abandon(np.flatnonzero(over))
                infos, done = self._step(_without(actions, errors, np.flatnonzero(playing & ~over)), decision_ms)
                done &= playing & ~over
                for i in np.flatnonzero(done):
                    yield self._recorder.result(int(i), infos)
                over |= done
            for i in np.flatnonzero(over):
                numbers[i] = next(waiting, -1)
            starting = over & (numbers >= 0)
            playing[over] = starting[over]
            self._timed.idle(np.flatnonzero(~playing))
            self._recorder.discard_old_steps(playing)

    def _find_failed(
        self, error: BaseException, attempts: Mapping[int, _Attempt] | None = None
    ) -> Iterator[EpisodeResult]:
        """Yield the results of the episodes that were played as the policy failed in an unknown world.

        Halves of them are played again, until those in which it fails are alone. The policy gains nothing by it: up to
        where it failed, it has to act as in its first `attempts`.
        """
        worlds, numbers = np.flatnonzero(self._playing), self._numbers.copy()
        if len(np.unique(numbers)) == 1:
            yield self._recorder.failed(int(worlds[0]), error)
            return
        failed, first = False, attempts is None and self._playing.all()  # else, it may be a world without an episode
        attempts = {int(numbers[i]): self._attempt(int(i), error) for i in worlds} | dict(attempts or {})
        for half in np.array_split(worlds, min(2, len(worlds))):
            playing = np.isin(np.arange(len(numbers)), half)
            again = np.where(playing, numbers, np.resize(numbers[half], len(numbers)))
            try:
                for result in self._stream(again, playing, iter(()), attempts):
                    failed |= isinstance(result, FailedEpisode)
                    yield result
            except _UnknownWorldFailed as failure:
                failed = True
                yield from self._find_failed(failure.error, attempts)
        if first and not failed:
            warnings.warn(
                f"{self._name} failed in {len(worlds)} episodes played at once ({described(error)}), and in none of "
                "them when they were played again: no episode counts as failed by it",
                stacklevel=2,
            )

    def _attempt(self, i: int, error: BaseException) -> _Attempt:
        record = self._recorder.failed(i, error)
        message = (
            f"a batch with it failed ({record.message}), and when it was played again, the policy acted otherwise: one "
            "that draws random numbers should draw them from env.rng"
        )
        return _Attempt(self._recorder.actions(i), replace(record, message=message))

    def _begin(self, starting: NDArray[np.bool_], seeds: list[int] | None) -> None:
        """Start an episode in the worlds `starting` (n,)."""
        episode = self._numbers[starting][0]
        with wrap_environment_errors(self._name, episode, self._limit_of_env):
            options = {"reset_mask": starting, "episode": np.maximum(self._numbers, 0)}
            self._observations, infos = self._env.reset(seed=seeds, options=options)
        with wrap_environment_errors(self._name, episode):
            self._recorder.begin(starting & self._playing, self._numbers, infos)

    def _reset(self, starting: NDArray[np.bool_]) -> Errors:
        """Tell the policy that episodes start."""
        with self._policy_errors(), self._guarded(new_episode=True), time_limit(self._limit, "its reset"):
            return self._timed.reset(np.flatnonzero(starting).astype(np.int32), self._numbers[starting].tolist())

    def _act(self, attempts: Mapping[int, _Attempt]) -> tuple[Any, NDArray[np.float64], Errors]:
        """Return actions (n, ...), the time of each world's decision, and errors by world, also for invalid actions."""
        with self._policy_errors():
            with self._guarded(), time_limit(self._limit, "its decision"):
                actions, decision_ms, errors = self._timed.act(self._observations)
            if valid := [i for i in range(self._env.num_envs) if i not in errors]:
                errors = self._env.unwrapped.invalid_actions(_without(actions, errors, valid)) | errors
        return actions, decision_ms, self._differing(actions, attempts) | errors

    def _step(self, actions: Any, decision_ms: NDArray[np.float64]) -> tuple[dict[str, Any], NDArray[np.bool_]]:
        """Make a control step. Return infos, and in which worlds (n,) the episode has ended."""
        with wrap_environment_errors(self._name, self._numbers[self._playing][0], self._limit_of_env):
            self._observations, rewards, terminated, truncated, infos = self._env.step(actions)
            self._recorder.step(actions, decision_ms, rewards, infos)
        return infos, terminated | truncated

    def _differing(self, actions: Any, attempts: Mapping[int, _Attempt]) -> Errors:
        """Return errors of worlds whose actions differ from those of the first attempt."""
        different = Errors()
        for i in np.flatnonzero(self._playing).tolist() if attempts else ():
            step, first = self._recorder.steps(i), attempts.get(int(self._numbers[i]))
            if first is None or step >= len(first.actions):
                continue
            if not data_equivalence(actions[i], first.actions[step], exact=True):
                different[i] = _ActedOtherwise(first)
        return different

    @contextmanager
    def _policy_errors(self) -> Iterator[None]:
        """Raise `PolicyDisqualified` if the policy wrote to the world, `_UnknownWorldFailed` for any other error."""
        try:
            yield
        except Disqualified as error:
            episode = self._numbers[self._playing][0]
            raise PolicyDisqualified(f"{self._name} is disqualified: in episode {episode}, {error}") from error
        except (ConnectionFailed, TookTooLong) as error:
            raise PolicyFailed(f"{self._name} failed in episode {self._numbers[self._playing][0]}: {error}") from error
        except FAILURES as error:
            raise _UnknownWorldFailed(error) from error


def _out_of_reach(new_episode: bool = False) -> AbstractContextManager[None]:
    """Check nothing: a policy in another process has no world that it could write to."""
    return nullcontext()


def _without(actions: Any, errors: Errors, valid: Sequence[int] | NDArray[np.intp]) -> Any:
    """Replace the actions of worlds with errors, which make no use of them, by a valid one."""
    if not errors:
        return actions
    return [actions[valid[0]] if i in errors else action for i, action in enumerate(actions)]


@contextmanager
def wrap_policy_errors(name: str, episode: int) -> Iterator[None]:
    """Turn any error inside into `PolicyFailed`, with its place."""
    try:
        yield
    except Disqualified as error:
        raise PolicyDisqualified(f"{name} is disqualified: in episode {episode}, {error}") from error
    except FAILURES as error:
        cause = error.first if isinstance(error, ControllersFailed) else error
        message = str(cause) if isinstance(cause, InvalidAction) else described(cause)
        raise PolicyFailed(f"{name} failed in episode {episode}: {message}") from cause


def environment_limit(env: EpisodeVectorEnv, timeout: float | None) -> float | None:
    """Return the time limit (s) of a step or reset in this process; worlds in other processes get it as theirs."""
    return None if timeout is None or env.unwrapped.limit_answers(timeout) else timeout


@contextmanager
def wrap_environment_errors(name: str, episode: int, limit: float | None = None) -> Iterator[None]:
    """Turn an invalid action into `PolicyFailed`, and any other error inside into `EnvironmentFailed`.

    It is an error, too, if the code inside takes longer than the `limit` (s).
    """
    try:
        with time_limit(limit, "it"):
            yield
    except InvalidAction as error:
        raise PolicyFailed(f"{name} failed in episode {episode}: {error}") from error
    except (ConfigurationError, EnvironmentFailed):
        raise
    except TookTooLong as error:
        raise EnvironmentFailed(f"the environment failed in episode {episode} of {name}: {error}") from error
    except FAILURES as error:
        raise EnvironmentFailed(f"the environment failed in episode {episode} of {name}: {described(error)}") from error


def check_counts(**counts: int) -> None:
    """Raise `ConfigurationError` for a number of episodes or worlds that is too small or too large."""
    for name, count in counts.items():
        if not 1 <= count <= MAX_COUNTS[name]:
            raise ConfigurationError(f"{name} must be at least 1 and at most {MAX_COUNTS[name]:,}, not {count:,}")


def evaluate(
    policy: str | Path | PolicyFactory,
    env: str = DEFAULT_ENV,
    *,
    episodes: int = 200,
    seed: Seed = 0,
    worlds: int = 1,
    env_options: Mapping[str, Any] | None = None,
    lower_bound_steps: bool = True,
    policy_seed: int | None = None,
) -> "pd.DataFrame":
    """Play episodes 0 to `episodes` - 1 of `seed` with one policy; return a row for each, as in `episodes.csv`.

    Without `lower_bound_steps`, which often take longer to compute than the episodes, they and the column
    `optimality_gap` are NaN. The policy's own random numbers come from `policy_seed`, of up to 128 bits, or else from a
    new secret.

    An episode in which the policy raises an error, or returns an invalid action, has the outcome `error`: it is lost.

    Raises `ConfigurationError`, `AgentFileError`, `EnvironmentFailed`, and `PolicyFailed` if the policy cannot play at
    all (see `armctl.episodes.failures`), or writes to the world.
    """
    check_counts(episodes=episodes, worlds=worlds)
    seed = evaluation_seed(seed)
    with closing(WorldsByInterface(env, min(worlds, episodes), env_options)) as interfaces:
        vec_env = interfaces.of(policy)
        name = policy_name(policy)
        actor = build_policy(policy, vec_env, name, chosen_policy_seed(policy_seed))
        bounds = None if lower_bound_steps else dict.fromkeys(range(episodes), math.nan)
        results = rollouts(actor, vec_env, episodes, seed, name, bounds)
        return EpisodeTable(until_unplayable(results, name, range(episodes))).sorted([name]).frame()
