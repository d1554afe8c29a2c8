"""The suite: all tasks with all their policies, undisturbed and under the main disturbances, in one folder."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Unpack

from armctl.core.seeds import Seed
from armctl.study.options import StudyOptions
from armctl.study.plan import ALL, suite_plan
from armctl.study.run import play
from armctl.study.study import Study


def suite(
    envs: Sequence[str] = (ALL,),
    *,
    quick: bool = False,
    episodes: int | None = None,
    seed: Seed = 0,
    out: str | Path | None = None,
    progress: Callable[[str, int], None] | None = None,
    **options: Unpack[StudyOptions],
) -> Study:
    """Let all policies of all tasks play, undisturbed and under the main disturbances.

    `envs` are environments; `all`, the default, means those of all installed packages. Of each, the task's default
    line-up plays, every installed expert that fits, and every installed agent whose card names the environment; random
    actions play only where there is nothing else. `quick` plays less (`line_up.QUICK` instead of `FULL`); `episodes` is
    the number of episodes in each setting.

    `out` gets one `results.sqlite` for all tasks. After an interrupt, the same call resumes. A task that cannot be
    played is in `failures`, and keeps none of the others from being played; so is an agent whose files are damaged.
    The other arguments are those of `compare`. `progress` is called for each episode, with the cell's name and the
    number of all episodes.

    Raises `ConfigurationError` for unusable arguments, and `ResultsError` if `out` cannot be written to, or holds a
    suite of another seed or of further tasks (unless `overwrite`).
    """
    plan = suite_plan(envs, quick, episodes, seed, options)
    total = plan.total
    return play(plan, out, options, lambda cell, result: progress(cell.name, total) if progress else None)
