"""Verbs of robustness: `sweep` under disturbances, and `worst-case`, the mildest one with which a policy fails."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armctl import DEFAULT_ENV
from armctl.cli import completion
from armctl.cli.app import verb
from armctl.cli.compare import TaskRequest, options_of_env, play_study
from armctl.cli.options import (
    Env,
    EnvOptions,
    Format,
    On,
    Overwrite,
    Policies,
    PolicySeed,
    Robot,
    Seed,
    TableFormat,
    Workers,
    Worlds,
    exit_if_interrupted,
    make_report,
    new_folder,
    print_document,
    progress_bar,
    seed_of,
)
from armctl.cli.player_options import Filter, Isolate, Timeout
from armctl.cli.scoring_options import Success, SuccessKey, SuccessReturn

if TYPE_CHECKING:
    from armctl.study.plan import Plan


@dataclass(frozen=True, kw_only=True)
class SweepRequest(TaskRequest):
    """Options of `sweep`."""

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
    pairs: Annotated[
        list[str] | None,
        typer.Option(
            "--pairs",
            metavar="NAME,NAME",
            help="Two disturbances at once, at 3 x 3 levels, or at `delay=2,4,noise=0.02,0.05`; can be repeated. "
            "`--pairs default`: delay,noise, payload,friction and mismatch,noise.",
            show_default="none",
            autocompletion=completion.disturbances,
        ),
    ] = None
    episodes: Annotated[
        int | None,
        typer.Option(min=1, help="Episodes that every policy plays at each level.", show_default="100"),
    ] = None
    out: Annotated[
        Path | None, typer.Option(help="Folder for episodes.csv and sweep.csv.", show_default="results/<date and time>")
    ] = None
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


@verb
def sweep(request: SweepRequest) -> None:
    """Compare policies on the same episodes under increasing disturbances, and print how robust each is.

    Disturbances: `noise` of sensors, `delay` of actions, `payload`, `friction`, `strength` of motors, `pushes`,
    `mismatch` between the robot and the controllers' model of it, and `dropout` of camera images. Noise and dropout
    spare policies that see the state, which are then not ranked; `noise_on_state` reaches them. `armctl list` shows the
    levels. With `--slow-down`, success is against the
    slowness of the computer, in a world that does not wait. With `--pairs`, each two disturbances act at once, and the
    result is a map of success for each policy, and one of the policies that lead.

    Every episode is written as it ends. After Ctrl-C, the same command with the same `--out` resumes the sweep.
    """
    task_options = request.task_options  # before the imports, so that a misspelt one is told at once
    num_episodes = request.num_episodes(request.episodes, 100)
    from armctl.episodes.stored import SLOW_DOWN_NAME
    from armctl.study.plan import sweep_plan

    arguments = (request.disturbances or []) + ([f"{SLOW_DOWN_NAME}={request.slow_down}"] if request.slow_down else [])
    levels = levels_of(arguments) if arguments else None
    pairs = pairs_of(request.pairs or [])

    def plan(options: Any) -> "Plan":
        options |= task_options | {"real_time": request.real_time}
        return sweep_plan(request.policies, request.env, levels, num_episodes, request.seed, options, pairs)

    files = "{0}/sweep.csv has the curves." if not pairs else "{0}/pairs.csv has the cells of pairs."
    play_study(request, request.out, plan, files)


@dataclass(frozen=True, kw_only=True)
class WorstCaseRequest:
    """Options of `worst-case`."""

    policies: Policies = None
    env: Env = DEFAULT_ENV
    disturbances: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME=END...",
            help="Disturbances of the box, each up to its strongest default level, or to an end: "
            "`--disturbances delay,noise=0.1,payload`.",
            show_default="delay,noise,payload,friction,mismatch, as far as the environment has them",
            autocompletion=completion.disturbances,
        ),
    ] = None
    budget: Annotated[int, typer.Option(help="Episodes of the search, for every policy: at least 50.")] = 300
    episodes: Annotated[
        int, typer.Option(min=1, help="New episodes at each of up to seven points that judge a search.")
    ] = 100
    seed: Seed = 0
    judge_seed: Annotated[
        int | None,
        typer.Option(
            parser=seed_of,
            metavar="SEED|test",
            help="Seed of these episodes: another one than the five of the search; `test` is the sealed one.",
            show_default="five more than --seed",
        ),
    ] = None
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for worst_case.csv, report.html and videos.", show_default="results/<date and time>"),
    ] = None
    video: Annotated[bool, typer.Option("--video/--no-video", help="Film a failure of each policy.")] = True
    overwrite: Overwrite = False
    worlds: Worlds = 1
    workers: Workers = 1
    on: On = "local"
    policy_seed: PolicySeed = None
    isolate: Isolate = False
    timeout: Timeout = None
    filter: Filter = False
    robot: Robot = None
    env_options: EnvOptions = None
    success: Success = None
    success_key: SuccessKey = None
    success_return: SuccessReturn = None
    table_format: Format = TableFormat.TABLE


@verb
def worst_case(request: WorstCaseRequest) -> None:
    """Search the mildest disturbance with which each policy fails half of the time, and judge it on new episodes.

    `armctl worst-case reach_ik reach_ppo --disturbances delay,noise,payload` answers how far a policy is from failure:
    the distance of a disturbance is the Euclidean norm of its levels, in units of their ranges, so that 1 is one
    disturbance at its end, and the others absent. The larger the distance, the more robust the policy.

    Each policy has the same budget of episodes, in five rounds: the first in the whole box, each later one in a smaller
    box around the mildest failure so far, by a logistic response surface. Its own episodes flatter a search, so new
    ones judge it, on the line through its result: the distance, with its interval, is where success falls to one half.

    The report has a video of a failure of each policy, and the command that shows it live. Every episode is written as
    it ends. After Ctrl-C, the same command with the same `--out` resumes.
    """
    env_options = options_of_env(request)
    from armctl.runtime.engines import connect
    from armctl.study.mildest_failure import worst_case as search

    folder = request.out or new_folder()
    box = None if request.disturbances is None else levels_by_name(request.disturbances)
    with connect(request.on, request.workers) as engine, progress_bar() as bar:
        task = bar.add_task("", total=None)
        result = search(
            request.policies, request.env, disturbances=box, seed=request.seed, out=folder,
            progress=lambda part, result: bar.update(task, description=f"{part} {result.policy}", advance=1),
            env_options=env_options, budget=request.budget, episodes=request.episodes, overwrite=request.overwrite,
            worlds=request.worlds, workers=engine, policy_seed=request.policy_seed, isolate=request.isolate,
            timeout=request.timeout,
            filter=request.filter,
            **({} if request.judge_seed is None else {"judge_seed": request.judge_seed}),
        )  # fmt: skip
    console = print_document(result.document(), request.table_format)
    exit_if_interrupted(result.interrupted, folder, console)
    if result.cases:
        console.print(f"{folder}/worst_case.csv has the table.", soft_wrap=True)
        make_report(folder, None, console, video=request.video)
    if result.problems:
        raise typer.Exit(1)


def levels_by_name(text: str) -> dict[str, Any]:
    """Return levels by disturbance, from NAME,NAME=LEVEL and so on."""
    return levels_of(re.split(r",(?=\s*[A-Za-z_])", text))


def levels_of(arguments: list[str]) -> dict[str, Any]:
    """Levels by disturbance, from NAME=LEVEL,LEVEL...; None from NAME without levels."""
    from armctl.core.options import option_value

    levels: dict[str, Any] = {}
    for argument in arguments:
        name, equals, numbers = argument.partition("=")
        levels[name] = option_value(f"[{numbers}]") if equals else None
    return levels


def pairs_of(arguments: list[str]) -> Any:
    """Return pairs of disturbances, from NAME,NAME or NAME=LEVEL,...,NAME=LEVEL,...; or `default`."""
    if arguments == ["default"]:
        return "default"
    return [levels_by_name(argument) for argument in arguments]
