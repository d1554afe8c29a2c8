"""Several policies on the very same episodes."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pandas as pd

from armctl import DEFAULT_ENV
from armctl.agents import OnnxPolicy
from armctl.envs import make_worlds, task_of
from armctl.errors import ConfigurationError, ResultsError
from armctl.evaluation.comparison import Comparison, write_summary
from armctl.evaluation.parallel import WorkerConfig, WorkersFailed, check_sendable, play_here, play_in_workers
from armctl.evaluation.provenance import versions
from armctl.evaluation.record import COLUMNS, EpisodeResult
from armctl.evaluation.store import EpisodeLog
from armctl.evaluation.summary import summarised
from armctl.policies import Policy, PolicyFactory, make_policy, policy_name


def compare(
    policies: Sequence[str | PolicyFactory] | None = None,
    env: str = DEFAULT_ENV,
    *,
    episodes: int = 200,
    seed: int = 0,
    out: str | Path | None = None,
    overwrite: bool = False,
    worlds: int = 1,
    workers: int = 1,
    env_options: Mapping[str, Any] | None = None,
    least_lengths: dict[int, float] | None = None,
    progress: Callable[[EpisodeResult], None] | None = None,
) -> Comparison:
    """Let policies meet the same episodes 0 to `episodes` - 1 of `seed`.

    With `out`, every finished episode goes to `out/episodes.csv` at once, and the rest to `out/summary.json`. An
    interrupt (Ctrl-C), a failing policy or a full disk loses nothing that was finished, and the same comparison goes on
    from there. But for decision times, `episodes.csv` is the same with any number of worlds and workers. With one world
    (the default) decision times are latencies; with more they are shares of a batch.

    With `workers`, policies and episodes are played in so many processes, each with `worlds` worlds on one core. What
    policies decide is then timed while the others compute beside them.

    Policies are names, agents' files, `module:function`, or functions (see `make_policy`), and without any, those that
    `armctl.DEFAULT_POLICIES` has for `env`. `least_lengths` are shared as in `rollouts`. `progress` is told of every
    finished episode, first of an earlier run's.

    Raises `ConfigurationError`, `AgentFileError`, and `ResultsError` if `out` cannot be written, is damaged, or holds
    the results of another comparison and these are not to be overwritten.
    """
    if policies is None:
        policies = default_policies(env)
    by_name = {policy_name(policy): policy for policy in ([policies] if isinstance(policies, str) else policies)}
    if not by_name or (not isinstance(policies, str) and len(by_name) != len(policies)):
        raise ConfigurationError(f"a comparison needs policies, each once, not {policies}")
    if episodes < 1 or worlds < 1 or workers < 1:
        raise ConfigurationError(f"episodes, worlds and workers count from 1, not {episodes}, {worlds} and {workers}")
    comparison = Comparison(env, seed, dict(env_options or {}), pd.DataFrame(columns=list(COLUMNS)))
    worlds = min(worlds, episodes)
    results: list[EpisodeResult] = []
    with ExitStack() as stack:
        made_env = make_worlds(env, worlds if workers == 1 else 1, env_options)
        stack.callback(made_env.close)
        made_env.reset(seed=seed)  # an unusable seed is to be found before anything is written
        made = {name: make_policy(policy, made_env) for name, policy in by_name.items()}
        if workers > 1:
            check_sendable(by_name)
        log: EpisodeLog | None = None
        if out is not None:
            log = stack.enter_context(EpisodeLog(Path(out), _identity(comparison, made), episodes, overwrite))
            results += log.kept
        comparison.resumed = len(results)
        for result in results:
            if progress is not None:
                progress(result)
        finished = {(result.policy, result.episode) for result in results}
        waiting = {name: [k for k in range(episodes) if (name, k) not in finished] for name in made}
        least = {} if least_lengths is None else least_lengths
        least.update((result.episode, result.least_length) for result in results)
        if workers == 1:
            stream = play_here(made, made_env, seed, waiting, least)
        else:
            setting = WorkerConfig(env, worlds, comparison.env_options, seed)
            stream = play_in_workers(by_name, setting, waiting, least, workers)
        try:
            with closing(stream):
                for played in stream:
                    if played.failure:
                        comparison.failures[played.policy] = played.failure
                    for result in played.results:
                        results.append(result)
                        if log is not None:
                            try:
                                log.write(result)
                            except ResultsError as error:
                                comparison.failures["results"], log = str(error), None
                        if progress is not None:
                            progress(result)
        except WorkersFailed as failure:
            comparison.failures["workers"] = str(failure)
        except KeyboardInterrupt:
            comparison.interrupted = True
        order = list(made)
        results.sort(key=lambda result: (order.index(result.policy), result.episode))
        if log is not None:
            try:
                log.rewrite(results)
            except ResultsError as error:
                comparison.failures["results"] = str(error)
    if results:
        comparison.episodes = pd.DataFrame([result.row() for result in results])
        comparison.policies, comparison.paired = summarised(results, made, episodes)
    if out is not None:
        try:
            write_summary(Path(out), comparison)
        except ResultsError as error:
            comparison.failures["results"] = str(error)
    return comparison


def default_policies(env: str) -> tuple[str, ...]:
    """The default line-up of an environment: what its task declares."""
    return task_of(env).default_policies


def _identity(comparison: Comparison, policies: Mapping[str, Policy]) -> dict[str, Any]:
    """What decides a comparison's episodes, as JSON has it: with another, they are others."""
    agents = {name: policy.card.sha256 for name, policy in policies.items() if isinstance(policy, OnnxPolicy)}
    return {
        "env": comparison.env,
        "env_options": {name: str(value) for name, value in comparison.env_options.items()},
        "seed": comparison.seed,
        "policies": list(policies),
        "agents": agents,
        "versions": versions(),
    }
