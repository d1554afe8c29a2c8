"""Options that several verbs share, parsers of their text, and functions that print results."""

import itertools
import os.path
import sys
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armctl.cli import completion
from armctl.cli.app import settings
from armctl.cli.standard_output import document_stream
from armctl.core.errors import ConfigurationError, no_results

if TYPE_CHECKING:
    from rich.console import Console

    from armctl.study.study import Study
    from armctl.verdict.tables import Document


def checked_env(env: str | None) -> str | None:
    """Return an environment that may be there: before anything is loaded, an unknown id is told."""
    from armctl.envs.find import find_spec

    if env is not None and ":" not in env:
        find_spec(env)
    return env


def checked_policy(name: str | None) -> str | None:
    """Return a policy that may be there, or the agent in a folder: an unknown name is told before it is loaded."""
    from armctl.policies.names import check_policy_name, with_agent

    if name is None:
        return None
    name = with_agent(name)
    check_policy_name(name)
    return name


def checked_policies(names: list[str] | None) -> list[str] | None:
    """Return policies as `checked_policy` does."""
    return None if names is None else [name for name in map(checked_policy, names) if name is not None]


def checked_agents(agents: list[str]) -> list[str]:
    """Return agents that may be there: before the first plays, an unknown name is told."""
    from armctl.policies.trainings import card_path

    for agent in agents:
        card_path(agent)
    return agents


def existing_folder(folder: Path | None) -> Path | None:
    """Return a folder of results that is there. Raises `ResultsError`."""
    if folder is not None and not os.path.isdir(folder):  # also for a name that no folder can have
        raise no_results(folder)
    return folder


Env = Annotated[
    str,
    typer.Option(
        "--env",
        metavar="ID",
        help="Environment: an id (`armctl list` shows armctl's own), Gymnasium's `Pendulum-v1`, or `file.py:NAME`.",
        autocompletion=completion.environments,
        callback=checked_env,
    ),
]
PolicyName = Annotated[
    str,
    typer.Argument(
        help="Policy: a name, an agent's file or folder, or `file.py:NAME` of a function or class of yours.",
        autocompletion=completion.policies,
        callback=checked_policy,
    ),
]


def seed_of(text: str) -> int:
    """Return the seed that a command line names: a whole number, or `test`."""
    from armctl.core.seeds import TEST, TEST_SEED

    text = str(text)  # of a default, which is a number
    if text == TEST:
        return TEST_SEED
    if not text.isdecimal():
        raise typer.BadParameter(f"{text!r} is not a whole number from 0 on, or {TEST!r} for the sealed test.")
    return int(text)


Seed = Annotated[
    int,
    typer.Option(
        parser=seed_of,
        metavar="SEED|test",
        help="Seed of the episodes: any for development; `test` is the sealed one, only for figures to publish.",
    ),
]
EnvOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Option of the environment; can be repeated: `--set control=velocity --set tolerance=0.02`.",
        autocompletion=completion.environment_options,
    ),
]
Robot = Annotated[
    str | None,
    typer.Option(
        "--robot",
        metavar="NAME|FILE",
        help="Robot: short for `--set robot=...`.",
        show_default="the environment's",
        autocompletion=completion.robots,
    ),
]
Worlds = Annotated[
    int,
    typer.Option(
        min=1,
        help="Worlds stepped at once. With 1, decision times are latencies; with more, a batch's time per world, and "
        "no deadlines are judged.",
    ),
]

Workers = Annotated[
    int,
    typer.Option(
        min=1,
        help="Parallel processes that play episodes, each on one core. With more than 1, decision times are measured "
        "while the other processes compute, and no deadlines are judged.",
    ),
]
On = Annotated[
    str,
    typer.Option(
        "--on",
        metavar="ENGINE",
        help="Where to run: `local`, with `--workers`, or on a cluster: `ray://HOST:PORT`, "
        "`dask://HOST:PORT`, or `ray` for the one that this machine belongs to; needs the extra `cluster`.",
    ),
]
Policies = Annotated[
    list[str] | None,
    typer.Argument(
        help='Policies: names, agents\' files or folders, `"NAME[*]"` for all trainings of a recipe, or '
        "`file.py:NAME` of yours.",
        show_default="those of the environment",
        autocompletion=completion.policies,
        callback=checked_policies,
    ),
]

RealTime = Annotated[
    str | None,
    typer.Option(
        "--real-time",
        metavar="measured|DIR",
        help="The world does not wait: a decision longer than the control period takes effect when it is ready. With "
        "`measured` times (one world, one worker), or those in the results folder DIR, which repeat exactly.",
    ),
]


class TableFormat(StrEnum):
    """Format in which results are printed."""

    TABLE = "table"
    MARKDOWN = "markdown"
    LATEX = "latex"
    JSON = "json"
    CSV = "csv"


Format = Annotated[
    TableFormat,
    typer.Option(
        "--format",
        metavar="FORMAT",
        help="`table`, `markdown`, `latex`, `json` or `csv`. With any other than `table`, standard output has nothing "
        "else.",
    ),
]


def checked_policy_seed(seed: int | None) -> int | None:
    """Return a secret of a run. Raises `ConfigurationError`."""
    from armctl.envs.policy_seed import chosen_policy_seed

    return None if seed is None else chosen_policy_seed(seed)


PolicySeed = Annotated[
    int | None,
    typer.Option(
        "--policy-seed",
        metavar="N",
        callback=checked_policy_seed,
        help="Secret from which policies draw their own random numbers: give the one in summary.json for an exact "
        "repeat.",
        show_default="the folder's, or 128 random bits",
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the results in the folder.")]


def new_folder() -> Path:
    """Return a folder for results that is not there yet, named after the current time."""
    from datetime import datetime

    date = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    names = itertools.chain([date], (f"{date}_{i}" for i in itertools.count(2)))  # of commands in the same second
    return next(folder for folder in (Path("results", name) for name in names) if not folder.exists())


def print_document(document: "Document", table_format: TableFormat) -> "Console":
    """Print results on standard output, and return where to say anything else: not in the midst of JSON."""
    from armctl.core.console import PlainConsole, printable
    from armctl.report.formats import FORMATS
    from armctl.report.terminal import DocumentView, output_console

    if table_format is TableFormat.TABLE:
        console = output_console()
        console.print(DocumentView(document))
        return console
    text = FORMATS[table_format](document)
    text = text if table_format is TableFormat.JSON else printable(text)  # JSON has escapes of its own
    print(text, end="", file=document_stream())
    return PlainConsole(stderr=True)


def progress_bar() -> Any:
    """Return a progress display on standard error; nothing where that is not a terminal."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from armctl.core.console import PlainConsole

    columns = (
        TextColumn("{task.description:>12}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    console = PlainConsole(stderr=True)
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


def print_tracebacks(tracebacks: Mapping[str, str]) -> None:
    """Print tracebacks on standard error, if asked for."""
    from armctl.core.console import printable

    if settings.traceback:
        for name, text in tracebacks.items():
            print(printable(f"{name}:\n{text}"), file=sys.stderr)


def exit_if_interrupted(interrupted: bool, folder: Path, console: "Console") -> None:
    """After an interrupt, say how to resume, and exit with status 130."""
    if interrupted:
        console.print(f"The same command with --out {folder} resumes from there.", soft_wrap=True)
        raise typer.Exit(130)


def make_report(
    folder: Path,
    out: Path | None,
    console: "Console",
    *,
    video: bool | None = None,
    env: str | None = None,
    policies: Sequence[str] = (),
    study: "Study | None" = None,
) -> None:
    """Write the report of a folder, or of the `study` that was just played into it, and say where it is."""
    from rich.text import Text

    from armctl.core.console import PlainConsole
    from armctl.report import write_report

    with PlainConsole(stderr=True).status("report") as status:
        path = write_report(
            folder,
            out,
            video=video,
            env=env,
            policies=policies,
            study=study,
            progress=lambda doing: status.update(Text(f"report: {doing}")),
        )
    console.print(f"{path} is the report: open it in a browser.", soft_wrap=True)


def environment_options(env: str, pairs: list[str] | None, **short_forms: Any) -> dict[str, Any]:
    """Options of an environment, of `options_of`. Their names are checked before anything is loaded."""
    from armctl.envs.find import check_option_names

    options = options_of(pairs, **short_forms)
    check_option_names(env, options)
    return options


def options_of(pairs: list[str] | None, flag: str = "--set", **short_forms: Any) -> dict[str, Any]:
    """Options from NAME=VALUE pairs, numbers, tuples, true, false and None, or else strings; and from short forms."""
    from armctl.core.options import option_value

    options = {name: value for name, value in short_forms.items() if value is not None}
    for pair in pairs or []:
        name, equals, value = pair.partition("=")
        if not equals:
            raise ConfigurationError(f"{flag} needs NAME=VALUE, not {pair!r}")
        if short_forms.get(name) is not None:
            raise ConfigurationError(f"--{name.replace('_', '-')} and {flag} {pair} say the same: leave one out")
        options[name] = option_value(value)
    return options
