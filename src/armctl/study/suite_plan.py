"""Plan of a suite: the cells of several tasks, and the policies that fit each."""

from collections.abc import Sequence
from typing import Any

from armctl.core.errors import ArmctlError, ConfigurationError
from armctl.core.registration import bare_id, environment_names
from armctl.core.seeds import Seed, evaluation_seed
from armctl.envs import full_id
from armctl.policies import named_policies
from armctl.study.line_up import FULL, QUICK, fitting, line_up, main_disturbances, unusable_agents
from armctl.study.names import SUITE, task_name
from armctl.study.options import StudyOptions, TaskOptions, checked_options
from armctl.study.plan import Plan, TaskPlan, extent, task_plan, undisturbed_cell

ALL = "all"
"""Name for all environments of all installed packages."""


def suite_plan(
    envs: Sequence[str],
    quick: bool,
    episodes: int | None,
    seed: Seed,
    options: StudyOptions,
    policies: Any = (),
) -> Plan:
    """Plan the cells of several tasks, with further `policies` where they fit.

    Without a number of `episodes`, a cell stops when it is decided, or after those of the suite's size. A task that
    cannot be played is among the failures. Raises `ConfigurationError`.
    """
    checked_options(options, StudyOptions)
    size = QUICK if quick else FULL
    undisturbed_episodes = None
    if episodes is None:
        episodes, undisturbed_episodes = size.episodes, size.undisturbed_episodes
        options = {**options, "until": options.get("until") or "decided"}
    shared = extent(episodes, evaluation_seed(seed), options)
    requested = [name for env in envs for name in (environment_names() if env == ALL else [env])]
    by_name = {task_name(env): env for env in dict.fromkeys(map(full_id, requested))}
    if not by_name or len(by_name) < len(set(map(full_id, requested))):
        raise ConfigurationError(f"a suite needs environments of different names, not {', '.join(requested) or 'none'}")
    further = named_policies(policies) if policies else {}
    tasks: list[TaskPlan] = []
    failures, misfits = dict[str, str](), dict[str, dict[str, str]]()
    for name, env in by_name.items():
        try:
            filtered: TaskOptions = {"filter": options.get("filter", False)}
            usual = {policy: policy for policy in line_up(env, size.one_of_each_kind)}
            usable, misfits[env] = fitting(further, env, options)
            undisturbed = undisturbed_cell(usual | usable, env, filtered)
            tasks.append(task_plan(undisturbed, main_disturbances(env, size), None, f"{name}/", shared))
            unusable = unusable_agents(env)
        except ArmctlError as error:
            failures[env] = str(error)
            continue
        if unusable:
            failures[env] = "; ".join(f"{agent} was left out: {why}" for agent, why in unusable.items())
    for name in further:
        if tasks and all(name in misfits[task.env] for task in tasks):
            why = misfits[tasks[0].env][name]
            raise ConfigurationError(f"{name} fits none of the tasks: in {bare_id(tasks[0].env)}, {why}")
    return Plan(
        SUITE, tasks, **shared, undisturbed_episodes=undisturbed_episodes, quick=quick, envs=[*by_name.values()],
        failures=failures, misfits=misfits,
    )  # fmt: skip
