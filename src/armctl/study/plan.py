"""Plan of a study: policies times cells, checked before anything is played."""

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from armctl.core.errors import ConfigurationError, unknown_name
from armctl.core.registration import bare_id, remember_named
from armctl.core.seeds import Seed, evaluation_seed
from armctl.envs import full_id, make_worlds
from armctl.episodes.stored import SLOW_DOWN_NAME, UNDISTURBED
from armctl.policies import check_policy_name, expanded, is_seed_group, learners, named_policies
from armctl.rollout.loop import check_counts
from armctl.rollout.parallel import sharing
from armctl.rollout.real_time import (
    RealTime,
    check_measurable,
    check_real_time,
    check_recorded,
    read_recording,
    real_time_of,
)
from armctl.runtime.engines import Engine, engine_of
from armctl.stats.difference import MARGIN
from armctl.stats.sequential import BLOCK, block_ends
from armctl.study.axis import Axis
from armctl.study.grid import Grid
from armctl.study.grids import Pairs, checked_grids
from armctl.study.levels import Disturbances, checked_levels, disturbance_specs
from armctl.study.line_up import default_policies
from armctl.study.names import COMPARISON, FROM_UNDISTURBED, SUITE, SWEEP, setting_name
from armctl.study.options import (
    ComparisonOptions,
    StudyOptions,
    TaskOptions,
    checked_options,
    environment_options,
)

DECIDED = "decided"
"""Condition at which a comparison may stop: its verdict is no longer undecided."""
ONLY_PLAYER = "{name} plays alone, so that there is nothing to decide"
NOT_FOR_TRAININGS = "of groups of trainings, no method holds at any number of episodes"
ONE_TRAINING = "{group} is a single training, which says nothing of others by the same recipe."


@dataclass(frozen=True)
class Cell:
    """Conditions under which policies play the same episodes."""

    name: str
    env: str
    env_options: Mapping[str, Any]
    policies: Mapping[str, Any]
    """Policies as requested, by name; a group of trainings is one of these."""
    real_time: RealTime | None = None
    """None if the world waits for decisions."""
    repeats: str | None = None
    """Name of the cell whose decision times are repeated, if they come from none that was played before."""

    @property
    def setting(self) -> str:
        """Its name among the cells of its task."""
        return self.name.rpartition("/")[2]

    @functools.cached_property
    def _expanded(self) -> tuple[dict[str, Any], dict[str, list[str]]]:
        return expanded(self.policies)

    @property
    def players(self) -> dict[str, Any]:
        """Each policy by its name in the episodes, each training of a group by itself."""
        return self._expanded[0]

    @property
    def groups(self) -> dict[str, list[str]]:
        """The trainings of each group."""
        return self._expanded[1]

    @property
    def single_trainings(self) -> list[str]:
        """A remark for each group that has one training only."""
        return [
            ONE_TRAINING.format(group=name)
            for name in self.policies
            if is_seed_group(self.policies[name]) and name not in self.groups
        ]


@dataclass(frozen=True)
class TaskPlan:
    """The cells of one task, the undisturbed one first."""

    env: str
    cells: Sequence[Cell]
    levels: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """Levels of each disturbance, beginning with the one that changes nothing."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units of each disturbance's levels."""
    recorded: str = ""
    """Source of the decision times of the slow-down levels; empty without such levels."""
    grids: Sequence[Grid] = ()
    """Pairs of disturbances."""
    axes: Sequence[Axis] = ()
    """Box of disturbances in which worst cases are searched."""


@dataclass(frozen=True)
class Plan:
    """Cells of a study, and how much is played in each."""

    kind: str
    tasks: Sequence[TaskPlan]
    seed: int
    episodes: int
    """Number of episodes of each policy in each cell."""
    undisturbed_episodes: int | None = None
    """The same of undisturbed cells; None: as in others."""
    num_envs: int = 1
    engine: Engine = field(default_factory=lambda: engine_of(1))
    isolate: bool = False
    """True if each policy plays in a process of its own."""
    timeout: float | None = None
    """Time (s) that a call of a policy or environment may take; None: the default of its kind."""
    baseline: str | None = None
    margin: float = MARGIN
    until_decided: bool = False
    """True if each cell stops when its verdict is decided, and `episodes` is the most."""
    quick: bool = False
    envs: Sequence[str] = ()
    """All environments that were requested."""
    failures: Mapping[str, str] = field(default_factory=dict)
    """Reasons why environments cannot be played, or not by all of their agents, by environment."""
    misfits: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """Reasons why requested policies do not play, by environment and policy."""

    @property
    def cells(self) -> list[Cell]:
        """Those of all tasks."""
        return [cell for task in self.tasks for cell in task.cells]

    def episodes_in(self, cell: Cell) -> int:
        """Return the number of episodes of each policy in a cell; where it stops when it is decided, the most."""
        if cell.setting == UNDISTURBED and self.undisturbed_episodes is not None:
            return self.undisturbed_episodes
        return self.episodes

    def block_ends(self, cell: Cell, kept: int, judged: Iterable[int], first: int = 0) -> list[int]:
        """Return the numbers of episodes, from the `first` on, after which a cell may stop; the last of them is all.

        So many are `kept` of an earlier run, and so many were `judged` by earlier ones. They do not depend on when a
        run was interrupted, nor on the number of worlds and workers.
        """
        at_most = self.episodes_in(cell) - first
        if not self.until_decided:
            return [at_most]
        return [n for n in sorted({*block_ends(at_most), *judged}) if kept <= n <= at_most]

    def num_verdicts_with(self, cell: Cell) -> int:
        """Return the number of cells, this one included, whose verdicts are corrected for each other.

        Those of all tasks undisturbed; disturbed, those of its task, or all of a sweep.
        """
        if self.kind != SUITE:
            return len(self.cells)
        if cell.setting == UNDISTURBED:
            return len(self.tasks)
        return next(len(task.cells) - 1 for task in self.tasks if task.env == cell.env)

    def num_envs_in(self, cell: Cell) -> int:
        """Return the number of worlds that share a policy's calls: one if the world does not wait for decisions.

        It is no more than a worker's share of the episodes that are played at once.
        """
        workers = sharing(len(cell.players), self.engine.workers)
        at_once = -(-BLOCK // workers) if self.until_decided else self.episodes_in(cell)
        return 1 if cell.real_time else min(self.num_envs, at_once)

    @property
    def total(self) -> int:
        """Number of episodes of all policies in all cells."""
        return sum(self.episodes_in(cell) * len(cell.players) for cell in self.cells)


def comparison_plan(policies: Any, env: str, episodes: int, seed: Seed, options: ComparisonOptions) -> Plan:
    """Plan one cell. Raise `ConfigurationError`, and `ResultsError` for a damaged recording of decision times."""
    checked_options(options, ComparisonOptions)
    cell, shared = undisturbed_cell(policies, env, options), extent(episodes, evaluation_seed(seed), options)
    baseline, margin = options.get("baseline"), options.get("margin", MARGIN)
    if baseline is not None and baseline not in (compared := learners(list(cell.players), cell.groups)):
        raise unknown_name("baseline among the compared policies", baseline, compared)
    _check_decidable(cell, shared)
    if not 0 < margin < 1:
        raise ConfigurationError(f"the margin is a difference in success between 0 and 1, not {margin:g}")
    real_time = real_time_of(options.get("real_time"), options.get("slow_down", 1.0), cell.env, shared["seed"])
    if real_time is not None:
        if real_time.recorded is None:
            check_measurable(shared["num_envs"], shared["engine"].workers)
        check_recorded(real_time, cell.players, episodes)
    task = TaskPlan(cell.env, [replace(cell, real_time=real_time)])
    return Plan(COMPARISON, [task], **shared, baseline=baseline, margin=margin, envs=[cell.env])


def sweep_plan(
    policies: Any,
    env: str,
    disturbances: Disturbances,
    episodes: int,
    seed: Seed,
    options: TaskOptions,
    pairs: Pairs = (),
) -> Plan:
    """Plan an undisturbed cell, one for each level of each disturbance, and those of pairs of disturbances.

    With pairs, only the disturbances that are named play alone. Raise as `comparison_plan` does.
    """
    checked_options(options, TaskOptions)
    shared = extent(episodes, evaluation_seed(seed), options)
    cell = undisturbed_cell(policies, env, options)
    _check_decidable(cell, shared)
    task = task_plan(cell, {} if pairs and disturbances is None else disturbances, options.get("real_time"), "", shared)
    return Plan(SWEEP, [_with_grids(task, pairs)], **shared, envs=[task.env])


def extent(episodes: int, seed: int, options: StudyOptions) -> dict[str, Any]:
    """Return the arguments of `Plan` that all kinds share. Raise `ConfigurationError`."""
    num_envs, workers = options.get("worlds", 1), options.get("workers", 1)
    check_counts(episodes=episodes, worlds=num_envs)
    if (timeout := options.get("timeout")) is not None and not 0 < timeout < math.inf:
        raise ConfigurationError(f"the time-out of a call is more than 0 s, not {timeout:g} s")
    if (until := options.get("until")) not in (None, DECIDED):
        raise unknown_name("condition to stop at (until)", str(until), [DECIDED])
    return {
        "episodes": episodes, "seed": seed, "num_envs": num_envs, "engine": engine_of(workers),
        "isolate": options.get("isolate", False), "timeout": timeout, "until_decided": until == DECIDED,
    }  # fmt: skip


def _check_decidable(cell: Cell, shared: Mapping[str, Any]) -> None:
    """Raise `ConfigurationError` if a study is to stop when a cell is decided which has nothing to decide."""
    if shared["until_decided"] and len(cell.players) < 2:
        raise ConfigurationError(f"{ONLY_PLAYER.format(name=', '.join(cell.players))}: leave out --until {DECIDED}")
    if shared["until_decided"] and cell.groups:
        raise ConfigurationError(f"{', '.join(cell.groups)}: {NOT_FOR_TRAININGS}: leave out --until {DECIDED}")


def undisturbed_cell(policies: Any, env: str, options: TaskOptions) -> Cell:
    """Return the cell of an environment without disturbances of a study. Raise `ConfigurationError`."""
    env = full_id(env)
    remember_named(env)
    by_name = named_policies(default_policies(env) if policies is None else policies)
    if options.get("filter", False):
        by_name = _filtered(by_name)
    return Cell(UNDISTURBED, env, environment_options(options), by_name)


def _filtered(policies: Mapping[str, Any]) -> dict[str, Any]:
    """Return all policies behind the safety filter. Raise `ConfigurationError` for one that is not named."""
    if others := [name for name, policy in policies.items() if not isinstance(policy, (str, Path))]:
        raise ConfigurationError(f"the safety filter takes policies by name, as in file.py:NAME, not {others[0]}")
    filtered = {f"filtered({name})": f"filtered({policy})" for name, policy in policies.items()}
    for policy in filtered.values():
        check_policy_name(policy)
    return filtered


def task_plan(
    undisturbed: Cell, disturbances: Disturbances, real_time: str | Path | None, prefix: str, shared: Mapping[str, Any]
) -> TaskPlan:
    """Plan the undisturbed cell, and those of the disturbances; their names begin with the `prefix`."""
    env, options = undisturbed.env, dict(undisturbed.env_options)
    specs = disturbance_specs(env, options)
    levels = checked_levels(specs, disturbances)
    undisturbed = replace(undisturbed, name=prefix + UNDISTURBED)
    recorded = None if real_time is None else read_recording(Path(real_time), 1.0, env, shared["seed"])
    source = ""
    if SLOW_DOWN_NAME in levels:
        if shared["until_decided"]:
            raise ConfigurationError(f"{SLOW_DOWN_NAME} repeats the times of all episodes: leave out --until {DECIDED}")
        with closing(make_worlds(env, 1, options)) as vec_env:
            check_real_time(bare_id(env), vec_env)
        if recorded is None:
            check_measurable(shared["num_envs"], shared["engine"].workers)
            source = FROM_UNDISTURBED
        else:
            check_recorded(recorded, undisturbed.players, shared["episodes"])
            source = recorded.latency
    elif recorded is not None:
        raise ConfigurationError(
            f"real_time is for the levels of {SLOW_DOWN_NAME}, of which none is asked for (--slow-down)"
        )
    constant = dict(options.pop("disturbances", {}))
    cells = [undisturbed]
    for name, at in levels.items():
        for level in at[1:]:
            if name == SLOW_DOWN_NAME:
                slow_real_time = replace(recorded or RealTime(latency=source), slow_down=level)
                changed = replace(undisturbed, real_time=slow_real_time, repeats=None if recorded else undisturbed.name)
            else:
                changed = replace(undisturbed, env_options=options | {"disturbances": constant | {name: level}})
            cells.append(replace(changed, name=prefix + setting_name(name, level)))
    return TaskPlan(env, cells, levels, {name: specs[name].unit for name in levels}, source)


def _with_grids(task: TaskPlan, pairs: Pairs) -> TaskPlan:
    """Return the plan with the cells of pairs of disturbances."""
    if not pairs:
        return task
    undisturbed = task.cells[0]
    options = dict(undisturbed.env_options)
    specs = disturbance_specs(task.env, options)
    grids = checked_grids(specs, pairs)
    constant = dict(options.pop("disturbances", {}))
    cells = [
        replace(
            undisturbed,
            name=grid.setting(row, column),
            env_options=options | {"disturbances": constant | {grid.rows: row, grid.columns: column}},
        )
        for grid in grids
        for row, column in grid.cells
    ]
    units = {name: specs[name].unit for grid in grids for name in (grid.rows, grid.columns)}
    return replace(task, cells=[*task.cells, *cells], units={**task.units, **units}, grids=grids)
