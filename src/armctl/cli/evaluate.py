"""Verbs around comparisons: `plan`, `report`, `episodes`, `reproduce`."""

from pathlib import Path
from typing import Annotated

import typer

from armctl.cli import completion
from armctl.cli.app import command
from armctl.cli.options import (
    Format,
    TableFormat,
    checked_agents,
    existing_folder,
    make_report,
    print_document,
    seed_of,
)
from armctl.cli.standard_output import standard_output


@command()
def plan(
    detect: Annotated[float, typer.Option(metavar="POINTS", help="Difference in success to detect, in percent.")] = 2.0,
    power: Annotated[float, typer.Option(help="Power: the probability of detecting it.")] = 0.8,
    pilot: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Results of an earlier comparison, whose pairs are planned for.",
            callback=existing_folder,
        ),
    ] = None,
    pairs: Annotated[
        int | None,
        typer.Option(min=1, help="Pairs that the tests are corrected for.", show_default="the pilot's, or 1"),
    ] = None,
    unpaired: Annotated[
        bool,
        typer.Option("--unpaired", help="Policies play different episodes, as an unpaired pilot's do."),
    ] = False,
    table_format: Format = TableFormat.TABLE,
) -> None:
    """Compute how many episodes a comparison needs to show a difference in success, or equivalence.

    That depends on the episodes that exactly one of two policies wins. A pilot, such as 50 episodes with
    `armctl compare --out pilot`, gives their share for each pair; without one, the table has common shares. Of
    different episodes, it depends on success. With several pairs, tests are corrected as a verdict's are.
    """
    from armctl.study.sample_size import plan_comparison

    print_document(plan_comparison(detect / 100, power, pilot, pairs, unpaired), table_format)


@command()
def report(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Folder of the results of a comparison, a sweep, a suite or a search for worst cases.",
            callback=existing_folder,
        ),
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
    """Write the report of a comparison, a sweep, a suite or worst cases: one HTML file, for offline, phone and print.

    A results folder never runs code. If its environment or policies are modules of your own, the videos need their
    names on the command line too, as `--env` and `--policy`.
    """
    from armctl.core.console import PlainConsole

    make_report(folder, out, PlainConsole(), video=video, env=env, policies=policies or ())


@command()
def episodes(
    folder: Annotated[
        Path, typer.Argument(help="Results of a comparison, a sweep or a suite.", callback=existing_folder)
    ],
    csv: Annotated[bool, typer.Option("--csv", help="Write episodes.csv and decisions.csv.")] = False,
    parquet: Annotated[
        bool, typer.Option("--parquet", help="Write episodes.parquet, small and typed; needs the extra `parquet`.")
    ] = False,
) -> None:
    """Write the episodes in a results folder as tables for other programs.

    Comparisons, sweeps and suites write the CSV tables themselves when they end; armctl does not read any of them.
    """
    from rich.console import Console

    from armctl.core.errors import ConfigurationError, os_errors_as
    from armctl.episodes.output import write_csv, write_parquet
    from armctl.episodes.stored import UNDISTURBED, read_store
    from armctl.study.names import COMPARISON

    if not (csv or parquet):
        raise ConfigurationError("say what to write: --csv, --parquet or both")
    stored = read_store(folder)
    cells = {name: cell.episodes.sorted(cell.identity["policies"]) for name, cell in stored.cells.items()}
    results = cells[UNDISTURBED] if stored.record.get("kind") == COMPARISON else cells
    console = Console(highlight=False)
    with os_errors_as(f"tables cannot be written to {folder}"):
        for write in [write_csv] * csv + [write_parquet] * parquet:
            for path in write(folder, results):
                console.print(path, soft_wrap=True)


@command()
def reproduce(
    agents: Annotated[
        list[str],
        typer.Argument(
            help="Agents: their cards' paths, their folders, or the names of shipped ones.",
            autocompletion=completion.agents,
            callback=checked_agents,
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

    On the card's own episodes, all of its figures must be equal; on those of another --seed, tests of
    success, return and steps must not tell both apart (5 %). Otherwise the exit status is 1.
    """
    from rich.text import Text

    from armctl.core.console import PlainConsole
    from armctl.report.reproduction import reproduction_document
    from armctl.study.reproduce import reproduce as run_again

    again = []
    with standard_output(table_format):
        for agent in agents:
            with PlainConsole(stderr=True).status(Text(f"{agent}: playing its episodes again")):
                again.append(run_again(agent, seed=seed, worlds=worlds, env=env))
        print_document(reproduction_document(again), table_format)
    if not all(reproduction.agrees for reproduction in again):
        raise typer.Exit(1)
