"""Plays episodes with one policy, and records a result for each."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from armctl import DEFAULT_ENV
from armctl.envs import EpisodeVectorEnv, chosen_policy_seed
from armctl.errors import (
    FAILURES,
    ArmctlError,
    ConfigurationError,
    Disqualified,
    EnvironmentFailed,
    InvalidAction,
    described,
)
from armctl.evaluation.decision_times import TimedPolicy
from armctl.evaluation.episode_table import EpisodeTable
from armctl.evaluation.metrics import metrics
from armctl.evaluation.record import EpisodeResult
from armctl.evaluation.seeds import Seed, evaluation_seed
from armctl.evaluation.tampering import StateGuard
from armctl.policies import Policy, PolicyFactory, WorldsByInterface, make_policy, policy_name
from armctl.tasks import MotionSample

MOST = {"episodes": 10_000_000, "worlds": 100_000, "workers": 1_000}
"""Larger numbers are mistakes, or a stranger's: they would fill the memory before anything is played."""


class PolicyFailed(ArmctlError):
    """A policy raised an error, or returned an invalid action."""


class PolicyDisqualified(PolicyFailed):
    """A policy wrote to the world. None of its episodes count."""


def rollouts(
    policy: Policy | TimedPolicy,
    env: EpisodeVectorEnv,
    episodes: int | Sequence[int],
    seed: int,
    name: str = "policy",
    least_lengths: dict[int, float] | None = None,
) -> Iterator[EpisodeResult]:
    """Play episodes of `seed` in the worlds of `env`, and yield the result of each as it ends.

    `episodes` is how many to play, or their numbers. `least_lengths`, by episode, is read and extended, so that
    policies can share it. A decision time is the duration of the policy's call divided by the number of worlds; the
    first one of an episode includes the policy's reset. `TimedPolicy` is for a policy that has decided before, or whose
    decisions come late.

    Raises `PolicyFailed` if the policy fails (`PolicyDisqualified` if it writes to the world), and `EnvironmentFailed`
    if the environment does.
    """
    n, guard = env.num_envs, StateGuard(env)
    episodes = range(episodes) if isinstance(episodes, int) else episodes
    playing = np.arange(n) < len(episodes)
    numbers = np.array([*episodes[:n], *[0] * (n - len(episodes))])
    waiting = iter(episodes[n:])
    timed = policy if isinstance(policy, TimedPolicy) else TimedPolicy(policy, n)
    recorder = _EpisodeRecorder(timed, env, seed, name, {} if least_lengths is None else least_lengths)
    with wrap_environment_errors(name, numbers[0]):
        observations, infos = env.reset(seed=[seed] * n, options={"episode": numbers})
        recorder.begin(playing, numbers, infos)
    with wrap_policy_errors(name, numbers[0]), guard.assert_unchanged(new_episode=True):
        timed.reset(np.arange(n, dtype=np.int32), numbers.tolist())
    while playing.any():
        with wrap_policy_errors(name, numbers[playing][0]), guard.assert_unchanged():
            actions, decision_ms = timed.act(observations)
        with wrap_environment_errors(name, numbers[playing][0]):
            observations, rewards, terminated, truncated, infos = env.step(actions)
            recorder.step(decision_ms, rewards, infos)
        ended = np.flatnonzero((terminated | truncated) & playing)
        if not len(ended):
            continue
        for i in ended:
            yield recorder.result(int(i), infos)
            numbers[i] = next(waiting, -1)
        again = np.zeros(n, dtype=bool)
        again[ended] = numbers[ended] >= 0
        playing[ended] = again[ended]
        if again.any():
            with wrap_environment_errors(name, numbers[again][0]):
                observations, infos = env.reset(options={"reset_mask": again, "episode": np.maximum(numbers, 0)})
                recorder.begin(again, numbers, infos)
            with wrap_policy_errors(name, numbers[again][0]), guard.assert_unchanged(new_episode=True):
                timed.reset(np.flatnonzero(again).astype(np.int32), numbers[again].tolist())
        recorder.forget_before_all(playing)


class _EpisodeRecorder:
    """Records the current episode of each of n worlds."""

    def __init__(
        self,
        timed: TimedPolicy,
        env: EpisodeVectorEnv,
        seed: int,
        name: str,
        least_lengths: dict[int, float],
    ) -> None:
        n = env.num_envs
        self._timed, self._task, self._seed, self._name, self._least = timed, env.task, seed, name, least_lengths
        self._env_id, self._outcomes = env.spec.id if env.spec else type(env).__name__, env.outcomes
        self._numbers, self._first_step = np.zeros((2, n), dtype=np.int64)
        self._starts = np.zeros((n, 3))
        self._feasible = np.ones(n, dtype=bool)
        self._failures_before = np.zeros(n, dtype=np.int64)
        self._earned: dict[str, NDArray[np.float64]] = {}
        self._returns = np.zeros(n)
        self._decision_ms: list[NDArray[np.float64]] = []
        self._motions: list[MotionSample] = []

    def begin(self, began: NDArray[np.bool_], numbers: NDArray[np.int64], infos: Mapping[str, Any]) -> None:
        """The worlds in the mask `began` (n,) have started the episodes `numbers` (n,)."""
        self._numbers[began] = numbers[began]
        self._first_step[began] = len(self._motions)
        self._starts[began] = self._task.motion().position[began]
        self._feasible = infos.get("feasible", self._feasible)
        self._failures_before[began] = self._failures()[began]
        for sums in (self._returns, *self._earned.values()):
            sums[began] = 0.0
        for i in np.flatnonzero(began):
            if (number := int(numbers[i])) not in self._least:
                time = self._task.least_time(int(i))
                known = math.isfinite(time)
                self._least[number] = max(1.0, np.ceil(time / self._task.control_period - 1e-9)) if known else math.nan

    def step(self, decision_ms: NDArray[np.float64], rewards: NDArray[np.float64], infos: Mapping[str, Any]) -> None:
        """All worlds have made a control step."""
        self._decision_ms.append(decision_ms)
        self._motions.append(self._task.motion())
        self._returns += rewards
        self._earned = {name: self._earned.get(name, 0.0) + earned for name, earned in infos["reward_terms"].items()}

    def result(self, i: int, infos: Mapping[str, Any]) -> EpisodeResult:
        """The record of the episode that has just ended in world i."""
        decision_ms = np.array([spent[i] for spent in self._decision_ms[self._first_step[i] :]])
        motions = self._motions[self._first_step[i] :]
        failures = int(self._failures()[i] - self._failures_before[i])
        return EpisodeResult(
            self._name,
            self._env_id,
            int(self._numbers[i]),
            self._seed,
            self._outcomes[infos["outcome_id"][i]],
            None if (success := infos["is_success"][i]) is None else bool(success),
            bool(self._feasible[i]),
            float(self._returns[i]),
            {name: float(sums[i]) for name, sums in self._earned.items()},
            len(motions),
            self._least[int(self._numbers[i])],
            float(infos["tracking_error"][i]) if "tracking" in infos and infos["tracking"][i] else math.nan,
            metrics(
                self._task,
                i,
                self._starts[i],
                motions,
                decision_ms,
                failures,
                cold=bool(self._timed.cold[i]),
                slow_down=self._timed.slow_down if self._timed.setting == (1, 1) else None,
            ),
            *self._timed.setting,
            decision_ms,
        )

    def forget_before_all(self, playing: NDArray[np.bool_]) -> None:
        """Drop the steps that precede all current episodes."""
        over = min(self._first_step[playing], default=0)
        del self._decision_ms[:over], self._motions[:over]
        self._first_step -= over

    def _failures(self) -> NDArray[np.int64]:
        """(n,) number of solver failures in each world; 0 for policies that do not count them."""
        return np.broadcast_to(getattr(self._timed.policy, "failures", 0), len(self._numbers)).copy()


@contextmanager
def wrap_policy_errors(name: str, episode: int) -> Iterator[None]:
    """Turn any error inside into `PolicyFailed`, with its place."""
    try:
        yield
    except Disqualified as error:
        raise PolicyDisqualified(f"{name} is disqualified: in episode {episode}, {error}") from error
    except InvalidAction as error:
        raise PolicyFailed(f"{name} failed in episode {episode}: {error}") from error
    except FAILURES as error:
        raise PolicyFailed(f"{name} failed in episode {episode}: {described(error)}") from error


@contextmanager
def wrap_environment_errors(name: str, episode: int) -> Iterator[None]:
    """Turn an invalid action into `PolicyFailed`, and any other error inside into `EnvironmentFailed`."""
    try:
        yield
    except InvalidAction as error:
        raise PolicyFailed(f"{name} failed in episode {episode}: {error}") from error
    except (ConfigurationError, EnvironmentFailed):
        raise
    except FAILURES as error:
        raise EnvironmentFailed(f"the environment failed in episode {episode} of {name}: {described(error)}") from error


def build_policy(policy: Any, env: EpisodeVectorEnv, name: str, policy_seed: int) -> Policy:
    """Make a policy called `name` for the worlds of `env`, which nobody has reset yet: there is no episode to see.

    Raises what `make_policy` raises, and `PolicyDisqualified` if making it writes to the world.
    """
    try:
        with StateGuard(env).assert_unchanged(new_episode=True):
            return make_policy(policy, env, name=name, policy_seed=policy_seed)
    except Disqualified as error:
        raise PolicyDisqualified(f"{name} is disqualified: when it was made, {error}") from error


def check_counts(**counts: int) -> None:
    """Raise `ConfigurationError` for a number of episodes, worlds or workers that is too small or too large."""
    for name, count in counts.items():
        if not 1 <= count <= MOST[name]:
            raise ConfigurationError(f"{name} must be at least 1 and at most {MOST[name]:,}, not {count:,}")


def evaluate(
    policy: str | Path | PolicyFactory,
    env: str = DEFAULT_ENV,
    *,
    episodes: int = 200,
    seed: Seed = 0,
    worlds: int = 1,
    env_options: Mapping[str, Any] | None = None,
    least_lengths: bool = True,
    policy_seed: int | None = None,
) -> pd.DataFrame:
    """Play episodes 0 to `episodes` - 1 of `seed` with one policy; one row per episode, with `episodes.csv`'s columns.

    Without `least_lengths`, which often take longer to compute than the episodes, these and `optimality_gap` are NaN.
    The policy's own random numbers come from `policy_seed`, of up to 128 bits, or else from a new secret.

    Raises `ConfigurationError`, `AgentFileError`, `PolicyFailed` or `EnvironmentFailed`.
    """
    check_counts(episodes=episodes, worlds=worlds)
    seed = evaluation_seed(seed)
    with closing(WorldsByInterface(env, min(worlds, episodes), env_options)) as interfaces:
        made_env = interfaces.of(policy)
        made = build_policy(policy, made_env, policy_name(policy), chosen_policy_seed(policy_seed))
        known = None if least_lengths else dict.fromkeys(range(episodes), math.nan)
        played = rollouts(made, made_env, episodes, seed, policy_name(policy), known)
        return EpisodeTable(played).sorted([policy_name(policy)]).frame()
