"""Episodes of one policy, one result each."""

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, get_type_hints

import gymnasium
import numpy as np
import pandas as pd
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from armctl import DEFAULT_ENV
from armctl.envs import TaskVectorEnv
from armctl.errors import ArmctlError, ConfigurationError, InvalidAction
from armctl.evaluation.metrics import Metrics, control_period, metrics
from armctl.policies import Policy, PolicyFactory, look_where_called, make_policy, policy_name
from armctl.tasks.task import Motion

COLUMNS = (
    "policy", "env", "episode", "seed", "outcome", "success", "feasible", "return", "reward_terms", "length",
    "least_length", "optimality_gap", "tracking_error", *(field.name for field in fields(Metrics)),
)  # fmt: skip
TIME_COLUMNS = ("missed_deadlines", "decision_ms_p50", "decision_ms_p99", "decision_ms_max")
"""Those that a machine has a say in: all others are the same wherever, and however often, an episode is played."""


class PolicyFailed(ArmctlError):
    """A policy raised an error, or gave an action that the environment refused."""


@dataclass(frozen=True)
class EpisodeResult:
    """How one episode went. `env.reset(seed=seed, options={"episode": episode})` plays it again."""

    policy: str
    env: str
    episode: int
    seed: int
    outcome: str
    success: bool
    feasible: bool
    total_reward: float
    reward_terms: dict[str, float]
    """What each term of the reward has brought; the return is their sum."""
    length: int
    least_length: float
    """Decisions that no policy could do with less of; NaN where that is not known (see `Task.least_time`)."""
    tracking_error: float
    """m, mean distance to a moving target since it was first met; NaN where there is none."""
    metrics: Metrics
    decision_ms: NDArray[np.float64]
    """(length,) wall time of each decision, to 0.1 us."""

    @property
    def optimality_gap(self) -> float:
        """Part by which the episode took longer than the fastest possible one; NaN unless it was a success."""
        return self.length / self.least_length - 1 if self.success else math.nan

    def row(self) -> dict[str, Any]:
        """The episode as a row of `episodes.csv`."""
        values = (
            self.policy, self.env, self.episode, self.seed, self.outcome, self.success, self.feasible,
            self.total_reward, json.dumps(self.reward_terms), self.length, self.least_length, self.optimality_gap,
            self.tracking_error,
            *asdict(self.metrics).values(),
        )  # fmt: skip
        return dict(zip(COLUMNS, values, strict=True))

    @classmethod
    def from_row(cls, row: Mapping[str, str], decision_ms: NDArray[np.float64]) -> "EpisodeResult":
        """The episode of a row of `episodes.csv`, as text; raises `KeyError` or `ValueError` for what is none."""
        named = {**row, "total_reward": row["return"]}

        def read(kind: type[Any], left_out: tuple[str, ...] = ()) -> dict[str, Any]:
            types = get_type_hints(kind)
            return {name: _READERS[types[name]](named[name]) for name in types if name not in left_out}

        return cls(**read(cls, ("metrics", "decision_ms")), metrics=Metrics(**read(Metrics)), decision_ms=decision_ms)


_READERS: Mapping[type[Any], Callable[[str], Any]] = {
    str: str,
    int: int,
    float: float,
    bool: {"True": True, "False": False}.__getitem__,
    dict[str, float]: lambda text: {name: float(term) for name, term in dict(json.loads(text)).items()},
}
"""From text, by type."""


def make_worlds(env: str, worlds: int, options: Mapping[str, Any] | None = None, threads: int = 0) -> TaskVectorEnv:
    """`worlds` worlds of an environment, that stand still after an episode, stepped on `threads` (0: all cores).

    `module:armctl/Name-v0` is an environment that the module registers. Raises `ConfigurationError`.
    """
    if reserved := {"num_envs", "autoreset_mode", "render_mode", "threads"} & set(options or {}):
        raise ConfigurationError(f"{reserved.pop()} is no option to set here: evaluation has its own")
    module, _, name = env.rpartition(":")
    if (module or name in gymnasium.registry) and not name.startswith("armctl/"):
        raise ConfigurationError(f"{env} is not one of armctl's environments: {', '.join(environment_names())}")
    look_where_called()
    try:
        made = gymnasium.make_vec(
            env, num_envs=worlds, autoreset_mode=AutoresetMode.DISABLED, threads=threads, **(options or {})
        )
    except (gymnasium.error.Error, ModuleNotFoundError) as error:
        raise ConfigurationError(
            f"no environment {env!r}: {error} There are: {', '.join(environment_names())}"
        ) from error
    assert isinstance(made, TaskVectorEnv)
    return made


def environment_names() -> list[str]:
    """The environments that armctl has registered."""
    return sorted(name for name in gymnasium.registry if name.startswith("armctl/"))


def rollouts(
    policy: Policy,
    env: TaskVectorEnv,
    episodes: int | Sequence[int],
    seed: int,
    name: str = "policy",
    least_lengths: dict[int, float] | None = None,
) -> Iterator[EpisodeResult]:
    """Play so many `episodes` of `seed`, or those of these numbers, in the worlds of `env`; yield each as it ends.

    `least_lengths`, by episode, are taken from there and put there, so that policies can share them.

    A decision's time is that of the policy's call divided by the number of worlds it decided for.
    Raises `PolicyFailed` if the policy fails.
    """
    n = env.num_envs
    episodes = range(episodes) if isinstance(episodes, int) else episodes
    mask = np.arange(n) < len(episodes)
    numbers = np.array([*episodes[:n], *[0] * (n - len(episodes))])
    waiting = iter(episodes[n:])
    observations, details = env.reset(seed=[seed] * n, options={"episode": numbers})
    feasible = details.get("feasible", np.ones(n, dtype=bool))
    least = {} if least_lengths is None else least_lengths
    _add_least_lengths(least, env, numbers, mask)
    starts, failures = env.task.motion().position, _failures(policy, n)
    with blaming(name, numbers[0]):
        policy.reset(np.arange(n, dtype=np.int32))
    returns = np.zeros(n)
    earned: dict[str, NDArray[np.float64]] = {}
    times: list[float] = []
    motions: list[Motion] = []
    began = np.zeros(n, dtype=np.int64)
    spec = env.spec.id if env.spec else type(env).__name__
    while mask.any():
        start = time.perf_counter()
        with blaming(name, numbers[mask][0]):
            actions = policy.act(observations)
        times.append(1e3 * (time.perf_counter() - start) / n)
        with blaming(name, numbers[mask][0]):
            observations, rewards, terminated, truncated, infos = env.step(actions)
        returns += rewards
        earned = {term: earned.get(term, 0.0) + reward for term, reward in infos["reward_terms"].items()}
        motions.append(env.task.motion())
        ended = np.flatnonzero((terminated | truncated) & mask)
        if not len(ended):
            continue
        failed = _failures(policy, n)
        for i in ended:
            decision_ms, moved = np.round(times[began[i] :], 4), motions[began[i] :]
            measured = metrics(env.task, int(i), starts[i], moved, decision_ms, int(failed[i] - failures[i]))
            yield EpisodeResult(
                name, spec, int(numbers[i]), seed, str(infos["outcome"][i]), bool(infos["is_success"][i]),
                bool(feasible[i]), float(returns[i]), {term: float(sums[i]) for term, sums in earned.items()},
                len(moved), least[int(numbers[i])],
                float(infos["tracking_error"][i]) if "tracking_error" in infos else math.nan,
                measured, decision_ms,
            )  # fmt: skip
            returns[i], began[i], numbers[i] = 0.0, len(times), next(waiting, -1)
            for sums in earned.values():
                sums[i] = 0.0
        again = np.zeros(n, dtype=bool)
        again[ended] = numbers[ended] >= 0
        mask[ended] = again[ended]
        if again.any():
            observations, details = env.reset(options={"reset_mask": again, "episode": np.maximum(numbers, 0)})
            feasible = details.get("feasible", feasible)
            _add_least_lengths(least, env, numbers, again)
            starts[again], failures[again] = env.task.motion().position[again], failed[again]
            with blaming(name, numbers[again][0]):
                policy.reset(np.flatnonzero(again).astype(np.int32))
        over = min(began[mask], default=0)
        del times[:over], motions[:over]
        began -= over


def _add_least_lengths(
    least: dict[int, float], env: TaskVectorEnv, numbers: NDArray[np.int64], began: NDArray[np.bool_]
) -> None:
    """Add the episodes that have just begun."""
    period = control_period(env.task)
    for i in np.flatnonzero(began):
        if (number := int(numbers[i])) not in least:
            time = env.task.least_time(int(i))
            least[number] = max(1.0, np.ceil(time / period - 1e-9)) if math.isfinite(time) else math.nan


def _failures(policy: Policy, n: int) -> NDArray[np.int64]:
    """(n,) how often a controller's solver has failed in each world; 0 for policies that count nothing."""
    return np.broadcast_to(getattr(policy, "failures", 0), n).copy()


@contextmanager
def blaming(name: str, episode: int) -> Iterator[None]:
    """Turn whatever goes wrong inside into `PolicyFailed`."""
    try:
        yield
    except InvalidAction as error:
        raise PolicyFailed(f"{name} failed in episode {episode}: {error}") from error
    except Exception as error:
        raise PolicyFailed(f"{name} failed in episode {episode}: {type(error).__name__}: {error}") from error


def evaluate(
    policy: str | Path | PolicyFactory,
    env: str = DEFAULT_ENV,
    *,
    episodes: int = 200,
    seed: int = 0,
    worlds: int = 1,
    env_options: Mapping[str, Any] | None = None,
    least_lengths: bool = True,
) -> pd.DataFrame:
    """Play `episodes` episodes with one policy; a row for each, with the columns of `episodes.csv`.

    Without `least_lengths`, whose search takes longer than many a policy, these and `optimality_gap` are NaN.

    Raises `ConfigurationError`, `AgentFileError` or `PolicyFailed`.
    """
    if episodes < 1 or worlds < 1:
        raise ConfigurationError(f"episodes and worlds count from 1, not {episodes} and {worlds}")
    with closing(make_worlds(env, min(worlds, episodes), env_options)) as made_env:
        made = make_policy(policy, made_env)
        known = None if least_lengths else dict.fromkeys(range(episodes), math.nan)
        played = rollouts(made, made_env, episodes, seed, policy_name(policy), known)
        rows = [result.row() for result in played]
    return pd.DataFrame(rows, columns=list(COLUMNS)).sort_values("episode", ignore_index=True)
