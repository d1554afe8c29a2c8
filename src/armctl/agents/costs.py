"""Costs of trainings, with those of an agent's teachers, and of the search for recipes and options."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, ClassVar

from pydantic import ConfigDict, Field

Count = Annotated[int, Field(ge=0, le=10**15)]
Seconds = Annotated[float, Field(ge=0, le=1e12)]


@dataclass(frozen=True)
class TuningCost:
    """Trials made to find a recipe, or an expert's options, besides the trainings that are shown. None: unknown."""

    trials: Count | None = None
    """Trials of a search, and trainings that failed, were stopped or replaced, as far as they were recorded."""
    minutes: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Minutes of those with a recorded time: of a processor in a search, wall time on one core in other trainings."""

    __pydantic_config__: ClassVar = ConfigDict(strict=False, extra="forbid")
    """Files have it as a table, in models that are strict otherwise."""

    def __str__(self) -> str:
        if self.trials is None:
            return "an unknown number of trials"
        text = f"{self.trials:,} recorded trial{'' if self.trials == 1 else 's'}"
        return f"{text} ({self.minutes:,.0f} minutes)" if self.minutes else text


@dataclass(frozen=True)
class TrainingCost:
    """Cost of a training; of its evaluations on held-out episodes only the time counts. None: unknown."""

    steps: Count = 0
    """Steps as the learner counts them: decisions, or gradient steps of a clone. 0 for an untrained policy."""
    minutes: Annotated[float, Field(ge=0)] | None = None
    """Wall time, of a machine that may have been busy."""
    decisions: Count | None = None
    """Control steps decided in simulation for it: by the agent, by a teacher, or in demonstrations."""
    teacher_queries: Count | None = None
    """Number of actions that a teacher was asked for, or that demonstrations show."""
    gradient_steps: Count | None = None
    """Updates of the network, each on a batch."""
    processor_seconds: Seconds | None = None
    """Seconds of all cores and processes."""
    teachers: "TrainingCost | None" = None
    """Cost of all networks that it learned from, directly or through its teachers, each once; None: there are none.
    All other fields are the training's own."""
    tuning: TuningCost | None = None
    """Trials made to find its recipe and those of its teachers; None: nothing is recorded."""

    @property
    def total(self) -> "TrainingCost":
        """Cost of the training and those of its teachers together; what is unknown of one is unknown."""
        return self if self.teachers is None else replace(total_cost([self, self.teachers]), tuning=self.tuning)

    @property
    def is_untrained(self) -> bool:
        """True if it is known that there was no training."""
        return replace(self, tuning=None) == UNTRAINED

    @property
    def brief(self) -> str:
        """Largest cost of the training, to go behind something else; empty for a policy that was not trained."""
        total = self.total
        counts = {"decisions": total.decisions, "gradient steps": total.gradient_steps, "steps": total.steps}
        return next((f" after {rounded(count)} {unit} of training" for unit, count in counts.items() if count), "")

    def __str__(self) -> str:
        total = self.total
        if self.teachers is not None and total.decisions is None is not self.decisions:
            return f"{replace(self, teachers=None)} of its own, and an unknown number of its teachers'"
        counts = {"decisions": total.decisions, "gradient steps": total.gradient_steps}
        if total.decisions is None and total.gradient_steps is None:
            counts["steps"] = self.steps
        if self.teacher_queries and self.teacher_queries != self.decisions:
            counts["teacher queries"] = self.teacher_queries
        words = {unit: f"{rounded(count)} {unit}" for unit, count in counts.items() if count is not None}
        if self.teachers is not None and self.decisions is not None and self.teachers.decisions is not None:
            decisions, theirs = rounded(self.decisions), rounded(self.teachers.decisions)
            words["decisions"] += f" ({decisions} its own, {theirs} its teachers')"
        text = " and ".join(words.values())
        if total.processor_seconds is not None:
            return f"{text} ({total.processor_seconds / 60:.1f} minutes of processor)"
        return f"{text} ({total.minutes:.1f} minutes)" if total.minutes else text


UNTRAINED = TrainingCost(0, 0.0, 0, 0, 0, 0.0)
"""Cost of a policy that was not trained."""
COUNTED = tuple(field.name for field in fields(TrainingCost) if field.name not in ("teachers", "tuning"))
"""The fields of a `TrainingCost` that are numbers."""


def total_cost(costs: Sequence[TrainingCost]) -> TrainingCost:
    """Add up the own costs of several trainings; unknown is what is unknown of any."""
    sums: dict[str, Any] = {}
    for name in COUNTED:
        values = [getattr(cost, name) for cost in costs]
        sums[name] = None if None in values else sum(values)
    return TrainingCost(**sums)


def mean_cost(costs: Sequence[TrainingCost]) -> TrainingCost:
    """Return the mean cost of several trainings; unknown is what is unknown of any.

    A teacher that they share counts once in the mean, as it does in each of them. Their recipe was tuned once.
    """
    total = total_cost(costs)
    means: dict[str, Any] = {}
    for name in COUNTED:
        value = getattr(total, name)
        mean = None if value is None else value / len(costs)
        means[name] = round(mean) if isinstance(value, int) and mean is not None else mean
    teachers = [cost.teachers or UNTRAINED for cost in costs]
    tunings = [cost.tuning for cost in costs if cost.tuning is not None]
    return TrainingCost(
        **means,
        teachers=mean_cost(teachers) if any(cost.teachers for cost in costs) else None,
        tuning=max(tunings, key=lambda tuning: tuning.trials or 0, default=None),
    )


def total_tuning(tunings: Sequence[TuningCost | None]) -> TuningCost | None:
    """Add up what is recorded of several tunings; None: nothing is."""
    trials = [tuning.trials for tuning in tunings if tuning is not None and tuning.trials is not None]
    minutes = [tuning.minutes for tuning in tunings if tuning is not None and tuning.minutes is not None]
    return TuningCost(sum(trials), round(sum(minutes), 1) if minutes else None) if trials else None


def rounded(count: int) -> str:
    """Return a count in words, to three digits."""
    if count >= 999_500:
        return f"{count / 1e6:.3g} million" if count < 999_500_000 else f"{count / 1e6:,.0f} million"
    return f"{float(f'{count:.3g}'):,.0f}"
