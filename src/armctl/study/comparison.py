"""The result of a comparison, and its `summary.json`."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import pandas as pd

from armctl.episodes.table import EpisodeTable
from armctl.runtime.provenance import machine, versions
from armctl.stats.paired import MARGIN, PairedDifference
from armctl.verdict.notebook import Displayed
from armctl.verdict.sentences import headline, verdict
from armctl.verdict.summary import PolicySummary
from armctl.verdict.summary_tables import details, paired_table, policy_table
from armctl.verdict.tables import Document, Remark, Table


@dataclass(repr=False)
class Comparison(Displayed):
    """The result of a comparison. After an interrupt or a failure, it covers the finished episodes."""

    env: str
    seed: int
    env_options: Mapping[str, Any]
    results: EpisodeTable
    """Every episode, by policy and episode."""
    policies: list[PolicySummary] = field(default_factory=list)
    paired: list[PairedDifference] = field(default_factory=list)
    failures: dict[str, str] = field(default_factory=dict)
    """Error messages: by policy, under `results` if results could not be written, or under `workers`."""
    tracebacks: dict[str, str] = field(default_factory=dict)
    """Tracebacks of the failures, where there are any."""
    baseline: str | None = None
    """The policy that all others are held against, if one was chosen beforehand."""
    margin: float = MARGIN
    """Difference in success below which policies count as equivalent."""
    time_limit: int | None = None
    """Largest number of control steps of an episode; None if unknown, and in results of older versions."""
    looks: list[int] = field(default_factory=list)
    """The numbers of episodes after which earlier runs told a verdict; its sentence says so."""
    notes: list[str] = field(default_factory=list)
    """Remarks about the environment: what it does not tell, and whether it obeys its seed."""
    real_time: dict[str, Any] | None = None
    """The `latency` (`measured`, or the folder of recorded times) and `slow_down`, if the world did not wait."""
    groups: dict[str, list[str]] = field(default_factory=dict)
    """The trainings that count as one learner: their names in `episodes`, by the group's name."""
    spared: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """The disturbances that do not reach a policy, by its name in `episodes`."""
    disqualified: list[str] = field(default_factory=list)
    """Policies that wrote to the world, so that none of their episodes count."""
    policy_seed: int | None = None
    """Secret from which policies drew their own random numbers; None if it is not known."""
    interrupted: bool = False
    resumed: int = 0
    """Number of episodes that an earlier run had finished."""

    @cached_property
    def episodes(self) -> pd.DataFrame:
        """One row per policy and episode, with the columns of `episodes.csv`. It is made when it is first asked for."""
        return self.results.frame()

    @property
    def verdict(self) -> str:
        """Which policy is better, by how much, at what cost; empty for a single policy."""
        several = len(self.policies) > 1
        return verdict(self.policies, self.paired, self.baseline, self.margin, self.looks) if several else ""

    @property
    def headline(self) -> tuple[str, str]:
        """The verdict in short: who is better by how much, and at what cost; empty for a single policy."""
        several = len(self.policies) > 1
        return headline(self.policies, self.paired, self.baseline, self.margin, self.looks) if several else ("", "")

    def document(self) -> Document:
        """The tables, the verdict, and what else there is to say."""
        parts: list[Table | Remark] = []
        if self.policies:
            parts.append(policy_table(self.env, self.seed, self.policies, self.disqualified))
        parts += [details(policy) for policy in self.policies]
        if self.paired:
            parts.append(paired_table(self.paired, self.baseline))
        if sentence := self.verdict:
            parts.append(Remark(sentence, "verdict"))
        if self.policies and (infeasible := self.policies[0].infeasible):
            what = f"{infeasible} episodes are labelled infeasible"
            parts.append(Remark(f"{what}; they are left out of all figures, whoever wins them."))
        parts += [Remark(note, "note") for note in self.notes]
        parts += [Remark(message, "problem") for message in self.failures.values()]
        if self.resumed:
            parts.append(Remark(f"{self.resumed} episodes were finished by an earlier run."))
        if self.interrupted:
            parts.append(Remark("Interrupted.", "note"))
        for policy in self.policies:
            if policy.episodes < policy.planned - policy.infeasible:
                counts = f"the first {policy.episodes} of {policy.planned} episodes"
                parts.append(Remark(f"{policy.policy} was cut short: its figures are over {counts}.", "note"))
        settings = {name: str(value) for name, value in self.env_options.items()}
        return Document(parts, {"env": self.env, "env_options": settings, "seed": self.seed})

    def __repr__(self) -> str:
        names = ", ".join(policy.policy for policy in self.policies) or "no policy"
        said = f": {sentence}" if (sentence := self.verdict) else ""
        failed = "".join(f"; {failure}" for failure in self.failures.values())
        return f"<Comparison of {names} in {self.env}, seed {self.seed}{said}{failed}>"


def summary(comparison: Comparison) -> dict[str, Any]:
    """The content of `summary.json`: settings, results, versions and machine."""
    return {
        "env": comparison.env,
        "env_options": {name: str(value) for name, value in comparison.env_options.items()},
        "seed": comparison.seed,
        "policy_seed": None if comparison.policy_seed is None else str(comparison.policy_seed),
        "real_time": comparison.real_time,
        "interrupted": comparison.interrupted,
        "resumed": comparison.resumed,
        "failures": comparison.failures,
        "notes": comparison.notes,
        "baseline": comparison.baseline,
        "margin": comparison.margin,
        "time_limit": comparison.time_limit,
        "groups": comparison.groups,
        "disqualified": comparison.disqualified,
        "policies": [dataclasses.asdict(policy) for policy in comparison.policies],
        "paired": [dataclasses.asdict(difference) for difference in comparison.paired],
        "versions": versions(),
        "machine": machine(),
    }
