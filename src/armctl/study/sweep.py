"""Robustness of policies: one comparison without disturbances, and one for each level of each disturbance."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Unpack

from armctl import DEFAULT_ENV
from armctl.core.seeds import Seed
from armctl.episodes.record import EpisodeResult
from armctl.study.levels import Disturbances
from armctl.study.options import TaskOptions
from armctl.study.plan import sweep_plan
from armctl.study.run import play
from armctl.study.task_results import Sweep


def sweep(
    policies: Any = None,
    env: str = DEFAULT_ENV,
    *,
    disturbances: Disturbances = None,
    episodes: int = 100,
    seed: Seed = 0,
    out: str | Path | None = None,
    progress: Callable[[str, EpisodeResult], None] | None = None,
    **options: Unpack[TaskOptions],
) -> Sweep:
    """Compare policies on the same episodes, undisturbed and at each level of each disturbance.

    `disturbances` are names, or levels by name; None as levels means the disturbance's default levels. By default, all
    disturbances of the environment are swept. `slow-down` simulates a slower computer in real time (see `compare`):
    a level is the factor of all decision times; at level 0, the world waits. All levels repeat the same decision times,
    those in the results folder `real_time`, or else those of the undisturbed comparison, which then needs one world and
    one worker.

    The other arguments are those of `compare`. `out` gets one `results.sqlite` for all, and `sweep.csv`. The same call
    resumes an interrupted sweep, and a call with more levels extends it; a comparison's folder can be extended to a
    sweep of it. `progress` is called with the setting's name and the episode.

    Raises `ConfigurationError`, `AgentFileError`, and `ResultsError` as `compare` does.
    """
    plan = sweep_plan(policies, env, disturbances, episodes, seed, options)
    study = play(plan, out, options, lambda cell, result: progress(cell.setting, result) if progress else None)
    (task,) = study.tasks.values()
    return task
