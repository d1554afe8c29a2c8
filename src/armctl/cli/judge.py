"""Verbs for results that armctl did not play: `judge`, and `log` for trials by hand."""

import os
import secrets
import sys
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armctl.cli.app import verb
from armctl.cli.options import Format, Overwrite, TableFormat, print_document

if TYPE_CHECKING:
    from armctl.judging.log import TrialLog


class FailIf(StrEnum):
    """Outcomes that a command may exit with status 1 for."""

    WORSE = "worse"
    UNDECIDED = "undecided"
    EQUIVALENT = "equivalent"
    BETTER = "better"


def _column(field: str, text: str) -> Any:
    option = typer.Option(f"--{field}-column", metavar="NAME", help=text, rich_help_panel="Columns")
    return Annotated[str | None, option]


@dataclass(frozen=True, kw_only=True)
class JudgeRequest:
    """Options of `judge`."""

    files: Annotated[list[Path], typer.Argument(help="Files or folders of results.", metavar="FILES...")]
    baseline: Annotated[
        str | None, typer.Option(metavar="POLICY", help="Compare all other policies with this one.",
                                 show_default="the two best with each other"),
    ] = None  # fmt: skip
    fail_if: Annotated[
        list[FailIf] | None,
        typer.Option(
            metavar="OUTCOME",
            help="Exit with status 1 if a policy is `worse`, `undecided`, `equivalent` or `better` against the "
            "`--baseline`; can be repeated.",
        ),
    ] = None
    margin: Annotated[
        float, typer.Option(metavar="POINTS", help="Success that differs by less, in percent, counts as equivalent.")
    ] = 2.0
    learned: Annotated[
        list[str] | None, typer.Option(metavar="POLICY", help="Policy that was trained; can be repeated.")
    ] = None
    any_number: Annotated[
        bool, typer.Option("--any-number", help="Trials are added until it is clear: the verdict holds at any number.")
    ] = False
    unpaired: Annotated[
        bool, typer.Option("--unpaired", help="Equal seeds or episode numbers are not the same initial conditions.")
    ] = False
    policies_in_columns: Annotated[
        bool, typer.Option("--policies-in-columns", help="Each policy has a column of successes, under its name.")
    ] = False
    success_return: Annotated[
        float | None, typer.Option(metavar="RETURN", help="Return from which on an episode counts as a success.")
    ] = None
    return_bounds: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="LOW HIGH", help="Least and largest possible return: then means have tests."),
    ] = None
    time_limit: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Time limit of a trial: a failure counts as that long.")
    ] = None
    max_steps: Annotated[
        int | None, typer.Option(metavar="N", help="Most steps of an episode: a failure counts as that many.")
    ] = None
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the tables and report.html.")] = None
    overwrite: Overwrite = False
    badge: Annotated[bool, typer.Option("--badge", help="Print one line of Markdown for each pair only.")] = False
    policy_column: _column("policy", "Policy.") = None  # type: ignore[valid-type]
    success_column: _column("success", "Success: yes or no.") = None  # type: ignore[valid-type]
    return_column: _column("return", "Return of the episode, or any score.") = None  # type: ignore[valid-type]
    time_column: _column("time", "Time, s.") = None  # type: ignore[valid-type]
    steps_column: _column("steps", "Steps.") = None  # type: ignore[valid-type]
    episode_column: _column("episode", "Number of the episode or initial condition.") = None  # type: ignore[valid-type]
    seed_column: _column("seed", "Seed of the episode.") = None  # type: ignore[valid-type]
    task_column: _column("task", "Task.") = None  # type: ignore[valid-type]
    condition_column: _column("condition", "Condition.") = None  # type: ignore[valid-type]
    training_seed_column: _column("training-seed", "Seed of the training.") = None  # type: ignore[valid-type]
    table_format: Format = TableFormat.TABLE


@verb
def judge(request: JudgeRequest) -> None:
    """Judge results that exist: whether a policy is better, by how much, and how certain that is.

    Reads CSV and other tables with a row for each episode, LeRobot's `eval_info.json`, Stable-Baselines3's
    `evaluations.npz` and Monitor files, rl-zoo's logs, vla-eval's and robo-evals' JSON, and armctl's results:
    `armctl judge old.csv new.csv --baseline old`. Columns are found by their usual names, or named. Files that are not
    clear are refused with the line and the reason.
    """
    from armctl.core.errors import ConfigurationError
    from armctl.judging import judge

    fail_if = set(request.fail_if or ())
    if fail_if and request.baseline is None:
        raise ConfigurationError("--fail-if needs a --baseline, against which a policy is better or worse")
    columns = {
        name.removesuffix("_column"): heading
        for name, heading in vars(request).items()
        if name.endswith("_column") and heading is not None
    }
    terms = {
        name: getattr(request, name)
        for name in (
            "baseline",
            "any_number",
            "unpaired",
            "policies_in_columns",
            "success_return",
            "return_bounds",
            "time_limit",
            "max_steps",
        )
    }
    judgement = judge(
        request.files, columns, learned=tuple(request.learned or ()), margin=request.margin / 100, **terms
    )
    if request.badge:
        from armctl.report.judgement import badge

        judgement.check_compared()
        print(badge(judgement))
    else:
        console = print_document(judgement.document(), request.table_format)
    if request.out is not None:
        from armctl.report.judgement import write_judgement

        report = write_judgement(judgement, request.out, request.overwrite)
        if not request.badge:
            console.print(f"{report} is the report.", soft_wrap=True)
    if fail_if and judgement.fails(fail_if):
        raise typer.Exit(1)


@dataclass(frozen=True, kw_only=True)
class LogRequest:
    """Options of `log`."""

    file: Annotated[Path, typer.Argument(help="CSV file of the log; one that is there is continued.", metavar="FILE")]
    names: Annotated[
        list[str] | None, typer.Argument(help="Names of the policies, for a new log.", metavar="[POLICY]...")
    ] = None
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Initial conditions, each for all policies.", show_default="20")
    ] = None
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the order of policies.", show_default="drawn")] = None
    blind: Annotated[bool, typer.Option("--blind", help="Show letters instead of policies until the end.")] = False
    key: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="With `--blind`: also write which letter is which policy."),
    ] = None
    unblind: Annotated[bool, typer.Option("--unblind", help="End the log here: write the policies' names.")] = False
    task: Annotated[
        str,
        typer.Option(help="Name of the task of a new log, to judge it beside others, such as a simulated one."),
    ] = ""


@verb
def log(request: LogRequest) -> None:
    """Log trials of a real robot by hand, in an order that is drawn for each initial condition.

    `armctl log trials.csv old new --episodes 20` asks after every trial: `y` or `n`, if you like with a time in seconds
    and a remark, as in `y 12.5 slow`; `u` takes the last one back, `q` stops. Every trial is kept at once, and the same
    command goes on. `armctl judge trials.csv` gives the verdict.
    """
    from armctl.core.errors import ConfigurationError
    from armctl.judging.log import TrialLog

    names = request.names or []
    if os.path.exists(request.file):
        trial_log = TrialLog.read(request.file)
        trial_log.check_plan(names, request.episodes, request.seed, request.task)
    elif not names or request.unblind:
        raise ConfigurationError(f"there is no log {request.file}: name the policies to begin one")
    else:
        seed = secrets.randbelow(2**31) if request.seed is None else request.seed
        episodes = request.episodes or 20
        trial_log = TrialLog.begin(request.file, names, episodes, seed, request.blind, request.key, request.task)
    if not request.unblind:
        _ask(trial_log)
    if trial_log.blind and (trial_log.is_complete or request.unblind):
        letters = ", ".join(f"{letter} is {policy}" for letter, policy in trial_log.letters.items())
        trial_log.unblind()
        print(f"Unblinded: {letters}.")
    done, total = len(trial_log.rows), len(trial_log.schedule)
    then = f"armctl judge {request.file} gives the verdict"
    if done < total:
        then = "the same command goes on" + ("" if trial_log.blind else f", {then}")
    print(f"{done} of {total} trials are in {request.file}: {then}.")


def _ask(trial_log: "TrialLog") -> None:
    """Ask for trials until all are logged, or until `q`, Ctrl-C or the end of the input."""
    from armctl.core.errors import ConfigurationError
    from armctl.judging.log import entry_of

    print("y or n, then a time in s and a remark if you like; u: take back the last one; q: stop")
    while True:
        if trial_log.is_complete:
            question = "all trials are logged; Enter: finish, u: take back the last one? "
        else:
            episode, policy = trial_log.schedule[len(trial_log.rows)]
            number = f"{len(trial_log.rows) + 1}/{len(trial_log.schedule)}"
            question = f"trial {number}, initial condition {episode}, policy {policy}: success? "
        print(question, end="", flush=True)
        try:
            line = sys.stdin.readline()
        except KeyboardInterrupt:
            line = ""
        word = line.strip().lower()
        if not line or word in ("q", "quit") or (trial_log.is_complete and not word):
            print()
            return
        if word in ("u", "undo"):
            removed = trial_log.undo()
            print(f"taken back: {', '.join(filter(None, removed))}" if removed else "there is nothing to take back")
        elif not trial_log.is_complete:
            try:
                success, seconds, remark = entry_of(line)
            except ConfigurationError as error:
                print(f"{error}: y or n?")
                continue
            trial_log.add(success, seconds, remark)
            time = None if seconds is None else f"{seconds:g} s"
            print("logged:", ", ".join(filter(None, ("success" if success else "failure", time, remark))))
