"""A trial of a tuning: values are proposed here, and measured by a worker, wherever that is."""

import statistics
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.pruners import MedianPruner
from optuna.trial import FrozenTrial

from armctl.core.errors import FAILURES, described
from armctl.core.search_space import Range, SearchSpace
from armctl.runtime.workers import check_same_identity
from armctl.training.run import processor_seconds
from armctl.tuning.candidates import Candidate, Pruned

STARTUP_TRIALS = 5
"""No trial is pruned before so many have finished, nor by its first report."""

Value = bool | int | float | str


@dataclass(frozen=True)
class TrialOutcome:
    """Result of a trial."""

    number: int
    scores: tuple[float, ...] = ()
    """Score of each training seed; one for an expert."""
    reports: Mapping[int, float] = field(default_factory=dict)
    pruned: bool = False
    failure: str | None = None
    processor_seconds: float = 0.0

    @property
    def value(self) -> float:
        """Median score, by which the trial is judged."""
        return statistics.median(self.scores)


def pruner() -> MedianPruner:
    """Ends a trial whose best report is worse than the median of the others' at the same point."""
    return MedianPruner(n_startup_trials=STARTUP_TRIALS, n_warmup_steps=1)


def distributions(space: SearchSpace) -> dict[str, BaseDistribution]:
    """Optuna's own description of a search space."""
    return {path: _distribution(value_range) for path, value_range in space.items()}


def measure(
    candidate: Candidate, number: int, values: Mapping[str, Value], folder: Path, others: Sequence[FrozenTrial]
) -> TrialOutcome:
    """Measure a trial in a worker; what else was tried before it was begun decides whether it is pruned."""
    reports: dict[int, float] = {}
    with warnings.catch_warnings(action="ignore", category=optuna.exceptions.ExperimentalWarning):
        study = optuna.create_study(direction="maximize", pruner=pruner())
        study.add_trials(others)
        judged = study.ask(distributions(candidate.space))

    def report(step: int, score: float) -> None:
        reports[step] = score
        judged.report(score, step)
        if judged.should_prune():
            raise Pruned

    start = processor_seconds()
    scores: list[float] = []
    pruned, failure = False, None
    try:
        scores = candidate.measure(values, folder, report)
    except Pruned:
        pruned = True
    except FAILURES as error:
        failure = described(error)
    return TrialOutcome(number, tuple(scores), reports, pruned, failure, processor_seconds() - start)


def measure_away(sent: tuple[Candidate, Mapping[str, str]], *trial: Any) -> TrialOutcome:
    """Measure a trial in a cluster's worker, with the same code as where it was proposed. Raises `WorkersFailed`."""
    candidate, code = sent
    check_same_identity(code, candidate.code)
    return measure(candidate, *trial)


def _distribution(value_range: Range) -> BaseDistribution:
    if value_range.choices:
        return CategoricalDistribution(value_range.choices)
    assert value_range.low is not None
    assert value_range.high is not None
    if value_range.is_whole:
        return IntDistribution(int(value_range.low), int(value_range.high), log=value_range.log)
    return FloatDistribution(value_range.low, value_range.high, log=value_range.log)
