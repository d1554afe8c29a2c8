"""The verb that plays all tasks with all their policies: `suite`."""

from pathlib import Path
from typing import Annotated

import typer

from armctl.cli import completion
from armctl.cli.app import app
from armctl.cli.evaluate import exit_if_interrupted, make_report, print_tracebacks
from armctl.cli.options import (
    Format,
    On,
    Overwrite,
    Seed,
    TableFormat,
    Workers,
    Worlds,
    new_folder,
    print_document,
    progress_bar,
)


@app.command()
def suite(
    envs: Annotated[
        list[str] | None,
        typer.Option(
            "--env",
            help="Environment, also one of your own; can be repeated. `all` stands for all installed ones: "
            "`--env all --env mine.py:Maze`.",
            show_default="all",
            autocompletion=completion.environments,
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="20 episodes, two disturbances: about five minutes with two workers.")
    ] = False,
    episodes: Annotated[
        int | None,
        typer.Option(min=1, help="Episodes that every policy plays in each setting.", show_default="50; 20 if quick"),
    ] = None,
    seed: Seed = 0,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the report and all sweeps.", show_default="results/<date and time>"),
    ] = None,
    overwrite: Overwrite = False,
    worlds: Worlds = 1,
    workers: Workers = 1,
    on: On = "local",
    video: Annotated[bool, typer.Option("--video", help="Film episodes for the tasks' own reports: minutes.")] = False,
    table_format: Format = TableFormat.TABLE,
) -> None:
    """Let all policies of all tasks play, undisturbed and under the main disturbances, and write one report.

    For each task, it answers whether a planner or controller is better than a learned agent: by how much, at what cost,
    and under which disturbance the order turns. The main disturbances are `noise`, `delay`, `payload`, `friction`,
    `pushes` and `mismatch`, at the middle and the strongest of their levels; `--quick` has `delay` and `mismatch`.

    With `--workers 2`, that takes less than an hour. Every episode is written as it ends. After Ctrl-C, the same
    command with the same `--out` resumes the suite. A task that fails is told, and does not stop the others.
    """
    from armctl.evaluation import suite as run_suite
    from armctl.evaluation.engines import connect
    from armctl.evaluation.suite import ALL

    folder = out or new_folder()
    with connect(on, workers) as engine, progress_bar() as bar:
        shown = bar.add_task("", total=None)

        def progress(setting: str, total: int) -> None:
            bar.update(shown, description=setting, total=total, advance=1)

        found = run_suite(
            envs or (ALL,),
            quick=quick,
            episodes=episodes,
            seed=seed,
            out=folder,
            overwrite=overwrite,
            worlds=worlds,
            workers=engine,
            progress=progress,
        )
    console = print_document(found.document(), table_format)
    if table_format is TableFormat.CSV:  # has no place for them
        for problem in found.problems:
            console.print(problem, soft_wrap=True)
    exit_if_interrupted(found.interrupted, folder, console)
    if found.tasks and "results" not in found.failures:
        make_report(folder, None, console, video=video)
    for swept in found.tasks.values():
        for one in swept.comparisons.values():
            print_tracebacks(one.tracebacks)
    if found.problems:
        raise typer.Exit(1)
