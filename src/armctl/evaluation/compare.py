"""Several policies on the very same episodes."""

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from armctl import DEFAULT_ENV, DEFAULT_POLICIES
from armctl.errors import ConfigurationError, ResultsError, unknown_name
from armctl.evaluation.report import EpisodeLog, write_summary
from armctl.evaluation.rollouts import COLUMNS, EpisodeResult, PolicyFailed, make_worlds, rollouts
from armctl.evaluation.statistics import Estimate, PairedDifference, mean, median, paired_difference, success_rate
from armctl.policies import Policy, PolicyFactory, make_policy, policy_name


@dataclass(frozen=True)
class PolicySummary:
    """One policy over all its episodes."""

    policy: str
    sees: str
    training_steps: int
    planned: int
    """Episodes that were to be played."""
    episodes: int
    """Episodes that the figures are over: played, without a gap from the first on, and feasible."""
    infeasible: int
    """Episodes with a target out of reach, that no policy won: left out of all figures."""
    outcomes: dict[str, int]
    """How the episodes ended, most frequent first."""
    success: Estimate | None
    episode_return: Estimate | None
    steps_to_goal: Estimate | None
    """Over successful episodes."""
    optimality_gap: Estimate | None
    """Median part by which successful episodes took longer than the fastest possible ones, where those are known."""
    tracking_error: Estimate | None
    """m, mean distance to a moving target once it was met."""
    decision_ms_p50: float
    decision_ms_p99: float
    solver_failures: int
    """Decisions for which a controller's solver found nothing, as far as it counts them."""


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


def compare(
    policies: Sequence[str | PolicyFactory] | None = None,
    env: str = DEFAULT_ENV,
    *,
    episodes: int = 200,
    seed: int = 0,
    out: str | Path | None = None,
    overwrite: bool = False,
    worlds: int = 1,
    env_options: Mapping[str, Any] | None = None,
    progress: Callable[[EpisodeResult], None] | None = None,
) -> Comparison:
    """Let policies meet the same episodes 0 to `episodes` - 1 of `seed`.

    With `out`, every finished episode goes to `out/episodes.csv` at once, and the rest to `out/summary.json`. An
    interrupt (Ctrl-C), a failing policy or a full disk loses nothing that was finished. With one world (the default)
    decision times are latencies; with more they are shares of a batch.

    Policies are names, agents' files, `module:function`, or functions (see `make_policy`), and without any, those that
    `armctl.DEFAULT_POLICIES` has for `env`. `progress` is told of every
    finished episode.

    Raises `ConfigurationError`, `AgentFileError`, and `ResultsError` if `out` cannot be written or holds results.
    """
    if policies is None:
        policies = default_policies(env)
    by_name = {policy_name(policy): policy for policy in ([policies] if isinstance(policies, str) else policies)}
    if not by_name or (not isinstance(policies, str) and len(by_name) != len(policies)):
        raise ConfigurationError(f"a comparison needs policies, each once, not {policies}")
    if episodes < 1 or worlds < 1:
        raise ConfigurationError(f"episodes and worlds count from 1, not {episodes} and {worlds}")
    comparison = Comparison(env, seed, dict(env_options or {}), pd.DataFrame(columns=list(COLUMNS)))
    results: list[EpisodeResult] = []
    least_lengths: dict[int, float] = {}
    with ExitStack() as stack:
        made_env = make_worlds(env, min(worlds, episodes), env_options)
        stack.callback(made_env.close)
        made_env.reset(seed=seed)  # an unusable seed is to be found before anything is written
        made = {name: make_policy(policy, made_env) for name, policy in by_name.items()}
        log = stack.enter_context(EpisodeLog(Path(out), overwrite)) if out is not None else None
        try:
            for name, policy in made.items():
                try:
                    for result in rollouts(policy, made_env, episodes, seed, name, least_lengths):
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
        counted, infeasible = _counted(results)
        comparison.policies = [
            _summary(name, policy, episodes, infeasible, counted[name])
            for name, policy in made.items()
            if counted.get(name)
        ]
        comparison.paired = _paired(counted)
    if out is not None:
        try:
            write_summary(Path(out), comparison)
        except ResultsError as error:
            comparison.failures["results"] = str(error)
    return comparison


def default_policies(env: str) -> tuple[str, ...]:
    """The policies that meet in an environment unless others are asked for."""
    if env not in DEFAULT_POLICIES:
        raise unknown_name("environment with policies of its own", env, DEFAULT_POLICIES)
    return DEFAULT_POLICIES[env]


def _counted(results: list[EpisodeResult]) -> tuple[dict[str, list[EpisodeResult]], int]:
    """The results that figures are over, by policy and episode, and the number of infeasible episodes left out.

    Of a policy that was cut short, those from the first episode to the first gap: with many worlds, short episodes end
    first, and to count them alone would favour it.
    """
    won = {result.episode for result in results if result.success}
    infeasible = {result.episode for result in results if not result.feasible} - won
    counted = {}
    for name, played in itertools.groupby(results, key=lambda result: result.policy):
        in_order = sorted(played, key=lambda result: result.episode)
        unbroken = itertools.takewhile(lambda pair: pair[0] == pair[1].episode, enumerate(in_order))
        counted[name] = [result for _, result in unbroken if result.episode not in infeasible]
    return counted, len(infeasible)


def _summary(name: str, policy: Policy, planned: int, infeasible: int, results: list[EpisodeResult]) -> PolicySummary:
    decisions = np.concatenate([result.decision_ms for result in results])
    return PolicySummary(
        name,
        policy.sees,
        policy.training_steps,
        planned,
        len(results),
        infeasible,
        dict(Counter(result.outcome for result in results).most_common()),
        success_rate(np.array([result.success for result in results])),
        mean(np.array([result.total_reward for result in results])),
        mean(np.array([float(result.length) for result in results if result.success])),
        median(_known(result.optimality_gap for result in results)),
        mean(_known(result.tracking_error for result in results)),
        float(np.quantile(decisions, 0.5)),
        float(np.quantile(decisions, 0.99)),
        getattr(policy, "failures", 0),
    )


def _known(values: Iterable[float]) -> NDArray[np.float64]:
    return np.array([value for value in values if not np.isnan(value)])


def _paired(counted: dict[str, list[EpisodeResult]]) -> list[PairedDifference]:
    return [
        paired_difference(
            a,
            b,
            _both(counted[a], counted[b], lambda result: result.success),
            _both(counted[a], counted[b], lambda result: result.total_reward),
            _both(counted[a], counted[b], lambda result: float(result.length)),
        )
        for a, b in itertools.combinations(counted, 2)
        if counted[a] and counted[b]
    ]


def _both(
    a: list[EpisodeResult], b: list[EpisodeResult], value: Callable[[EpisodeResult], float]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """A value of the episodes that both played: the first ones, since neither has gaps."""
    pairs = list(zip(a, b, strict=False))
    return np.array([value(first) for first, _ in pairs]), np.array([value(second) for _, second in pairs])
