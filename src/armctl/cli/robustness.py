"""Verbs of robustness: `sweep` under disturbances."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armctl.cli import completion
from armctl.cli.app import verb
from armctl.cli.compare import TaskRequest, play_study

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
    return [levels_of(re.split(r",(?=\s*[A-Za-z_])", argument)) for argument in arguments]
