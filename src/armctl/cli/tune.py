"""The verb that looks for better values of a recipe's or an expert's options: `tune`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from armctl.cli import completion
from armctl.cli.app import verb
from armctl.cli.options import Format, On, TableFormat, Workers, exit_if_interrupted, print_document, progress_bar

if TYPE_CHECKING:
    from armctl.tuning import TuningOutcome


def checked_candidate(name: str) -> str:
    """Return a name of something that can be tuned: before anything is loaded, an unknown one is told."""
    from armctl.tuning.names import check_tunable

    check_tunable(name)
    return name


@dataclass(frozen=True)
class TuneRequest:
    """Options of `tune`."""

    name: Annotated[
        str,
        typer.Argument(
            help="Recipe or expert with a search space, such as `reach_sac` or `reach_mpc`, or path/to/file.toml.",
            autocompletion=completion.tunable,
            callback=checked_candidate,
        ),
    ]
    trials: Annotated[
        int | None, typer.Option(min=1, help="Total number of trials.", show_default="50, unless hours are given")
    ] = None
    hours: Annotated[
        float | None, typer.Option(help="Processor hours of all trials together: ends at whichever comes first.")
    ] = None
    score: Annotated[str, typer.Option(help="What is maximised: `return` or `success`.")] = "return"
    training_seeds: Annotated[
        int, typer.Option(min=1, help="Trainings of each trial of a recipe; their median counts.")
    ] = 2
    episodes: Annotated[int, typer.Option(min=1, help="Development episodes of each trial of an expert.")] = 200
    env: Annotated[
        str | None, typer.Option("--env", help="Environment.", show_default="the recipe's, or the expert's")
    ] = None
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search.")] = 0
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the tuning; the same one resumes it.", show_default="tuned/<name>"),
    ] = None
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Continue the trainings of a trial whose process died, from their checkpoints: pickles, which can "
            "run any code. Without it, such a trial begins anew.",
        ),
    ] = False
    workers: Workers = 1
    on: On = "local"
    table_format: Format = TableFormat.TABLE


@verb
def tune(request: TuneRequest) -> None:
    """Tune a recipe's or an expert's options with Optuna; needs the extra `tune`.

    `armctl tune reach_sac --trials 30` and `armctl tune reach_mpc --hours 2`: both sides of a comparison can be tuned
    for as long, in processor hours. What may be varied stands in the table `[tune]` of a recipe
    (`hidden_units = { choices = [64, 128] }`, `gamma = { low = 0.9, high = 0.999 }`), or in a file like it beside an
    expert.

    The first trial uses the present values. Neither side sees the test episodes: agents are judged by the held-out
    episodes by which the best one of a training is chosen, experts by the same. A trial that is worse than the median
    of the others at the same point is pruned.

    The folder has the journal, which other processes may join by the same command, also from other machines; a row for
    each trial in `trials.csv`; `tuning.html` with Optuna's plots; and the best values as a file, for `armctl train` or
    `armctl compare`. After Ctrl-C or a crash, the same command resumes; with `--resume`, trainings too.
    """
    from armctl.core.errors import missing_extra

    try:
        import optuna  # noqa: F401
    except ModuleNotFoundError as error:
        raise missing_extra("tuning", error, "tune") from error
    from armctl.report.tuning_page import document, write_tuning_page
    from armctl.runtime.engines import connect
    from armctl.tuning import candidate_of
    from armctl.tuning import tune as run_tuning

    candidate = candidate_of(
        request.name,
        score=request.score,  # type: ignore[arg-type]
        training_seeds=request.training_seeds,
        episodes=request.episodes,
        env=request.env,
    )
    folder = request.out or Path("tuned") / Path(request.name).stem
    budget = 50 if request.trials is None and request.hours is None else request.trials
    with connect(request.on, request.workers) as engine, progress_bar() as bar:
        task = bar.add_task("trials", total=budget)

        def progress(outcome: "TuningOutcome") -> None:
            best = outcome.best
            description = f"best {best.value:.4g}" if best else "trials"
            bar.update(task, description=description, completed=len(outcome.trials))

        outcome = run_tuning(
            candidate, folder, trials=budget, hours=request.hours, seed=request.seed, workers=engine,
            resume=request.resume, progress=progress,
        )  # fmt: skip
    page = write_tuning_page(outcome)
    console = print_document(document(outcome), request.table_format)
    console.print(f"{page} shows all trials; what they found is beside it.", soft_wrap=True)
    exit_if_interrupted(outcome.interrupted, folder, console)
