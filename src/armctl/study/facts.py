"""What is known of a comparison besides its episodes and runs, and all that follows from these."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from typing_extensions import TypedDict

from armctl.agents.costs import TrainingCost
from armctl.core.errors import ResultsError
from armctl.core.files import write_atomically
from armctl.core.registration import bare_id
from armctl.episodes.output import DECISIONS, EPISODES, write_csv
from armctl.episodes.table import EpisodeTable
from armctl.rollout.decision_times import Machines, load_notes, timing_notes, unjudged
from armctl.rollout.real_time import MEASURED
from armctl.runtime.provenance import Run, argument_notes, earlier_looks
from armctl.study.comparison import Comparison, summary
from armctl.verdict.summary import PolicySummary, certificate_notes, counted_results, motion_notes, summarise

SUMMARY = "summary.json"
UNSCORED = "{env} does not say what a success is: the verdict goes by return. --success-return says which is one."
UNBOUNDED = (
    "The possible returns are unknown, so that their means and worst tenths have neither intervals nor tests: a "
    "disaster that none of these episodes had may cost anything. --return-bounds LOW HIGH states the bounds."
)
Finite = Annotated[float, Field(allow_inf_nan=False)]


class RealTimeFacts(TypedDict):
    """What `Comparison.real_time` holds."""

    latency: str
    slow_down: Finite


@dataclass(frozen=True)
class PolicyFacts:
    """What is known of a policy besides its episodes."""

    sees: str
    training_cost: TrainingCost
    construction_ms: Finite
    spared: tuple[str, ...]
    """The disturbances that do not reach it."""

    @property
    def training_steps(self) -> int:
        """As `Policy.training_steps`."""
        return self.training_cost.steps


@dataclass(frozen=True)
class Facts:
    """What the summaries and notes of a comparison follow from, together with its episodes and runs."""

    env_options: dict[str, str]
    policy_seed: Annotated[int, Field(ge=0, lt=2**128)]
    planned: Annotated[int, Field(ge=1, le=2**62)]
    """Number of episodes that were asked for."""
    policies: dict[str, PolicyFacts]
    return_bounds: tuple[Finite, Finite] | None
    time_limit: Annotated[int, Field(ge=1, le=2**31)] | None
    control_period: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None
    versions: dict[str, str]
    machine: dict[str, Any]
    notes: list[str]
    """Remarks that do not follow from the episodes."""
    failures: dict[str, str]
    baseline: str | None
    margin: Annotated[float, Field(gt=0, lt=1)]
    real_time: RealTimeFacts | None
    groups: dict[str, list[str]]
    disqualified: list[str]
    interrupted: bool
    resumed: int


def judge(comparison: Comparison, facts: Facts, runs: Sequence[Run]) -> None:
    """Summarise a comparison's results, and note what is to be known of them."""
    results = comparison.results
    if not len(results):
        return
    latencies = facts.real_time is None or facts.real_time["latency"] == MEASURED
    comparison.results = results = unjudged(results, runs) if latencies else results
    comparison.time_limit = facts.time_limit
    notes = [] if facts.return_bounds else [UNBOUNDED]
    policies: Any = facts.policies
    spared = {name: one.spared for name, one in facts.policies.items()}
    summaries, comparison.paired = summarise(
        results, policies, facts.planned, facts.return_bounds, facts.time_limit, facts.groups, spared, runs
    )
    comparison.policies = [_with_construction(one, facts.policies) for one in summaries]
    notes += certificate_notes(results) + motion_notes(results, facts.control_period)
    counted, _ = counted_results(results)
    notes += timing_notes(((name, played) for name, played in counted.items() if played), Machines.of(runs, results))
    if summaries and summaries[0].success is None:
        notes.append(UNSCORED.format(env=bare_id(comparison.env)))
    notes += load_notes(results, runs) if latencies else []
    notes += argument_notes(runs, facts.baseline, facts.margin) if comparison.paired else []
    comparison.notes = facts.notes + notes
    comparison.looks = earlier_looks(runs)


def _with_construction(one: PolicySummary, policies: Mapping[str, PolicyFacts]) -> PolicySummary:
    """The summary with the time that it took to make the policy; of a group's trainings, the longest."""
    return replace(one, construction_ms=max(policies[name].construction_ms for name in one.trainings or [one.policy]))


def write_output(
    folder: Path, comparison: Comparison, results: EpisodeTable, identity: Mapping[str, Any], runs: Sequence[Run]
) -> None:
    """Write a comparison's CSV tables, and its summary, runs and identity as JSON. Raises `ResultsError`."""
    about = {**summary(comparison), "runs": [asdict(one) for one in runs], "comparison": identity}
    try:
        write_csv(folder, results)
        write_atomically(folder / SUMMARY, json.dumps(about, indent=2) + "\n")
    except OSError as error:
        raise ResultsError(f"tables could not be written to {folder}: {error.strerror}") from error


def remove_output(folder: Path) -> None:
    """Remove what `write_output` has written, while more is played. Raises `ResultsError`."""
    try:
        for name in (SUMMARY, EPISODES, DECISIONS):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise ResultsError(f"results cannot be written to {folder}: {error.strerror}") from error
