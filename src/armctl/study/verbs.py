"""The verbs as functions: `compare` on one task, `sweep` under disturbances, `suite` in all tasks."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Unpack

from armctl import DEFAULT_ENV
from armctl.core.seeds import Seed
from armctl.episodes.record import EpisodeResult
from armctl.episodes.stored import UNDISTURBED
from armctl.study.comparison import Comparison
from armctl.study.grids import Pairs
from armctl.study.levels import Disturbances
from armctl.study.options import ComparisonOptions, StudyOptions, TaskOptions
from armctl.study.plan import comparison_plan, sweep_plan
from armctl.study.run import play
from armctl.study.study import Study
from armctl.study.suite_plan import ALL, suite_plan
from armctl.study.task_results import Sweep


def compare(
    policies: Any = None,
    env: str = DEFAULT_ENV,
    *,
    episodes: int = 200,
    seed: Seed = 0,
    out: str | Path | None = None,
    progress: Callable[[EpisodeResult], None] | None = None,
    **options: Unpack[ComparisonOptions],
) -> Comparison:
    """Let policies play the same episodes 0 to `episodes` - 1 of `seed`; `"test"` is the sealed one.

    `policies` is a list, or a mapping from names in the results, of any of the forms that `make_policy` takes: names,
    files, functions, classes, models; by default, it is what the task of `env` declares. `NAME[*]` is all trainings of
    a recipe as one learner (see `armctl.policies.trainings`). `progress` is called with every finished episode, first
    with those of an earlier run.

    With `out`, every episode is written to `out/results.sqlite` as soon as it ends, and in the end all are in
    `out/episodes.csv`, and the summary in `out/summary.json`. After an interrupt (Ctrl-C) or a full disk, finished
    episodes are kept, and the same call resumes the comparison. An episode in which a policy raises an error, or
    returns an invalid action, is lost: its outcome is `error`, and the next one begins (see
    `armctl.episodes.failures`). Except for decision times, `episodes.csv` does not depend on the number of worlds and
    workers. With one world and one worker (the default), decision times are latencies, by which deadlines are judged;
    with more worlds, each is a batch's time divided by the number of worlds that play. The policy's construction, its
    resets and its first decision in a process have times of their own.

    Raises `ConfigurationError` (also for a seed of training, see `armctl.core.seeds`, and for a return that is
    outside the `return_bounds`), `AgentFileError`, and `ResultsError` if `out` cannot be written, is damaged, or holds
    the results of another comparison (unless `overwrite`).
    """
    plan = comparison_plan(policies, env, episodes, seed, options)
    study = play(plan, out, options, lambda cell, result: progress(result) if progress else None)
    (task,) = study.tasks.values()
    return task.comparisons[UNDISTURBED]


def sweep(
    policies: Any = None,
    env: str = DEFAULT_ENV,
    *,
    disturbances: Disturbances = None,
    pairs: Pairs = (),
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

    `pairs` are two disturbances at once, each pair as names (`[("delay", "noise")]`, at three levels each) or as levels
    by name, or `"default"` for delay with noise, payload with friction, and mismatch with noise, as far as the
    environment has them. All combinations of levels are played, beside the undisturbed cell. With pairs, only those
    disturbances are swept alone that `disturbances` names.

    The other arguments are those of `compare`. `out` gets one `results.sqlite` for all, `sweep.csv`, and `pairs.csv`.
    The same call resumes an interrupted sweep, and a call with more levels extends it; a comparison's folder can be
    extended to a sweep of it. `progress` is called with the setting's name and the episode.

    Raises `ConfigurationError`, `AgentFileError`, and `ResultsError` as `compare` does.
    """
    plan = sweep_plan(policies, env, disturbances, episodes, seed, options, pairs)
    study = play(plan, out, options, lambda cell, result: progress(cell.setting, result) if progress else None)
    (task,) = study.tasks.values()
    return task


def suite(
    envs: Sequence[str] = (ALL,),
    *,
    policies: Any = (),
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
    actions play only where there is nothing else. `policies` are further ones, of any of the forms that `compare`
    takes: each plays in the tasks in whose first control step it can act, and `misfits` says why not in others. With
    `quick`, only a task's first expert and first agent play, undisturbed and with delay (`line_up.QUICK`). Each setting
    stops when its verdict is decided: at the latest after 200 episodes undisturbed, and 50 disturbed (100 with
    `quick`). `episodes` is a fixed number, or the most with `until="decided"`. Where an environment does not obey its
    seed, all are played.

    `out` gets one `results.sqlite` for all tasks. After an interrupt, the same call resumes. A task that cannot be
    played is in `failures`, and keeps none of the others from being played; so is an agent whose files are damaged.
    The other arguments are those of `compare`. `progress` is called for each episode, with the cell's name and the
    number of all episodes.

    Raises `ConfigurationError` for unusable arguments, and `ResultsError` if `out` cannot be written to, or holds a
    suite of another seed or of further tasks (unless `overwrite`).
    """
    plan = suite_plan(envs, quick, episodes, seed, options, policies)
    total = plan.total
    return play(plan, out, options, lambda cell, result: progress(cell.name, total) if progress else None)
