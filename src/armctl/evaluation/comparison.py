"""What a comparison has found, and its `summary.json`."""

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
from armctl.evaluation.store import SUMMARY, write_whole
from armctl.evaluation.summary import PolicySummary


@dataclass
class Comparison:
    """What a comparison found; with an interrupt or a failure, as far as it came."""

    env: str
    seed: int
    env_options: Mapping[str, Any]
    episodes: pd.DataFrame
    """A row for each policy and episode: the columns of `episodes.csv`."""
    policies: list[PolicySummary] = field(default_factory=list)
    paired: list[PairedDifference] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)
    """What went wrong: by policy, under `results` for what could not be written, or under `workers`."""
    interrupted: bool = False
    resumed: int = 0
    """Episodes that an earlier run had finished."""


def write_summary(folder: Path, comparison: Comparison) -> None:
    """Write `summary.json`: what was compared, with what, and what came out. Raises `ResultsError`."""
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
        write_whole(folder / SUMMARY, json.dumps(summary, indent=2) + "\n")
    except OSError as error:
        raise ResultsError(f"{folder / SUMMARY} could not be written: {error.strerror}") from error
