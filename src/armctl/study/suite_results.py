"""Reads a suite's folder back, without playing anything."""

from dataclasses import dataclass
from pathlib import Path

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.files import checked_name
from armctl.study.curves import SWEEP, read_sweep
from armctl.study.results import read_results, read_sealed
from armctl.study.suite import SUITE, Suite, folder_of
from armctl.study.sweep import UNDISTURBED, Sweep, folder_name

UNFINISHED = "its sweep is unfinished: the same command resumes it"


@dataclass(frozen=True)
class _Suite:
    """`suite.json`."""

    seed: int
    episodes: int
    envs: list[str]
    failures: dict[str, str]
    interrupted: bool
    quick: bool = False


@dataclass(frozen=True)
class _Sweep:
    """The part of `sweep.json` that is needed."""

    env: str
    seed: int
    disturbances: dict[str, list[float]]
    failures: dict[str, str]
    interrupted: bool


def read_suite(folder: Path) -> Suite:
    """Read the folder of a finished or interrupted suite. A task whose sweep is unfinished is in its failures.

    Raises `ResultsError` if a file is missing or damaged.
    """
    _, told = read_sealed(folder / SUITE, _Suite, "a suite")
    found = Suite(
        told.seed, told.episodes, told.envs, told.quick, failures=dict(told.failures), interrupted=told.interrupted
    )
    for env in told.envs:
        try:
            home = folder / folder_of(env)
        except ConfigurationError as error:
            raise ResultsError(f"{folder / SUITE} cannot be read as results of a suite: {error}") from error
        if (home / SWEEP).exists():
            found.tasks[env] = _read_task(home, env, told.seed)
        else:
            found.failures.setdefault(env, UNFINISHED)
    return found


def _read_task(home: Path, env: str, seed: int) -> Sweep:
    _, told = read_sealed(home / SWEEP, _Sweep, "a suite")
    if (told.env, told.seed) != (env, seed):
        raise ResultsError(f"{home} holds a sweep of {told.env}, seed {told.seed}, not one of {env}, seed {seed}")
    found = Sweep(env, seed, told.disturbances, failures=told.failures, interrupted=told.interrupted)
    if told.disturbances:
        found.points = read_sweep(home)
    named = [folder_name(name, level) for name, levels in told.disturbances.items() for level in levels[1:]]
    for name in (UNDISTURBED, *named):
        try:
            part = home / checked_name("comparison", name)
        except ConfigurationError as error:
            raise ResultsError(f"{home / SWEEP} cannot be read as results of a sweep: {error}") from error
        if part.exists():
            found.comparisons[name] = played = read_results(part).comparison
            if (played.env, played.seed) != (env, seed):
                raise ResultsError(f"{part} holds a comparison of another environment or seed: run the suite again")
    return found
