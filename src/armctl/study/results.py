"""Reads a comparison's folder back, without playing anything."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from armctl.core.errors import ResultsError
from armctl.core.files import bounded_text, digest, unsealed
from armctl.core.options import option_value
from armctl.episodes.store import COMPARISON, SUMMARY, read_episodes
from armctl.episodes.table import EpisodeTable
from armctl.policies import learners
from armctl.runtime.provenance import Run, earlier_looks
from armctl.stats.paired import MARGIN, PairedDifference
from armctl.study.comparison import Comparison
from armctl.verdict.scores import by_learner
from armctl.verdict.summary import PolicySummary, counted_results

Kind = TypeVar("Kind")
LONGEST_OPTION = 1_000
"""Characters of an option's text; to read long ones as Python takes much time and memory."""


@dataclass(frozen=True)
class _Identity:
    """The part of `comparison.json` that the report uses."""

    env: str
    seed: int
    policies: list[str]


class _RealTime(TypedDict):
    """What `Comparison.real_time` holds."""

    latency: str
    slow_down: float


def _with_training(policy: Any) -> Any:
    """A policy's summary, which older versions wrote with two numbers in place of its `TrainingCost`."""
    if not isinstance(policy, dict) or "training" in policy:
        return policy
    return policy | {"training": {"steps": policy.get("training_steps"), "minutes": policy.get("training_minutes")}}


@dataclass(frozen=True)
class _Summary:
    """`summary.json`, as `EpisodeLog.finish` writes it."""

    comparison: str
    """Digest of the identity in `comparison.json`."""
    env: str
    env_options: dict[str, str]
    seed: int
    interrupted: bool
    resumed: int
    failures: dict[str, str]
    policies: list[Annotated[PolicySummary, BeforeValidator(_with_training)]]
    paired: list[PairedDifference]
    versions: dict[str, str]
    machine: dict[str, Any]
    notes: list[str] = field(default_factory=list)
    baseline: str | None = None
    margin: float = MARGIN
    time_limit: int | None = None
    real_time: _RealTime | None = None
    policy_seed: Annotated[int, Field(ge=0, lt=2**128)] | None = None
    groups: dict[str, list[str]] = field(default_factory=dict)
    disqualified: list[str] = field(default_factory=list)
    runs: list[Run] = field(default_factory=list)


@dataclass(frozen=True)
class Results:
    """A comparison, and each of its episodes."""

    comparison: Comparison
    names: list[str]
    """Names of all compared policies, in order; a group of trainings counts as one."""
    episodes: Mapping[str, EpisodeTable]
    """The episodes that count, by policy; policies without any are left out. Those of a group: of all its trainings."""
    versions: Mapping[str, str]
    machine: Mapping[str, Any]
    runs: list[Run] = field(default_factory=list)
    """Those that played the episodes; none in results of older versions."""


def read_results(folder: Path) -> Results:
    """Read the folder of a finished or interrupted comparison.

    Raises `ResultsError` if a file is missing or damaged.
    """
    own, identity = read_sealed(folder / COMPARISON, _Identity)
    if not (folder / SUMMARY).exists():
        raise ResultsError(
            f"{folder} has no {SUMMARY}: its comparison is unfinished; the same command with --out {folder} resumes it"
        )
    _, summary = read_sealed(folder / SUMMARY, _Summary)
    results = read_episodes(folder, own).sorted(identity.policies)
    counted, _ = counted_results(results)
    members = [member for group in summary.groups.values() for member in group]
    groups_fit = all(summary.groups.values()) and len(set(members) & set(identity.policies)) == len(members)
    trained = by_learner(counted, identity.policies, summary.groups)
    played = set(trained)
    paired = {name for pair in summary.paired for name in (pair.a, pair.b)}
    fits = (
        groups_fit
        and all(map(_is_possible, summary.paired))
        and played == {one.policy for one in summary.policies}
        and paired <= played
    )
    if not fits or summary.comparison != digest(own):
        raise ResultsError(f"{folder / SUMMARY} does not belong to the episodes beside it: run the comparison again")
    comparison = Comparison(
        summary.env,
        summary.seed,
        _options(folder, summary),
        results,
        summary.policies,
        summary.paired,
        summary.failures,
        baseline=summary.baseline,
        margin=summary.margin,
        time_limit=summary.time_limit,
        looks=earlier_looks(summary.runs),
        notes=summary.notes,
        real_time=dict(summary.real_time) if summary.real_time else None,
        groups=summary.groups,
        disqualified=summary.disqualified,
        policy_seed=summary.policy_seed,
        interrupted=summary.interrupted,
        resumed=summary.resumed,
    )
    return Results(
        comparison,
        learners(identity.policies, summary.groups),
        {policy.policy: reduce(EpisodeTable.together, trained[policy.policy].values()) for policy in summary.policies},
        summary.versions,
        summary.machine,
        summary.runs,
    )


def _is_possible(pair: PairedDifference) -> bool:
    counts = (pair.both, pair.only_a, pair.only_b, pair.neither)
    crossed = pair.crossed
    estimates = [crossed.estimate, crossed.narrow, crossed.wide] if crossed else []
    ends = [end for one in estimates if one for end in (one.low, one.high)]
    return pair.episodes > 0 and min(counts) >= 0 and sum(counts) <= pair.episodes and None not in ends


def _options(folder: Path, summary: _Summary) -> dict[str, Any]:
    for name, text in summary.env_options.items():
        if len(text) > LONGEST_OPTION:
            raise ResultsError(
                f"{folder / SUMMARY} cannot be read as results of a comparison: its option {name[:LONGEST_OPTION]} has "
                f"{len(text):,} characters, more than {LONGEST_OPTION:,}"
            )
    return {name: option_value(text) for name, text in summary.env_options.items()}


def read_sealed(path: Path, kind: type[Kind], what: str = "a comparison") -> tuple[dict[str, Any], Kind]:
    """All values of a file that `sealed` made, and those that `kind` has. Raises `ResultsError`, which names `what`."""
    try:
        values = unsealed(bounded_text(path))
        return values, TypeAdapter(kind).validate_python(values)
    except (OSError, ValueError) as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise ResultsError(f"{path} cannot be read as results of {what}: {why}") from error
