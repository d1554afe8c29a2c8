"""Verbs that compare: `compare` on one task, `suite` in all tasks."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armctl import DEFAULT_ENV
from armctl.cli import completion
from armctl.cli.app import verb
from armctl.cli.options import (
    Env,
    EnvOptions,
    Format,
    On,
    Overwrite,
    Policies,
    PolicySeed,
    RealTime,
    Robot,
    Seed,
    TableFormat,
    Workers,
    Worlds,
    checked_env,
    checked_policies,
    checked_policy,
    environment_options,
    exit_if_interrupted,
    make_report,
    new_folder,
    print_document,
    print_tracebacks,
    progress_bar,
)
from armctl.cli.player_options import Filter, Isolate, Timeout
from armctl.cli.scoring_options import ReturnBounds, Success, SuccessKey, SuccessReturn
from armctl.core.errors import ConfigurationError

if TYPE_CHECKING:
    from armctl.study.plan import Plan


@dataclass(frozen=True, kw_only=True)
class StudyRequest:
    """Options of every study."""

    seed: Seed = 0
    overwrite: Overwrite = False
    worlds: Worlds = 1
    workers: Workers = 1
    on: On = "local"
    policy_seed: PolicySeed = None
    isolate: Isolate = False
    timeout: Timeout = None
    filter: Filter = False
    until: Annotated[
        str | None,
        typer.Option(
            metavar="decided",
            help="Stop when every pair of a verdict is better, worse or equivalent, judged by a test that holds at "
            "any number of episodes: in each setting by itself.",
            show_default="all episodes are played",
        ),
    ] = None
    at_most: Annotated[
        int | None,
        typer.Option(min=1, help="Episodes that every policy plays at most, with --until.", show_default="500"),
    ] = None
    table_format: Format = TableFormat.TABLE

    def num_episodes(self, episodes: int | None, usual: Any, usually_at_most: Any = 500) -> Any:
        """Return the number of episodes, fixed or the largest one, if nothing else is asked for, of these two.

        Raises `ConfigurationError` for options that exclude each other.
        """
        if self.until is None and self.at_most is not None:
            raise ConfigurationError("--at-most is for --until decided: without it, --episodes is the number")
        if self.until is not None and episodes is not None:
            raise ConfigurationError("--episodes is a fixed number: with --until decided, --at-most limits it")
        return (episodes or usual) if self.until is None else (self.at_most or usually_at_most)


@dataclass(frozen=True, kw_only=True)
class TaskRequest(StudyRequest):
    """Options of a study of one environment."""

    policies: Policies = None
    env: Env = DEFAULT_ENV
    robot: Robot = None
    env_options: EnvOptions = None
    success: Success = None
    success_key: SuccessKey = None
    success_return: SuccessReturn = None
    return_bounds: ReturnBounds = None

    @property
    def task_options(self) -> dict[str, Any]:
        """The options that `armctl.study.options.TaskOptions` has."""
        return {"env_options": options_of_env(self), "return_bounds": self.return_bounds}


def options_of_env(request: Any) -> dict[str, Any]:
    """Return the options of the environment that a request names; they are checked before anything is loaded."""
    names = ("robot", "success", "success_key", "success_return")
    short_forms = {name: getattr(request, name) for name in names}
    return environment_options(request.env, request.env_options, **short_forms)


def checked_envs(envs: list[str] | None) -> list[str] | None:
    """Return environments that may be there, or `all`."""
    for env in envs or []:
        checked_env(None if env == "all" else env)
    return envs


def checked_points(points: float) -> float:
    """Return a difference in success in points. Raises `ConfigurationError`."""
    if not 0 < points < 100:
        raise ConfigurationError(f"the margin is a difference in success between 0 and 100 points, not {points:g}")
    return points


@dataclass(frozen=True, kw_only=True)
class CompareRequest(TaskRequest):
    """Options of `compare`."""

    episodes: Annotated[
        int | None, typer.Option(min=1, help="Episodes that every policy plays.", show_default="200")
    ] = None
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for episodes.csv and summary.json.", show_default="results/<date and time>"),
    ] = None
    baseline: Annotated[
        str | None,
        typer.Option(
            metavar="POLICY",
            help="Compare all other policies with this one.",
            callback=checked_policy,
            show_default="the best classical against the best learned policy",
        ),
    ] = None
    margin: Annotated[
        float,
        typer.Option(
            metavar="POINTS",
            help="Success that differs by less, in percent, counts as equivalent.",
            callback=checked_points,
        ),
    ] = 2.0
    real_time: RealTime = None
    slow_down: Annotated[float, typer.Option(metavar="FACTOR", help="Factor of the decision times, in real time.")] = (
        1.0
    )
    report: Annotated[bool, typer.Option("--report", help="Also write report.html, with figures and videos.")] = False


@verb
def compare(request: CompareRequest) -> None:
    """Compare policies on the same episodes, and print which is better, and by how much.

    `"reach_bc[*]"` is all trainings of a recipe as one learner: the shipped one and its other training seeds, or for a
    path, `"runs/reach_ppo[*]"`, those that `armctl train` has made. `"reach_bc[1]"` is the one of training seed 1.

    With `--until decided`, it stops when the verdict is decided, at 5 %: after few episodes if policies differ much.

    Every episode is written as it ends. After Ctrl-C, the same command with the same `--out` resumes the comparison.
    A policy that raises an error, or returns an invalid action, loses that episode (`error`) and plays on; the exit
    status is then 1. One that fails before its first action in each of its first 3 episodes stops.
    """
    task_options = request.task_options  # before the imports, so that a misspelt one is told at once
    num_episodes = request.num_episodes(request.episodes, 200)
    from armctl.study.plan import comparison_plan

    def plan(options: Any) -> "Plan":
        options |= task_options | {
            "baseline": request.baseline,
            "margin": request.margin / 100,
            "real_time": request.real_time,
            "slow_down": request.slow_down,
        }
        return comparison_plan(request.policies, request.env, num_episodes, request.seed, options)

    play_study(
        request, request.out, plan, "{0}/episodes.csv has the episodes, {0}/summary.json the tables.", request.report
    )


@dataclass(frozen=True, kw_only=True)
class SuiteRequest(StudyRequest):
    """Options of `suite`."""

    envs: Annotated[
        list[str] | None,
        typer.Option(
            "--env",
            help="Environment, also one of your own; can be repeated. `all` means all installed ones: "
            "`--env all --env mine.py:Maze`.",
            show_default="all",
            autocompletion=completion.environments,
            callback=checked_envs,
        ),
    ] = None
    policies: Annotated[
        list[str] | None,
        typer.Option(
            "--policy",
            metavar="POLICY",
            help="Further policy, of any form that `compare` takes, such as `mine.py:pd`; can be repeated. It plays in "
            "the tasks that it fits.",
            show_default="none",
            autocompletion=completion.policies,
            callback=checked_policies,
        ),
    ] = None
    quick: Annotated[
        bool,
        typer.Option(
            "--quick",
            help="One expert and one agent of each task, undisturbed and with delay: with `--workers 2 --worlds 10`, "
            "2 min 15 s for ten tasks.",
        ),
    ] = False
    episodes: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Fixed number of episodes that every policy plays in each setting, decided or not.",
            show_default="none",
        ),
    ] = None
    until: Annotated[
        str | None,
        typer.Option(
            metavar="decided",
            help="Stop each setting when every pair of its verdict is better, worse or equivalent, judged by a test "
            "that holds at any number of episodes.",
            show_default="decided, without --episodes",
        ),
    ] = None
    at_most: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Episodes that every policy plays at most in each setting.",
            show_default="200 undisturbed, 50 disturbed; 100 if quick",
        ),
    ] = None
    out: Annotated[
        Path | None, typer.Option(help="Folder for the results and reports.", show_default="results/<date and time>")
    ] = None
    video: Annotated[bool, typer.Option("--video", help="Film episodes for the tasks' own reports: minutes.")] = False


@verb
def suite(request: SuiteRequest) -> None:
    """Compare all policies on all tasks, undisturbed and under the main disturbances, and write one report.

    For each task, it answers whether a planner or controller is better than a learned agent: by how much, at what cost,
    and under which disturbance the order reverses. The main disturbances are `noise` (or `noise_on_state`), `delay`,
    `payload`, `friction`, `pushes` and `mismatch`, at the middle and the strongest of their levels; `--quick` has
    only `delay`, and the first expert and the first agent of each task.

    `--policy mine.py:pd` plays too, in the tasks in whose first control step it can act; others are named with the
    reason.

    Each setting stops when its verdict is decided. With `--workers 2 --worlds 10`, ten tasks took 37 minutes.
    Every episode is written as it ends. After Ctrl-C, the same command with the same `--out` resumes the suite. A task
    that fails is reported, and does not stop the others.
    """
    if request.episodes is None:
        request = replace(request, until=request.until or "decided")
    num_episodes = request.num_episodes(request.episodes, None, None)
    envs, policies = request.envs, request.policies or ()
    from armctl.study.suite_plan import ALL, suite_plan

    def plan(options: Any) -> "Plan":
        return suite_plan(envs or (ALL,), request.quick, num_episodes, request.seed, options, policies)

    play_study(request, request.out, plan, "", report=True, video=request.video)


def play_study(
    request: StudyRequest,
    out: Path | None,
    make_plan: Callable[[Any], "Plan"],
    files: str,
    report: bool = False,
    video: bool | None = None,
) -> None:
    """Play a study, and print its result, which `files` have what, and what failed."""
    from armctl.runtime.engines import connect
    from armctl.study.run import play

    folder = out or new_folder()
    with connect(request.on, request.workers) as engine, progress_bar() as bar:
        options = {
            "overwrite": request.overwrite,
            "worlds": request.worlds,
            "workers": engine,
            "policy_seed": request.policy_seed,
            "isolate": request.isolate,
            "timeout": request.timeout,
            "filter": request.filter,
            "until": request.until,
        }
        plan = make_plan(options)
        task = bar.add_task("", total=plan.total)
        study = play(
            plan,
            folder,
            options,  # type: ignore[arg-type]  # with those of the plan
            lambda cell, result: bar.update(
                task, description=cell.name if len(plan.cells) > 1 else result.policy, advance=1
            ),
        )
    console = print_document(study.result.document(), request.table_format)
    written = "results" not in study.storage_failures
    if written and files:
        console.print(files.format(folder), soft_wrap=True)
    if request.table_format is TableFormat.CSV:  # has no place for them
        for problem in study.problems:
            console.print(problem, soft_wrap=True)
    exit_if_interrupted(study.interrupted, folder, console)
    if report and written and study.tasks:
        make_report(folder, None, console, video=video, study=study)
    for comparison in study.cells.values():
        print_tracebacks(comparison.tracebacks)
    if study.problems:
        raise typer.Exit(1)
