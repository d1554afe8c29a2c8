"""Verbs that compare: `compare`, `plan`, `report`, `reproduce`."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armctl import DEFAULT_ENV
from armctl.cli import completion
from armctl.cli.app import app, settings, verb
from armctl.cli.options import (
    Env,
    EnvOptions,
    Format,
    On,
    Overwrite,
    Policies,
    PolicySeed,
    RealTime,
    ReturnBounds,
    Seed,
    SuccessReturn,
    TableFormat,
    Workers,
    Worlds,
    new_folder,
    options_of,
    print_document,
    progress_bar,
    seed_of,
)

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class CompareRequest:
    """Options of `compare`."""

    policies: Policies = None
    env: Env = DEFAULT_ENV
    episodes: Annotated[int, typer.Option(min=1, help="Episodes that every policy plays.")] = 200
    seed: Seed = 0
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for episodes.csv and summary.json.", show_default="results/<date and time>"),
    ] = None
    overwrite: Overwrite = False
    worlds: Worlds = 1
    workers: Workers = 1
    on: On = "local"
    env_options: EnvOptions = None
    success_return: SuccessReturn = None
    return_bounds: ReturnBounds = None
    baseline: Annotated[
        str | None,
        typer.Option(
            metavar="POLICY",
            help="Hold all other policies against this one.",
            show_default="the best classical against the best learned policy",
        ),
    ] = None
    margin: Annotated[
        float, typer.Option(metavar="POINTS", help="Success that differs by less, in percent, counts as equivalent.")
    ] = 2.0
    real_time: RealTime = None
    slow_down: Annotated[
        float, typer.Option(metavar="FACTOR", help="In real time, decisions take so many times as long.")
    ] = 1.0
    policy_seed: PolicySeed = None
    report: Annotated[bool, typer.Option("--report", help="Also write report.html, with figures and videos.")] = False
    table_format: Format = TableFormat.TABLE


@verb
def compare(request: CompareRequest) -> None:
    """Let policies play the same episodes, and print which is better, and by how much.

    `"reach_bc[*]"` is all trainings of a recipe as one learner: the shipped one and its other training seeds, or for a
    path, `"runs/reach_ppo[*]"`, those that `armctl train` has made. `"reach_bc[1]"` is the one of training seed 1.

    Every episode is written as it ends. After Ctrl-C, the same command with the same `--out` resumes the comparison.
    A policy that raises an error, or returns an invalid action, loses that episode (`error`) and plays on; the exit
    status is then 1. One that fails before its first action in each of its first 3 episodes stops.
    """
    from armctl.episodes import EpisodeResult
    from armctl.policies import expanded, named_policies
    from armctl.runtime.engines import connect
    from armctl.study import compare as run_comparison
    from armctl.study.line_up import default_policies

    names = request.policies or default_policies(request.env)
    players, _ = expanded(named_policies(names))
    folder = request.out or new_folder()
    with connect(request.on, request.workers) as engine, progress_bar() as bar:
        bars = {name: bar.add_task(name, total=request.episodes) for name in players}

        def progress(result: EpisodeResult) -> None:
            bar.advance(bars[result.policy])

        comparison = run_comparison(
            names,
            request.env,
            episodes=request.episodes,
            seed=request.seed,
            out=folder,
            overwrite=request.overwrite,
            worlds=request.worlds,
            workers=engine,
            env_options=options_of(request.env_options, success_return=request.success_return),
            baseline=request.baseline,
            margin=request.margin / 100,
            progress=progress,
            real_time=request.real_time,
            slow_down=request.slow_down,
            return_bounds=request.return_bounds,
            policy_seed=request.policy_seed,
        )
    console = print_document(comparison.document(), request.table_format)
    written = "results" not in comparison.failures
    if written:
        console.print(
            f"{folder / 'episodes.csv'} has every episode, {folder / 'summary.json'} the tables.", soft_wrap=True
        )
    exit_if_interrupted(comparison.interrupted, folder, console)
    if request.report and written:
        make_report(folder, None, console)
    print_tracebacks(comparison.tracebacks)
    if comparison.failures:
        raise typer.Exit(1)


@app.command()
def plan(
    detect: Annotated[float, typer.Option(metavar="POINTS", help="Difference in success to tell, in percent.")] = 2.0,
    power: Annotated[float, typer.Option(help="Probability of telling it, if it is there.")] = 0.8,
    pilot: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Results of an earlier comparison, whose pairs are planned for.")
    ] = None,
    pairs: Annotated[
        int | None,
        typer.Option(min=1, help="Pairs that the tests are corrected for.", show_default="the pilot's, or 1"),
    ] = None,
    table_format: Format = TableFormat.TABLE,
) -> None:
    """Tell how many episodes a comparison needs to show a difference in success, or that there is none.

    That depends on the episodes that exactly one of two policies wins. A pilot, such as 50 episodes with
    `armctl compare --out pilot`, gives their share for each pair; without one, the table has common shares. With
    several pairs, tests are corrected as a verdict's are.
    """
    from armctl.study.sample_size import plan_comparison

    print_document(plan_comparison(detect / 100, power, pilot, pairs), table_format)


@app.command()
def report(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of the results of a comparison, a sweep or a suite.")
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="HTML file to write.", show_default="DIR/report.html")
    ] = None,
    video: Annotated[
        bool | None,
        typer.Option(
            "--video/--no-video", help="Play some episodes again for videos.", show_default="unless a suite's"
        ),
    ] = None,
    env: Annotated[
        str | None, typer.Option("--env", help="Environment of your own that the results name, such as mine:Maze.")
    ] = None,
    policies: Annotated[
        list[str] | None,
        typer.Option("--policy", metavar="POLICY", help="Policy of your own that they name; can be repeated."),
    ] = None,
) -> None:
    """Write the report of a comparison, a sweep or a suite: one HTML file, for offline, phone and print.

    A results folder never runs code. If its environment or policies are modules of your own, the videos need their
    names on the command line too, as `--env` and `--policy`.
    """
    from armctl.core.console import PlainConsole

    make_report(folder, out, PlainConsole(), video=video, env=env, policies=policies or ())


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
) -> None:
    """Write a report, and say where it is."""
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
            progress=lambda doing: status.update(Text(f"report: {doing}")),
        )
    console.print(f"{path} is the report: open it in a browser.", soft_wrap=True)


@app.command()
def episodes(
    folder: Annotated[Path, typer.Argument(help="Results of a comparison, a sweep or a suite.")],
    csv: Annotated[bool, typer.Option("--csv", help="Write episodes.csv and decisions.csv.")] = False,
    parquet: Annotated[
        bool, typer.Option("--parquet", help="Write episodes.parquet, small and typed; needs the extra `parquet`.")
    ] = False,
) -> None:
    """Write the episodes in a results folder as tables for other programs.

    Comparisons, sweeps and suites write the CSV tables themselves when they end; armctl does not read any of them.
    """
    from rich.console import Console

    from armctl.core.errors import ConfigurationError, ResultsError
    from armctl.episodes.output import write_csv, write_parquet
    from armctl.episodes.stored import UNDISTURBED, read_store
    from armctl.study.plan import COMPARISON

    if not (csv or parquet):
        raise ConfigurationError("say what to write: --csv, --parquet or both")
    stored = read_store(folder)
    cells = {name: cell.episodes.sorted(cell.identity["policies"]) for name, cell in stored.cells.items()}
    results = cells[UNDISTURBED] if stored.record.get("kind") == COMPARISON else cells
    console = Console(highlight=False)
    try:
        for write in [write_csv] * csv + [write_parquet] * parquet:
            for path in write(folder, results):
                console.print(path, soft_wrap=True)
    except OSError as error:
        raise ResultsError(f"tables cannot be written to {folder}: {error.strerror}") from error


@app.command()
def reproduce(
    agents: Annotated[
        list[str],
        typer.Argument(
            help="Agents: their cards' paths, or the names of shipped ones.", autocompletion=completion.agents
        ),
    ],
    seed: Annotated[
        int | None,
        typer.Option(
            parser=seed_of,
            metavar="SEED|test",
            help="Seed of other episodes; `test` is the sealed one.",
            show_default="the card's: the same episodes",
        ),
    ] = None,
    worlds: Annotated[int, typer.Option(min=1, help="Worlds stepped at once.")] = 64,
    env: Annotated[
        str | None,
        typer.Option("--env", help="Environment of your own that the cards name.", show_default="the cards'"),
    ] = None,
    table_format: Format = TableFormat.TABLE,
) -> None:
    """Evaluate learned agents again, and compare the results with their cards.

    On the card's own episodes, all of its figures have to come out the same; on those of another --seed, tests of
    success, return and steps must not tell both apart (5 %). Otherwise the exit status is 1.
    """
    from rich.text import Text

    from armctl.core.console import PlainConsole
    from armctl.report.reproduction import reproduction_document
    from armctl.study.reproduce import card_path
    from armctl.study.reproduce import reproduce as run_again

    for agent in agents:
        card_path(agent)  # a misspelt name is told before the first agent plays
    again = []
    for agent in agents:
        with PlainConsole(stderr=True).status(Text(f"{agent}: playing its episodes again")):
            again.append(run_again(agent, seed=seed, worlds=worlds, env=env))
    print_document(reproduction_document(again), table_format)
    if not all(reproduction.agrees for reproduction in again):
        raise typer.Exit(1)
