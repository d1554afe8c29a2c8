"""Reads a comparison's folder back, without playing anything."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from armctl.core.errors import ResultsError
from armctl.core.files import bounded_text, unsealed
from armctl.core.options import option_value
from armctl.envs import ERROR
from armctl.episodes.store import STORE, Stored, read_store
from armctl.episodes.table import EpisodeTable
from armctl.policies import learners
from armctl.runtime.provenance import Run
from armctl.study.comparison import Comparison
from armctl.study.facts import Facts, judge
from armctl.verdict.scores import by_learner
from armctl.verdict.summary import counted_results

Kind = TypeVar("Kind")
_FACTS = TypeAdapter(Facts)
LONGEST_OPTION = 1_000
"""Characters of an option's text; to read long ones as Python takes much time and memory."""


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
    """Those that played the episodes."""


def read_results(folder: Path) -> Results:
    """Read the folder of a finished or interrupted comparison.

    Raises `ResultsError` if its store is missing or damaged.
    """
    stored, path = read_store(folder), folder / STORE
    if stored.facts is None:
        raise ResultsError(f"{folder} is unfinished: the same command with --out {folder} resumes it")
    try:
        facts = _FACTS.validate_python(stored.facts)
        comparison = _comparison(stored, facts)
        judge(comparison, facts, stored.runs)
    except ValueError as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise ResultsError(f"{path} cannot be read as results of a comparison: {why}") from error
    policies = stored.identity["policies"]
    counted, _ = counted_results(comparison.results)
    trained = by_learner(counted, policies, facts.groups)
    return Results(
        comparison,
        learners(policies, facts.groups),
        {one.policy: reduce(EpisodeTable.together, trained[one.policy].values()) for one in comparison.policies},
        facts.versions,
        facts.machine,
        stored.runs,
    )


def _comparison(stored: Stored, facts: Facts) -> Comparison:
    """The comparison before it is judged. Raises `ValueError` for facts that its episodes cannot have."""
    policies, results = stored.identity["policies"], stored.episodes
    members = [member for group in facts.groups.values() for member in group]
    low, high = facts.return_bounds or (-math.inf, math.inf)
    returns = results.column("total_reward")[results.column("outcome") != ERROR]
    rounding = 1e-9 * max(abs(low), abs(high)) if facts.return_bounds else 0.0
    fits = (
        min(map(len, facts.groups.values()), default=2) > 1
        and len(set(members) & set(policies)) == len(members)
        and set(results.column("policy").tolist()) <= set(facts.policies)
        and low <= high
        and ((returns >= low - rounding) & (returns <= high + rounding)).all()
        and results.column("length").max(initial=0) <= (facts.time_limit or math.inf)
    )
    if not fits:
        raise ValueError("what is known of it does not belong to its episodes: run the comparison again")
    return Comparison(
        stored.identity["env"],
        stored.identity["seed"],
        _options(facts.env_options),
        results.sorted(policies),
        failures=facts.failures,
        baseline=facts.baseline,
        margin=facts.margin,
        real_time=dict(facts.real_time) if facts.real_time else None,
        groups=facts.groups,
        spared={name: one.spared for name, one in facts.policies.items()},
        disqualified=facts.disqualified,
        policy_seed=facts.policy_seed,
        interrupted=facts.interrupted,
        resumed=facts.resumed,
    )


def _options(texts: Mapping[str, str]) -> dict[str, Any]:
    for name, text in texts.items():
        if len(text) > LONGEST_OPTION:
            raise ValueError(
                f"its option {name[:LONGEST_OPTION]} has {len(text):,} characters, more than {LONGEST_OPTION:,}"
            )
    return {name: option_value(text) for name, text in texts.items()}


def read_sealed(path: Path, kind: type[Kind], what: str = "a comparison") -> tuple[dict[str, Any], Kind]:
    """All values of a file that `sealed` made, and those that `kind` has. Raises `ResultsError`, which names `what`."""
    try:
        values = unsealed(bounded_text(path))
        return values, TypeAdapter(kind).validate_python(values)
    except (OSError, ValueError) as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise ResultsError(f"{path} cannot be read as results of {what}: {why}") from error
