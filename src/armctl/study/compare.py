"""Compares several policies on the same episodes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Unpack

from armctl import DEFAULT_ENV
from armctl.core.seeds import Seed
from armctl.episodes.record import EpisodeResult
from armctl.episodes.stored import UNDISTURBED
from armctl.study.comparison import Comparison
from armctl.study.options import ComparisonOptions
from armctl.study.plan import comparison_plan
from armctl.study.run import play


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
    with more worlds, each is a batch's time divided by the number of worlds. The policy's construction, its resets and
    its first decision in a process have times of their own.

    Raises `ConfigurationError` (also for a seed of training, see `armctl.core.seeds`, and for a return that is
    outside the `return_bounds`), `AgentFileError`, and `ResultsError` if `out` cannot be written, is damaged, or holds
    the results of another comparison (unless `overwrite`).
    """
    plan = comparison_plan(policies, env, episodes, seed, options)
    study = play(plan, out, options, lambda cell, result: progress(result) if progress else None)
    (task,) = study.tasks.values()
    return task.comparisons[UNDISTURBED]
