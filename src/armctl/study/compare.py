"""Compares several policies on the same episodes."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from armctl import DEFAULT_ENV
from armctl.core.errors import ConfigurationError, ResultsError, unknown_name
from armctl.core.registration import bare_id, remember_named
from armctl.envs import ERROR, RETURN_BOUNDS, ThirdPartyVectorEnv, chosen_policy_seed, full_id, task_of
from armctl.episodes.failures import PolicyDisqualified
from armctl.episodes.record import EpisodeResult, FailedEpisode
from armctl.episodes.store import POLICY_SEED, EpisodeStore, stored_policy_seed
from armctl.episodes.table import EpisodeTable
from armctl.policies import Policy, WorldsByInterface, expanded, is_seed_group, learners, named_policies
from armctl.rollout.parallel import (
    RolloutBatch,
    Setting,
    WorkerConfig,
    check_sendable,
    failed,
    play_here,
    play_in_workers,
)
from armctl.rollout.real_time import (
    RealTime,
    check_measurable,
    check_real_time,
    check_recorded,
    real_time_of,
)
from armctl.rollout.rollouts import build_timed, check_counts, wrap_environment_errors
from armctl.rollout.seeding import seed_notes
from armctl.rollout.seeds import Seed, evaluation_seed
from armctl.runtime.engines import Engine, engine_of
from armctl.runtime.identity import identity
from armctl.runtime.provenance import RunMeter, machine, versions
from armctl.runtime.workers import WorkersFailed
from armctl.stats.intervals import Bounds
from armctl.stats.paired import MARGIN
from armctl.study.comparison import Comparison
from armctl.study.facts import Facts, PolicyFacts, judge, remove_output, write_output
from armctl.verdict.summary import training_cost_of

UNTOLD = "{env} is not made of a task of armctl's: least times, feasibility, contacts and clearances are unknown."
FACTS = (
    "policy_seed", "notes", "failures", "baseline", "margin", "real_time", "groups", "disqualified", "interrupted",
    "resumed",
)  # fmt: skip
"""What is known of a comparison before it is judged."""
ONE_TRAINING = "{group} is a single training, which says nothing of others by the same recipe."


def compare(
    policies: Any = None,
    env: str = DEFAULT_ENV,
    *,
    episodes: int = 200,
    seed: Seed = 0,
    out: str | Path | None = None,
    overwrite: bool = False,
    worlds: int = 1,
    workers: int | Engine = 1,
    env_options: Mapping[str, Any] | None = None,
    baseline: str | None = None,
    margin: float = MARGIN,
    least_lengths: dict[int, float] | None = None,
    seeding: Sequence[str] | None = None,
    real_time: str | Path | RealTime | None = None,
    slow_down: float = 1.0,
    return_bounds: Bounds | None = None,
    policy_seed: int | None = None,
    progress: Callable[[EpisodeResult], None] | None = None,
) -> Comparison:
    """Let policies play the same episodes 0 to `episodes` - 1 of `seed`; `"test"` is the sealed one.

    With `out`, every episode is written to `out/results.sqlite` as soon as it ends, and in the end all are in
    `out/episodes.csv`, and the summary in `out/summary.json`. After an interrupt (Ctrl-C) or a full disk, finished
    episodes are kept, and the same call resumes the comparison. An episode in which a policy raises an error, or
    returns an invalid action, is lost: its outcome is `error`, and the next one begins (see
    `armctl.episodes.failures`). Except for decision times, `episodes.csv` does not depend on the number of worlds and
    workers. With one world and one worker (the default), decision times are latencies, by which deadlines are judged;
    with more worlds, each is a batch's time divided by the number of worlds. The policy's construction, its resets and
    its first decision in a process have times of their own.

    With `workers`, that many processes play, each with `worlds` worlds on one core; an engine's workers play, if one
    is given (`armctl.runtime.engines.connect`). Decision times are then measured while the other processes compute.

    With `real_time`, the world does not wait: a decision that takes longer than the control period takes effect when it
    is ready (see `armctl.rollout.real_time`). It is `measured`, which needs one world and one worker, or the folder
    of a comparison with one world and one worker, whose decision times are repeated: then the episodes are the same
    whenever and wherever they are played. Each process plays one world at a time, however many `worlds` there are.
    Decisions take `slow_down` times as long as they were measured.

    Policies draw their own random numbers from a secret, the policy seed (see `armctl.envs.policy_seed`), which is in
    the summary. `policy_seed` sets it, so that another comparison draws the same; by default it is that of the folder,
    or a new one.

    `policies` is a list, or a mapping from names in the results, of any of the forms that `make_policy` takes: names,
    files, functions, classes, models; by default, it is what the task of `env` declares. `NAME[*]` is all trainings of
    a recipe as one learner (see `armctl.policies.trainings`). `least_lengths` are shared as in `rollouts`; `seeding`
    are the remarks of `seed_notes`, where these are known. `progress` is called with every finished episode, first with
    those of an earlier run.

    The verdict is about the best classical and the best learned policy, or about `baseline` against all others. Success
    that differs by less than `margin` counts as equivalent. `return_bounds`, short for the option of that name, are the
    least and largest possible return of an episode, for an environment that does not tell them: means of returns have
    intervals and tests with such bounds only.

    Raises `ConfigurationError` (also for a seed of training, see `armctl.rollout.seeds`, and for a return that is
    outside the `return_bounds`), `AgentFileError`, and
    `ResultsError` if `out` cannot be written, is damaged, or holds the results of another comparison (unless
    `overwrite`).
    """
    env, env_options = full_id(env), with_return_bounds(env_options, return_bounds)
    remember_named(env)
    if policies is None:
        policies = default_policies(env)
    asked = named_policies(policies)
    by_name, groups = expanded(asked)
    engine = engine_of(workers)
    check_counts(episodes=episodes, worlds=worlds, **({"workers": workers} if isinstance(workers, int) else {}))
    seed = evaluation_seed(seed)
    if baseline is not None and baseline not in (compared := learners(list(by_name), groups)):
        raise unknown_name("baseline among the compared policies", baseline, compared)
    if not 0 < margin < 1:
        raise ConfigurationError(f"the margin is a difference in success between 0 and 1, not {margin:g}")
    paced = real_time_of(real_time, slow_down, env, seed)
    if paced is not None:
        if paced.recorded is None:
            check_measurable(worlds, engine.workers)
        check_recorded(paced, by_name, episodes)
        worlds = 1
    stored = None if out is None or overwrite else stored_policy_seed(Path(out))
    comparison = Comparison(env, seed, env_options, EpisodeTable())
    comparison.policy_seed = secret = chosen_policy_seed(policy_seed, stored)
    comparison.baseline, comparison.margin, comparison.groups = baseline, margin, groups
    comparison.notes += [
        ONE_TRAINING.format(group=name) for name in asked if is_seed_group(asked[name]) and name not in groups
    ]
    worlds = min(worlds, episodes)
    with ExitStack() as stack:
        interfaces = WorldsByInterface(env, worlds if engine.is_local else 1, env_options)
        stack.callback(interfaces.close)
        made_env, (made, construction) = interfaces.requested, _built(comparison, by_name, interfaces, secret)
        playing = {name: policy for name, policy in by_name.items() if name in made}
        with wrap_environment_errors("a trial", 0):
            made_env.reset(seed=seed)  # raises for an invalid seed, before anything is written
        comparison.spared = {name: interfaces.spared(policy, made[name]) for name, policy in playing.items()}
        if paced is not None:
            check_real_time(bare_id(env), made_env)
            comparison.real_time = {"latency": paced.latency, "slow_down": paced.slow_down}
            comparison.notes.append(paced.in_words(made_env.task.control_period))
        if not engine.is_local:
            check_sendable(playing)
        comparison.notes += seed_notes(env, env_options) if seeding is None else seeding
        if isinstance(made_env, ThirdPartyVectorEnv):
            comparison.notes.append(UNTOLD.format(env=bare_id(env)))
        own: Mapping[str, Any] = {"env": env, "seed": seed, "policies": list(by_name)}
        if out is not None:
            late = None if paced is None else paced.identity(by_name)
            own = identity(env, comparison.env_options, seed, by_name, made, made_env, late)
            own = {**own, POLICY_SEED: str(secret)}
        meter, folder = RunMeter(own, worlds, engine.workers), None if out is None else Path(out)
        log = stack.enter_context(EpisodeStore(folder, own, episodes, overwrite, meter.run))
        if folder is not None:
            remove_output(folder)
        results = log.kept
        if progress is not None:
            for result in results:
                progress(result)
        comparison.resumed = len(results)
        finished = {name: its.column("episode") for name, its in results.by_policy().items()}
        waiting = {name: np.setdiff1d(np.arange(episodes), finished.get(name, [])).tolist() for name in made}
        least = {} if least_lengths is None else least_lengths
        least.update(zip(*(results.column(name).tolist() for name in ("episode", "least_length")), strict=True))
        if engine.is_local:
            played_in = {name: interfaces.of(policy) for name, policy in playing.items()}
            stream = play_here(made, played_in, seed, waiting, least, paced, set(finished))
        else:
            config = WorkerConfig(env, worlds, comparison.env_options, seed, secret, engine.workers)
            setting = Setting(config, playing)
            stream = play_in_workers(setting, made, interfaces, waiting, least, engine, paced, set(finished))
        crashes: dict[str, FailedEpisode] = {}
        in_workers: dict[str, float] = {}
        try:
            with closing(stream):
                for played in stream:
                    _note_failures(comparison, played)
                    for failed in (one for one in played.results if isinstance(one, FailedEpisode)):
                        crashes[failed.policy] = min(crashes.get(failed.policy, failed), failed, key=_number)
                    if (spent := played.construction_ms) is not None:
                        in_workers[played.policy] = max(spent, in_workers.get(played.policy, 0.0))
                    meter.update_load()
                    for result in (replace(one, run=meter.run.id) for one in played.results):
                        _check_return(result, made_env.stated_return_bounds)
                        log.write(result)
                        if progress is not None:
                            progress(result)
        except WorkersFailed as failure:
            comparison.failures["workers"] = str(failure)
        except KeyboardInterrupt:
            comparison.interrupted = True
        results = log.episodes()
        results = results[~np.isin(results.column("policy"), comparison.disqualified)].sorted(list(made))
        _note_crashes(comparison, results, crashes)
        judged = min(map(len, results.by_policy().values()), default=0)
        runs = [*log.runs, meter.finished(judged, baseline, margin)]
        comparison.results = results
        spent_ms = construction | in_workers
        facts = Facts(
            env_options={name: str(value) for name, value in env_options.items()},
            planned=episodes,
            policies={
                name: PolicyFacts(
                    policy.sees, training_cost_of(policy), spent_ms[name], tuple(comparison.spared.get(name, ()))
                )
                for name, policy in made.items()
            },
            return_bounds=made_env.return_bounds,
            time_limit=made_env.max_episode_steps,
            control_period=made_env.task.control_period,
            versions=versions(),
            machine=machine(),
            **{name: getattr(comparison, name) for name in FACTS},
        )
        judge(comparison, facts, runs)
        if folder is not None:
            try:
                runs = log.finish(asdict(facts), runs, comparison.disqualified)
                write_output(folder, comparison, results, log.identity, runs)
            except ResultsError as error:
                comparison.failures["results"] = str(error)
    return comparison


def _built(
    comparison: Comparison, by_name: Mapping[str, Any], interfaces: WorldsByInterface, policy_seed: int
) -> tuple[dict[str, Policy], dict[str, float]]:
    """The policies, made before anything is reset, and how long that took, ms; without any that write to the world."""
    made, construction = dict[str, Policy](), dict[str, float]()
    for name, policy in by_name.items():
        try:
            made[name], construction[name] = build_timed(policy, interfaces.of(policy), name, policy_seed)
        except PolicyDisqualified as failure:
            _note_failures(comparison, failed(name, [], failure))
    return made, construction


def _note_failures(comparison: Comparison, played: RolloutBatch) -> None:
    if played.failure:
        comparison.failures[played.policy] = played.failure
        comparison.tracebacks[played.policy] = played.traceback
    if played.disqualified:
        comparison.disqualified.append(played.policy)


def _number(result: EpisodeResult) -> int:
    return result.episode


def _note_crashes(comparison: Comparison, results: EpisodeTable, crashes: Mapping[str, FailedEpisode]) -> None:
    """Say in how many episodes each policy failed, and why in the first that was played now."""
    for name, played in results.by_policy().items():
        episodes = played.column("episode")[played.column("outcome") == ERROR]
        if not len(episodes):
            continue
        crash = crashes.get(name)
        first = (
            f"the first is episode {episodes.min()}" if crash is None else f"episode {crash.episode}: {crash.message}"
        )
        said = (
            f"{name} raised an error, or returned an invalid action, in {len(episodes)} of {len(played)} episodes, "
            f"which count as failures; {first}"
        )
        comparison.failures[name] = "; ".join(filter(None, (comparison.failures.get(name), said)))
        if crash is not None:
            comparison.tracebacks.setdefault(name, crash.traceback)


def with_return_bounds(env_options: Mapping[str, Any] | None, bounds: Bounds | None) -> dict[str, Any]:
    """The options of an environment, with the bounds of its returns if they are stated."""
    return dict(env_options or {}) | ({} if bounds is None else {RETURN_BOUNDS: bounds})


def _check_return(result: EpisodeResult, bounds: Bounds | None) -> None:
    """Raise `ConfigurationError` for a return beyond the stated bounds, by more than what sums are rounded by."""
    if bounds is None or result.outcome == ERROR:
        return
    rounding = 1e-9 * max(map(abs, bounds))
    if not bounds[0] - rounding <= result.total_reward <= bounds[1] + rounding:
        raise ConfigurationError(
            f"episode {result.episode} of {result.policy} has the return {result.total_reward:g}, outside the stated "
            f"{RETURN_BOUNDS} [{bounds[0]:g}, {bounds[1]:g}]: state bounds that hold for every possible episode"
        )


def default_policies(env: str) -> tuple[str, ...]:
    """The default line-up of an environment, which its task declares."""
    policies: tuple[str, ...] = task_of(env).default_policies
    return policies
