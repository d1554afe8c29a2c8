"""The result of a comparison, and its `summary.json`."""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from armctl.errors import ResultsError
from armctl.evaluation.provenance import machine, versions
from armctl.evaluation.statistics import PairedDifference
from armctl.evaluation.store import SUMMARY
from armctl.evaluation.summary import PolicySummary
from armctl.files import write_atomically


@dataclass
class Comparison:
    """The result of a comparison. After an interrupt or a failure, it covers the finished episodes."""

    env: str
    seed: int
    env_options: Mapping[str, Any]
    episodes: pd.DataFrame
    """One row per policy and episode, with the columns of `episodes.csv`."""
    policies: list[PolicySummary] = field(default_factory=list)
    paired: list[PairedDifference] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)
    """Error messages: by policy, under `results` if results could not be written, or under `workers`."""
    interrupted: bool = False
    resumed: int = 0
    """Number of episodes that an earlier run had finished."""


def write_summary(folder: Path, comparison: Comparison) -> None:
    """Write `summary.json`: settings, results, versions and machine. Raises `ResultsError`."""
    summary = {
        "env": comparison.env,
        "env_options": {name: str(value) for name, value in comparison.env_options.items()},
        "seed": comparison.seed,
        "interrupted": comparison.interrupted,
        "resumed": comparison.resumed,
        "failures": comparison.failures,
        "policies": [dataclasses.asdict(policy) for policy in comparison.policies],
        "paired": [dataclasses.asdict(difference) for difference in comparison.paired],
        "versions": versions(),
        "machine": machine(),
    }
    try:
        write_atomically(folder / SUMMARY, json.dumps(summary, indent=2) + "\n")
    except OSError as error:
        raise ResultsError(f"{folder / SUMMARY} could not be written: {error.strerror}") from error
