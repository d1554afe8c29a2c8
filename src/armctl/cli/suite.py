"""Verbs that compare in many settings: `sweep` under disturbances, `suite` in all tasks."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from armctl import DEFAULT_ENV
from armctl.cli import completion
from armctl.cli.app import verb
from armctl.cli.evaluate import exit_if_interrupted, make_report, print_tracebacks
from armctl.cli.options import (
    Env,
    EnvOptions,
    Format,
    On,
    Overwrite,
    Policies,
    PolicySeed,
    ReturnBounds,
    Seed,
    SuccessReturn,
    TableFormat,
    Workers,
    Worlds,
    levels_of,
    new_folder,
    options_of,
    print_document,
    progress_bar,
)


@dataclass(frozen=True)
class SweepRequest:
    """Options of `sweep`."""

    policies: Policies = None
    env: Env = DEFAULT_ENV
    disturbances: Annotated[
        list[str] | None,
        typer.Option(
            "--disturbance",
            metavar="NAME[=LEVELS]",
            help="Disturbance; can be repeated: `--disturbance noise --disturbance payload=0,1,2,4`.",
            show_default="all of the environment's",
            autocompletion=completion.disturbances,
        ),
    ] = None
    episodes: Annotated[int, typer.Option(min=1, help="Episodes that every policy plays at each level.")] = 100
    seed: Seed = 0
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for sweep.csv and all comparisons.", show_default="results/<date and time>"),
    ] = None
    overwrite: Overwrite = False
    worlds: Worlds = 1
    workers: Workers = 1
    on: On = "local"
    env_options: EnvOptions = None
    success_return: SuccessReturn = None
    return_bounds: ReturnBounds = None
    slow_down: Annotated[
        str | None,
        typer.Option(
            metavar="LEVELS",
            help="Slower computers, in real time: `--slow-down 1,2,5,10,30`, short for `--disturbance slow-down=...`.",
        ),
    ] = None
    real_time: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Results folder whose decision times `--slow-down` repeats.",
            show_default="those of the undisturbed comparison, with one world and one worker",
        ),
    ] = None
    policy_seed: PolicySeed = None
    table_format: Format = TableFormat.TABLE


@verb
def sweep(request: SweepRequest) -> None:
    """Let policies play the same episodes under increasing disturbances, and print how robust each is.

    Disturbances: `noise` of sensors, `delay` of actions, `payload`, `friction`, `strength` of motors, `pushes`,
    `mismatch` between the robot and the controllers' model of it, and `dropout` of camera images. Noise and dropout
    spare policies that see the state, which are then not ranked; `noise_on_state` reaches them. `armctl list` shows the
    levels. With `--slow-down`, success is against the
    slowness of the computer, in a world that does not wait.

    Every episode is written as it ends. After Ctrl-C, the same command with the same `--out` resumes the sweep.
    """
    from armctl.episodes import EpisodeResult
    from armctl.policies import expanded, named_policies
    from armctl.rollout.real_time import SLOWER
    from armctl.runtime.engines import connect
    from armctl.study import sweep as run_sweep
    from armctl.study.levels import sweep_levels
    from armctl.study.line_up import default_policies

    names, options = (
        request.policies or default_policies(request.env),
        options_of(request.env_options, success_return=request.success_return),
    )
    arguments = (request.disturbances or []) + ([f"{SLOWER}={request.slow_down}"] if request.slow_down else [])
    requested = levels_of(arguments) if arguments else None
    players, _ = expanded(named_policies(names))
    settings = 1 + sum(len(levels) - 1 for levels in sweep_levels(request.env, requested, options).values())
    folder = request.out or new_folder()
    with connect(request.on, request.workers) as engine, progress_bar() as bar:
        task = bar.add_task("", total=settings * len(players) * request.episodes)

        def progress(setting: str, result: EpisodeResult) -> None:
            bar.update(task, description=setting, advance=1)

        sweep_result = run_sweep(
            names,
            request.env,
            disturbances=requested,
            episodes=request.episodes,
            seed=request.seed,
            out=folder,
            overwrite=request.overwrite,
            worlds=request.worlds,
            workers=engine,
            policy_seed=request.policy_seed,
            env_options=options,
            real_time=request.real_time,
            return_bounds=request.return_bounds,
            progress=progress,
        )
    console = print_document(sweep_result.document(), request.table_format)
    if "results" not in sweep_result.failures:
        console.print(f"{folder / 'sweep.csv'} has the curves.", soft_wrap=True)
    exit_if_interrupted(sweep_result.interrupted, folder, console)
    for comparison in sweep_result.comparisons.values():
        print_tracebacks(comparison.tracebacks)
    if sweep_result.failures:
        raise typer.Exit(1)


@dataclass(frozen=True)
class SuiteRequest:
    """Options of `suite`."""

    envs: Annotated[
        list[str] | None,
        typer.Option(
            "--env",
            help="Environment, also one of your own; can be repeated. `all` stands for all installed ones: "
            "`--env all --env mine.py:Maze`.",
            show_default="all",
            autocompletion=completion.environments,
        ),
    ] = None
    quick: Annotated[
        bool, typer.Option("--quick", help="20 episodes, two disturbances: about five minutes with two workers.")
    ] = False
    episodes: Annotated[
        int | None,
        typer.Option(min=1, help="Episodes that every policy plays in each setting.", show_default="50; 20 if quick"),
    ] = None
    seed: Seed = 0
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the report and all sweeps.", show_default="results/<date and time>"),
    ] = None
    overwrite: Overwrite = False
    worlds: Worlds = 1
    workers: Workers = 1
    on: On = "local"
    video: Annotated[bool, typer.Option("--video", help="Film episodes for the tasks' own reports: minutes.")] = False
    policy_seed: PolicySeed = None
    table_format: Format = TableFormat.TABLE


@verb
def suite(request: SuiteRequest) -> None:
    """Let all policies of all tasks play, undisturbed and under the main disturbances, and write one report.

    For each task, it answers whether a planner or controller is better than a learned agent: by how much, at what cost,
    and under which disturbance the order turns. The main disturbances are `noise` (or `noise_on_state`), `delay`,
    `payload`, `friction`, `pushes` and `mismatch`, at the middle and the strongest of their levels; `--quick` has
    `delay` and `mismatch`.

    With `--workers 2`, that takes less than an hour. Every episode is written as it ends. After Ctrl-C, the same
    command with the same `--out` resumes the suite. A task that fails is told, and does not stop the others.
    """
    from armctl.runtime.engines import connect
    from armctl.study import suite as run_suite
    from armctl.study.plan import ALL

    folder = request.out or new_folder()
    with connect(request.on, request.workers) as engine, progress_bar() as bar:
        task = bar.add_task("", total=None)

        def progress(setting: str, total: int) -> None:
            bar.update(task, description=setting, total=total, advance=1)

        result = run_suite(
            request.envs or (ALL,),
            quick=request.quick,
            episodes=request.episodes,
            seed=request.seed,
            out=folder,
            overwrite=request.overwrite,
            worlds=request.worlds,
            workers=engine,
            policy_seed=request.policy_seed,
            progress=progress,
        )
    console = print_document(result.document(), request.table_format)
    if request.table_format is TableFormat.CSV:  # has no place for them
        for problem in result.problems:
            console.print(problem, soft_wrap=True)
    exit_if_interrupted(result.interrupted, folder, console)
    if result.tasks and "results" not in result.failures:
        make_report(folder, None, console, video=request.video)
    for sweep_result in result.tasks.values():
        for comparison in sweep_result.comparisons.values():
            print_tracebacks(comparison.tracebacks)
    if result.problems:
        raise typer.Exit(1)
