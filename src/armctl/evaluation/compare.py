"""Several policies on the very same episodes."""

import itertools
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from armctl.errors import ConfigurationError, ResultsError
from armctl.evaluation.report import EpisodeLog, write_summary
from armctl.evaluation.rollouts import COLUMNS, EpisodeResult, PolicyFailed, make_worlds, rollouts
from armctl.evaluation.statistics import Estimate, PairedDifference, mean, paired_difference, success_rate
from armctl.policies import make_policy

DEFAULT_POLICIES = ("reach_ik", "reach_ppo", "random")
DEFAULT_ENV = "armctl/ArmReach-v0"


@dataclass(frozen=True)
class PolicySummary:
    """One policy over all its episodes."""

    policy: str
    sees: str
    training_steps: int
    episodes: int
    infeasible: int
    """Episodes that no policy can win, left out of the success rate."""
    successes: int
    success: Estimate | None
    episode_return: Estimate | None
    steps_to_goal: Estimate | None
    """Over successful episodes."""
    decision_ms_p50: float
    decision_ms_p99: float


@dataclass
class Comparison:
    """What a comparison found; with an interrupt or a failure, as far as it came."""

    env: str
    seed: int
    env_options: Mapping[str, Any]
    episodes: pd.DataFrame
    """A row for each policy and episode: the columns of `episodes.csv`."""
    policies: list[PolicySummary] = field(default_factory=list)
    paired: list[PairedDifference] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)
    """What went wrong, by policy, or under `results` for what could not be written."""
    interrupted: bool = False


class Progress(Protocol):
    """Is told of every finished episode."""

    def __call__(self, result: EpisodeResult) -> None: ...  # noqa: D102


def compare(
    policies: Sequence[str] = DEFAULT_POLICIES,
    env: str = DEFAULT_ENV,
    *,
    episodes: int = 200,
    seed: int = 0,
    out: str | Path | None = None,
    overwrite: bool = False,
    worlds: int = 1,
    env_options: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Let policies meet the same episodes 0 to `episodes` - 1 of `seed`.

    With `out`, every finished episode goes to `out/episodes.csv` at once, and the rest to `out/summary.json`. An
    interrupt (Ctrl-C), a failing policy or a full disk loses nothing that was finished. With one world (the default)
    decision times are latencies; with more they are shares of a batch.

    Raises `ConfigurationError`, `AgentFileError`, and `ResultsError` if `out` cannot be written or holds results.
    """
    names = list(policies)
    if len(set(names)) != len(names) or not names:
        raise ConfigurationError(f"a comparison needs policies, each once, not {names}")
    if episodes < 1 or worlds < 1 or seed < 0:
        raise ConfigurationError(f"episodes and worlds count from 1 and seeds from 0, not {episodes}, {worlds}, {seed}")
    made_env = make_worlds(env, min(worlds, episodes), env_options)
    made = {name: make_policy(name, made_env) for name in names}
    comparison = Comparison(env, seed, dict(env_options or {}), pd.DataFrame(columns=list(COLUMNS)))
    results: list[EpisodeResult] = []
    with ExitStack() as stack:
        stack.callback(made_env.close)
        log = stack.enter_context(EpisodeLog(Path(out), overwrite)) if out is not None else None
        try:
            for name, policy in made.items():
                try:
                    for result in rollouts(policy, made_env, episodes, seed, name):
                        results.append(result)
                        if log is not None:
                            try:
                                log.write(result.row())
                            except ResultsError as error:
                                comparison.failures["results"], log = str(error), None
                        if progress is not None:
                            progress(result)
                except PolicyFailed as failure:
                    comparison.failures[name] = str(failure)
        except KeyboardInterrupt:
            comparison.interrupted = True
    if results:
        comparison.episodes = pd.DataFrame([result.row() for result in results])
        comparison.policies = [
            _summary(name, policy.sees, policy.training_steps, [r for r in results if r.policy == name])
            for name, policy in made.items()
            if any(r.policy == name for r in results)
        ]
        comparison.paired = _paired(comparison.episodes, [summary.policy for summary in comparison.policies])
    if out is not None:
        try:
            write_summary(Path(out), comparison)
        except ResultsError as error:
            comparison.failures["results"] = str(error)
    return comparison


def _summary(name: str, sees: str, training_steps: int, results: list[EpisodeResult]) -> PolicySummary:
    feasible = np.array([result.feasible for result in results])
    success = np.array([result.success for result in results])
    decisions = np.concatenate([result.decision_ms for result in results])
    return PolicySummary(
        name,
        sees,
        training_steps,
        len(results),
        int((~feasible & ~success).sum()),
        int(success.sum()),
        success_rate(success[feasible | success]),
        mean(np.array([result.total_reward for result in results])),
        mean(np.array([float(result.length) for result in results if result.success])),
        float(np.quantile(decisions, 0.5)),
        float(np.quantile(decisions, 0.99)),
    )


def _paired(episodes: pd.DataFrame, names: list[str]) -> list[PairedDifference]:
    differences = []
    for a, b in itertools.combinations(names, 2):
        pair = episodes[episodes.policy == a].merge(episodes[episodes.policy == b], on="episode", suffixes=("_a", "_b"))
        if len(pair):
            differences.append(
                paired_difference(
                    a,
                    b,
                    _columns(pair, "success", bool),
                    _columns(pair, "return", float),
                    _columns(pair, "length", float),
                )
            )
    return differences


def _columns(pair: pd.DataFrame, name: str, dtype: type[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    return pair[f"{name}_a"].to_numpy(dtype), pair[f"{name}_b"].to_numpy(dtype)
