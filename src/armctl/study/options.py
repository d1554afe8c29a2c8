"""The options that studies share, written once: as arguments by keyword of `compare`, `sweep` and `suite`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypedDict

from armctl.core.errors import unknown_name
from armctl.envs import RETURN_BOUNDS
from armctl.runtime.engines import Engine
from armctl.stats.intervals import Bounds


class StudyOptions(TypedDict, total=False):
    """Options of every study."""

    overwrite: bool
    """Replace all results in the folder, which are resumed otherwise."""
    worlds: int
    """Number of worlds that each process plays at once, 1 by default: see `compare` about decision times."""
    workers: int | Engine
    """Number of processes that play, 1 by default, each with `worlds` worlds on one core; or an engine, whose workers
    play (`armctl.runtime.engines.connect`). Decision times are then measured while the other processes compute."""
    isolate: bool
    """Play each policy in a process of its own, which gets observations only: no world, seed or episode number (see
    `armctl.runtime.isolation`). Its episodes are the same, and decision times are measured in that process. Installed
    policies that see the true state play as ever, and are named; others that see it are refused."""
    timeout: float | None
    """Time (s) that one call may take: a policy's decision or reset, in all worlds that it plays at once, and a step or
    reset of the environment. By default, 10 for a server or another Python, 300 for an isolated policy, and any in this
    process (see `armctl.core.time_limit`). A policy that takes longer ends, and its finished episodes stay; an
    isolated one loses the episode."""
    filter: bool
    """Play each policy behind the safety filter, as `filtered(NAME)` (see `armctl.policies.filtered`)."""
    until: Literal["decided"] | None
    """`decided`: play in blocks, and stop in each cell when every pair of its verdict is decided, at a level that is
    corrected for the number of cells that are judged together; `episodes` is then the most. What is concluded holds at
    any number of episodes (see `armctl.stats.sequential`). By default, all episodes are played, but in a suite without
    a number of them."""
    policy_seed: int | None
    """Secret from which policies draw their own random numbers (see `armctl.envs.policy_seed`), so that another study
    draws the same. By default, that of the folder, or a new one; it is in the summary."""


class TaskOptions(StudyOptions, total=False):
    """Options of a study of one environment."""

    env_options: Mapping[str, Any] | None
    """Options of the environment, by name."""
    return_bounds: Bounds | None
    """Least and largest possible return of an episode, for an environment that does not tell them: means of returns
    have intervals and tests with such bounds only."""
    real_time: str | Path | None
    """Real time: the world does not wait, and a decision longer than the control period takes effect when it is
    ready (see `armctl.rollout.real_time`). It is `measured`, which needs one world and one worker, or the folder of a
    comparison with one world and one worker, whose decision times are repeated: then the episodes are the same whenever
    and wherever they are played. Each process plays one world at a time. In a sweep, it is the folder for the levels of
    `slow-down`."""


class ComparisonOptions(TaskOptions, total=False):
    """Options of a comparison."""

    baseline: str | None
    """The policy that all others are compared with; by default, the verdict is about the best classical and the best
    learned policy."""
    margin: float
    """Difference in success, as a share, below which policies count as equivalent; 0.02 by default."""
    slow_down: float
    """Factor of the decision times, in real time."""


class WorstCaseOptions(TypedDict, total=False):
    """Options of a search for worst cases; those without a text are of `StudyOptions` and `TaskOptions`."""

    budget: int
    """Number of episodes of each policy's search, 300 by default."""
    episodes: int
    """Number of episodes at each of up to seven points that judge a search, 100 by default."""
    judge_seed: int | Literal["test"]
    """Seed of these episodes; by default, the first after those of the search."""
    env_options: Mapping[str, Any] | None
    overwrite: bool
    worlds: int
    workers: int | Engine
    isolate: bool
    timeout: float | None
    filter: bool
    policy_seed: int | None


def checked_options(options: Mapping[str, Any], kind: type) -> None:
    """Raise `ConfigurationError` for an option that a kind of study does not have."""
    allowed = kind.__annotations__
    for name in options:
        if name not in allowed:
            raise unknown_name("option", name, [*allowed])


def environment_options(options: TaskOptions) -> dict[str, Any]:
    """Return the options of the environment, with the bounds of its returns if they are stated."""
    bounds = options.get("return_bounds")
    return dict(options.get("env_options") or {}) | ({} if bounds is None else {RETURN_BOUNDS: bounds})
