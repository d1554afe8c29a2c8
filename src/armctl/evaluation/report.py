"""Results on disk, and as tables on the terminal."""

import csv
import dataclasses
import json
import os
import platform
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table
from rich.text import Text

from armctl.errors import ResultsError
from armctl.evaluation.rollouts import COLUMNS
from armctl.evaluation.statistics import Estimate, PairedDifference

if TYPE_CHECKING:
    from armctl.evaluation.compare import Comparison

EPISODES, SUMMARY = "episodes.csv", "summary.json"


class EpisodeLog:
    """`episodes.csv`, written row by row, so that nothing finished is lost.

    Raises `ResultsError` if the folder cannot be written, or holds results that are not to be overwritten.
    """

    def __init__(self, folder: Path, overwrite: bool) -> None:
        self._path = folder / EPISODES
        if self._path.exists() and not overwrite:
            raise ResultsError(
                f"{folder} holds results already: choose another folder, or overwrite them (--overwrite)"
            )
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = self._path.open("w", newline="")
        except OSError as error:
            raise ResultsError(f"results cannot be written to {folder}: {error.strerror}") from error
        self._writer = csv.DictWriter(self._file, COLUMNS)

    def __enter__(self) -> "EpisodeLog":
        self._writer.writeheader()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def write(self, row: dict[str, Any]) -> None:
        """Add an episode, and hand it to the operating system."""
        try:
            self._writer.writerow(row)
            self._file.flush()
        except OSError as error:
            raise ResultsError(
                f"{self._path} could not be written any further ({error.strerror}); the episodes before are in it"
            ) from error


def write_summary(folder: Path, comparison: "Comparison") -> None:
    """Write `summary.json`: what was compared, with what, and what came out. Raises `ResultsError`."""
    summary = {
        "env": comparison.env,
        "env_options": {name: str(value) for name, value in comparison.env_options.items()},
        "seed": comparison.seed,
        "interrupted": comparison.interrupted,
        "failures": comparison.failures,
        "policies": [dataclasses.asdict(policy) for policy in comparison.policies],
        "paired": [dataclasses.asdict(difference) for difference in comparison.paired],
        "versions": versions(),
        "machine": {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()},
    }
    try:
        (folder / SUMMARY).write_text(json.dumps(summary, indent=2) + "\n")
    except OSError as error:
        raise ResultsError(f"{folder / SUMMARY} could not be written: {error.strerror}") from error


def versions() -> dict[str, str]:
    """Versions of what decides a result."""
    packages = ("armctl", "mujoco", "pin", "eaik", "gymnasium", "numpy", "scipy", "onnxruntime", "example-robot-data")
    return {"python": platform.python_version()} | {package: version(package) for package in packages}


def tables(comparison: "Comparison") -> Group:
    """The comparison for a terminal."""
    parts: list[Table | Text] = [_policy_table(comparison)]
    if comparison.paired:
        parts.append(_paired_table(comparison.paired))
    infeasible = max((policy.infeasible for policy in comparison.policies), default=0)
    if infeasible:
        parts.append(Text(f"{infeasible} episodes have a target out of reach; they are left out of the success rate."))
    parts += [Text(message, style="red") for message in comparison.failures.values()]
    if comparison.interrupted:
        parts.append(Text("Interrupted: these are the episodes that were finished.", style="yellow"))
    return Group(*parts)


def _policy_table(comparison: "Comparison") -> Table:
    table = Table(
        title=f"{comparison.env}, seed {comparison.seed}", title_justify="left", caption_justify="left", box=SIMPLE_HEAD
    )
    table.caption = "Second lines: 95 % intervals."
    table.add_column("policy", style="bold")
    for heading in ("success", "return", "steps to goal", "decision ms\np50, p99", "sees", "trained on\nsteps"):
        table.add_column(heading, justify="right")
    for policy in comparison.policies:
        table.add_row(
            f"{policy.policy}\n{policy.episodes - policy.infeasible} episodes",
            _percent(policy.success),
            _plain(policy.episode_return),
            _plain(policy.steps_to_goal),
            f"{policy.decision_ms_p50:.3f}\n{policy.decision_ms_p99:.3f}",
            policy.sees,
            f"{policy.training_steps:,}" if policy.training_steps else "-",
        )
    return table


def _paired_table(differences: list[PairedDifference]) -> Table:
    table = Table(
        title="Paired differences, on the same episodes", title_justify="left", caption_justify="left", box=SIMPLE_HEAD
    )
    table.caption = "p: McNemar's exact test for equal success. Steps: over the episodes that both won."
    table.add_column("a - b", style="bold")
    for heading in ("success", "won by only a\n/ only b", "p", "return", "steps to goal"):
        table.add_column(heading, justify="right")
    for pair in differences:
        table.add_row(
            f"{pair.a}\n- {pair.b}",
            f"{100 * (pair.only_a - pair.only_b) / pair.episodes:+.1f} %",
            f"{pair.only_a} / {pair.only_b}",
            f"{pair.mcnemar_p:.2g}",
            _plain(pair.return_difference, "+.1f"),
            _plain(pair.steps_difference, "+.1f"),
        )
    return table


def _percent(estimate: Estimate | None) -> str:
    if estimate is None:
        return "-"
    return f"{100 * estimate.value:.1f} %\n{100 * estimate.low:.1f} to {100 * estimate.high:.1f}"


def _plain(estimate: Estimate | None, form: str = ".1f") -> str:
    if estimate is None:
        return "-"
    return f"{estimate.value:{form}}\n{estimate.low:{form}} to {estimate.high:{form}}"
