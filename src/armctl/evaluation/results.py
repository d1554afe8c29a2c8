"""Reads a comparison's folder back, without playing anything."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd
from pydantic import TypeAdapter, ValidationError

from armctl.errors import ResultsError
from armctl.evaluation.comparison import Comparison
from armctl.evaluation.record import EpisodeResult
from armctl.evaluation.statistics import PairedDifference
from armctl.evaluation.store import COMPARISON, SUMMARY, read_episodes
from armctl.evaluation.summary import PolicySummary, counted_results
from armctl.options import option_value

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class _Identity:
    """The part of `comparison.json` that the report uses."""

    policies: list[str]


@dataclass(frozen=True)
class _Summary:
    """`summary.json`, as `armctl.evaluation.comparison.write_summary` writes it."""

    env: str
    env_options: dict[str, str]
    seed: int
    interrupted: bool
    resumed: int
    failures: dict[str, str]
    policies: list[PolicySummary]
    paired: list[PairedDifference]
    versions: dict[str, str]
    machine: dict[str, Any]
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Results:
    """A comparison, and each of its episodes."""

    comparison: Comparison
    names: list[str]
    """Names of all compared policies, in order."""
    episodes: Mapping[str, list[EpisodeResult]]
    """The episodes that count, by policy; policies without any are left out."""
    versions: Mapping[str, str]
    machine: Mapping[str, Any]


def read_results(folder: Path) -> Results:
    """Read the folder of a finished or interrupted comparison.

    Raises `ResultsError` if a file is missing or damaged.
    """
    identity = _read(folder / COMPARISON, _Identity)
    if not (folder / SUMMARY).exists():
        raise ResultsError(
            f"{folder} has no {SUMMARY}: its comparison is unfinished; the same command with --out {folder} resumes it"
        )
    summary = _read(folder / SUMMARY, _Summary)
    results = read_episodes(folder, {"env": summary.env, "seed": summary.seed, "policies": identity.policies})
    results.sort(key=lambda result: (identity.policies.index(result.policy), result.episode))
    counted, _ = counted_results(results)
    if {name for name, played in counted.items() if played} != {policy.policy for policy in summary.policies}:
        raise ResultsError(f"{folder / SUMMARY} does not belong to the episodes beside it: run the comparison again")
    comparison = Comparison(
        summary.env,
        summary.seed,
        {name: option_value(value) for name, value in summary.env_options.items()},
        pd.DataFrame([result.row() for result in results]),
        summary.policies,
        summary.paired,
        summary.failures,
        notes=summary.notes,
        interrupted=summary.interrupted,
        resumed=summary.resumed,
    )
    return Results(
        comparison,
        identity.policies,
        {policy.policy: counted[policy.policy] for policy in summary.policies},
        summary.versions,
        summary.machine,
    )


def _read(path: Path, kind: type[Kind]) -> Kind:
    try:
        return TypeAdapter(kind).validate_python(json.loads(path.read_text()))
    except (OSError, ValueError, RecursionError) as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise ResultsError(f"{path} cannot be read as results of a comparison: {why}") from error
