"""Trials as episodes of armctl's: cells of a task and a condition, pairs or not, and what is known of them."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

from pydantic import Field

from armctl.agents.costs import TrainingCost
from armctl.core.errors import ConfigurationError, unknown_name
from armctl.core.options import Count, Positive, options
from armctl.judging.chosen import left_out_notes, sorted_policies
from armctl.judging.episodes import table_of
from armctl.judging.trials import Trial, Trials
from armctl.stats.difference import MARGIN
from armctl.stats.intervals import Bounds
from armctl.study.comparison import Comparison, concluded
from armctl.verdict.facts import UNDECLARED, Facts, PolicyFacts

RESULTS = "results"
"""Name of the task where none is named."""
ALL = "all"
"""Name of all cells together."""


@options
class Terms:
    """Facts about the results that no file has, and the terms of the verdict."""

    baseline: str | None = None
    margin: Annotated[float, Field(gt=0, lt=1)] = MARGIN
    learned: Sequence[str] = ()
    """Policies that were trained."""
    success_return: float | None = None
    """Return from which on an episode counts as a success, where success is unknown."""
    return_bounds: Bounds | None = None
    time_limit: Positive | None = None
    """s; a failure counts as that long."""
    max_steps: Count | None = None
    any_number: bool = False
    """True if trials are added until the verdict is clear: it then holds at any number of pairs, if rows are only added
    at the end. A log is judged so in any case."""
    unpaired: bool = False
    """True if equal episode numbers do not mean equal episodes."""
    policies_in_columns: bool = False
    """True if each policy has a column of successes in files without a column of success, return or time."""
    task: str = RESULTS


@dataclass
class TrialCell:
    """Trials of one task under one condition, by policy and training."""

    name: str
    task: str = ""
    condition: str = ""
    members: dict[tuple[str, str], list[Trial]] = field(default_factory=dict)
    paired: bool = False
    notes: list[str] = field(default_factory=list)
    """Remarks on its pairs."""
    doubts: list[str] = field(default_factory=list)
    """Reasons to doubt its pairs, which stand beside the verdict."""

    @property
    def episodes(self) -> tuple[tuple[str, str], ...]:
        """Keys of the first policy's episodes, in their order."""
        return tuple(trial.key for trial in next(iter(self.members.values())))


def comparisons_of(all_trials: Trials, terms: Terms) -> list[tuple[TrialCell, Comparison]]:
    """Return each cell with its comparison; the last of several is `ALL` together, if they are balanced.

    Raises `ConfigurationError`.
    """
    order = {source: i for i, source in enumerate(all_trials.sources)}
    first = dict[str, int]()
    for trial in all_trials.trials:
        place = order[trial.source]
        first[trial.policy] = min(place, first.get(trial.policy, place))
    policies = sorted(first, key=lambda policy: (first[policy], natural(policy)))
    for name in (*terms.learned, *([] if terms.baseline is None else [terms.baseline])):
        if name not in policies:
            raise unknown_name("policy in these results", name, policies)
    terms = replace(terms, any_number=terms.any_number or all_trials.any_number)
    all_trials = _with_terms(all_trials, terms)
    cells = [_paired(cell, terms, all_trials.any_number) for cell in _cells(all_trials, policies, terms.task)]
    if len(cells) > 1 and (pooled := _pooled(cells, terms)) is not None:
        cells.append(pooled)
    return [(cell, _concluded(cell, all_trials, policies, terms)) for cell in cells]


def natural(text: str) -> list[tuple[int, int, str]]:
    """Return a key that sorts numbers in texts by their value."""
    parts = re.findall(r"\d+|\D+", text.casefold())
    return [(0, int(part), part) if part.isdecimal() else (1, 0, part) for part in parts]


def _with_terms(all_trials: Trials, terms: Terms) -> Trials:
    """Return the trials with success by return, if that is said, and a time in place of a missing return."""
    trials, notes = all_trials.trials, dict(all_trials.notes)
    is_known = {
        "success": all(trial.success is not None for trial in trials),
        "episode_return": all(trial.episode_return is not None for trial in trials),
        "time": all(trial.time is not None for trial in trials if trial.success is not False),
    }
    if terms.success_return is not None and not is_known["success"]:
        if not is_known["episode_return"]:
            raise ConfigurationError("a success by return needs returns, and there are none")
        limit, is_known["success"] = terms.success_return, True
        trials = [trial._replace(success=trial.episode_return >= limit) for trial in trials]  # type: ignore[operator]
        notes[f"A return from {limit:g} on counts as a success."] = []
    if terms.return_bounds is not None and is_known["episode_return"]:
        low, high = terms.return_bounds
        for trial in trials:
            if not low <= (trial.episode_return or 0.0) <= high:
                raise ConfigurationError(
                    f"{trial.where}: the return {trial.episode_return:g} is outside {low:g} to {high:g}"
                )
    if (
        is_known["time"]
        and not is_known["episode_return"]
        and (terms.time_limit is not None or not is_known["success"])
    ):
        limit = math.inf if terms.time_limit is None else terms.time_limit
        for trial in trials:
            if trial.success is not False and (trial.time or 0.0) > limit:
                raise ConfigurationError(f"{trial.where}: the time {trial.time:g} s is beyond the limit, {limit:g} s")
        lost = f"; a failure counts as the time limit, {limit:g} s" if is_known["success"] else ""
        notes[f"Return: minus the time in s, so that the higher one is faster{lost}."] = []
        trials = [trial._replace(episode_return=-(limit if trial.success is False else trial.time)) for trial in trials]  # type: ignore[operator]
    elif is_known["time"]:
        notes |= {text: [] for text in _mean_times(trials, is_known["success"])}
    return replace(all_trials, trials=trials, notes=notes)


def _mean_times(trials: Sequence[Trial], scored: bool) -> list[str]:
    """Return a remark with the mean time of each policy's successes, which is not tested."""
    times: dict[str, list[float]] = {}
    for trial in trials:
        if trial.success or not scored:
            times.setdefault(trial.policy, []).append(trial.time or 0.0)
    means = ", ".join(f"{name} {math.fsum(values) / len(values):.3g} s" for name, values in sorted(times.items()))
    return [f"Mean time of {'successes' if scored else 'episodes'}: {means}; it is not tested."] if means else []


def _cells(all_trials: Trials, policies: Sequence[str], task: str) -> list[TrialCell]:
    """Return the cells in the natural order of their names, their policies in the given order."""
    cells: dict[tuple[str, str], TrialCell] = {}
    for trial in all_trials.trials:
        name = ", ".join(filter(None, (trial.task, trial.condition))) or task
        cell = cells.setdefault((trial.task, trial.condition), TrialCell(name, trial.task, trial.condition))
        cell.members.setdefault((trial.policy, trial.training_seed), []).append(trial)
    for cell in cells.values():
        order = sorted(cell.members, key=lambda member: (policies.index(member[0]), natural(member[1])))
        cell.members = {member: cell.members[member] for member in order}
    names = [cell.name for cell in cells.values()]
    if len(set(names)) < len(names) or (len(names) > 1 and ALL in names):
        raise ConfigurationError(
            f"tasks and conditions need names that differ, and none is {ALL!r}: {', '.join(names)}"
        )
    return sorted(cells.values(), key=lambda cell: natural(cell.name))


def _paired(cell: TrialCell, terms: Terms, logged: bool) -> TrialCell:
    """Find out whether the policies of a cell played the same episodes, and put these into the same order."""
    keys = {member: _keys(trials) for member, trials in cell.members.items()}
    has_keys = all(all(any(key) for key in places) for places in keys.values())
    fewest = min(keys.values(), key=len)
    cell.paired = has_keys and not terms.unpaired and all(set(fewest) <= set(places) for places in keys.values())
    max_episodes = max(map(len, keys.values()))
    if cell.paired and 2 * len(fewest) < max_episodes:
        cell.paired = False
        cell.doubts.append(
            f"Not compared in pairs: all policies have only {len(fewest)} episodes, and one has {max_episodes}, of "
            "which these may have been chosen by their outcome. All episodes are compared, as separate samples."
        )
    left_out: dict[str, list[Trial]] = {}
    for member, trials in cell.members.items():
        kept = [trial for trial in trials if trial.key in fewest] if cell.paired else trials
        left_out.setdefault(member[0], []).extend(trial for trial in trials if cell.paired and trial.key not in fewest)
        cell.members[member] = sorted(kept, key=lambda trial: (*map(natural, trial.key), _values(trial)))
    if terms.any_number and cell.paired:
        _in_order_of_appearance(cell)
    _add_doubts(cell, left_out, logged)
    counts: dict[str, set[int]] = {}
    for (policy, _), trials in cell.members.items():
        counts.setdefault(policy, set()).add(len(trials))
    for policy, numbers in counts.items():
        if len(numbers) > 1:
            listed = ", ".join(map(str, sorted(numbers)))
            raise ConfigurationError(
                f"{cell.name}: the trainings of {policy} have {listed} episodes: as many are needed of each"
            )
    return cell


def _add_doubts(cell: TrialCell, left_out: Mapping[str, Sequence[Trial]], logged: bool) -> None:
    """Add remarks on the trials that are left out, and doubts about the pairs of a cell."""
    by_policy: dict[str, list[Trial]] = {}
    for (policy, _), trials in cell.members.items():
        by_policy.setdefault(policy, []).extend(trials)
    notes, doubts = left_out_notes(by_policy, left_out)
    cell.notes += notes
    cell.doubts += [] if logged else doubts
    members = {
        f"{policy}[{seed}]" if seed else policy: sorted(trials, key=lambda trial: [*map(natural, trial.key)])
        for (policy, seed), trials in cell.members.items()
    }
    if cell.paired and len(by_policy) > 1 and (in_order := sorted_policies(members)):
        cell.doubts.append(
            f"Sorted by success, in the order of the episodes: {', '.join(in_order)}. If the numbers are those of rows "
            "rather than of initial conditions, these are no pairs: say --unpaired."
        )


def _in_order_of_appearance(cell: TrialCell) -> None:
    """Sort pairs by the trial that completed them: a bet may not depend on what came later, as that on a number may."""
    complete = [max(trial.number for trial in trials) for trials in zip(*cell.members.values(), strict=True)]
    order = sorted(range(len(complete)), key=complete.__getitem__)
    cell.members = {member: [trials[i] for i in order] for member, trials in cell.members.items()}


def _keys(trials: Sequence[Trial]) -> dict[tuple[str, str], str]:
    """Return the places of a policy's episodes by what identifies them. Raise `ConfigurationError` for one twice."""
    places: dict[tuple[str, str], str] = {}
    for trial in trials:
        if any(trial.key) and trial.key in places:
            name = " of ".join(
                f"{kind} {text}" for kind, text in (("episode", trial.episode), ("seed", trial.seed)) if text
            )
            hint = "" if trial.episode else (
                ": if it is the seed of a training, say --training-seed-column; if its trials have numbers, name their "
                "column with --episode-column"
            )  # fmt: skip
            raise ConfigurationError(
                f"{trial.where}: {name} of {trial.policy} is there before, in {places[trial.key]}{hint}"
            )
        places[trial.key] = trial.where
    return places


def _values(trial: Trial) -> tuple[float, ...]:
    scores = (trial.success, trial.episode_return, trial.time, trial.steps, trial.decision_ms)
    return tuple(-math.inf if value is None else float(value) for value in scores)


def _pooled(cells: Sequence[TrialCell], terms: Terms) -> TrialCell | None:
    """Return all cells as one; None unless all have the same policies, and each as many episodes of each."""
    pooled = TrialCell(
        ALL, members={member: [] for member in cells[0].members}, paired=all(cell.paired for cell in cells)
    )
    for cell in cells:
        if list(cell.members) != list(pooled.members) or len({len(trials) for trials in cell.members.values()}) > 1:
            return None
        for member, trials in cell.members.items():
            pooled.members[member] += trials
        pooled.notes += [f"{cell.name}: {note}" for note in cell.notes]
        pooled.doubts += [f"{cell.name}: {doubt}" for doubt in cell.doubts]

    if terms.any_number and pooled.paired:
        _in_order_of_appearance(pooled)
    return pooled


def _concluded(cell: TrialCell, all_trials: Trials, policies: Sequence[str], terms: Terms) -> Comparison:
    """Return the comparison of a cell."""
    trainings = {policy: [seed for name, seed in cell.members if name == policy] for policy in policies}
    names = {
        (policy, seed): f"{policy}[{seed}]" if len(seeds) > 1 else policy
        for policy, seeds in trainings.items()
        for seed in seeds
    }
    groups = {
        f"{policy}[*]": [names[policy, seed] for seed in seeds] for policy, seeds in trainings.items() if len(seeds) > 1
    }
    everything = [trial for trials in cell.members.values() for trial in trials]
    unknown = [
        name for name, is_known in (
            ("return", all(trial.episode_return is not None for trial in everything)),
            ("steps", all(trial.steps is not None for trial in everything)),
            ("decision_ms", all(trial.decision_ms is not None for trial in everything)),
        ) if not is_known
    ]  # fmt: skip
    notes = all_trials.remarks
    if len(trainings) > 1 and not (cell.paired or terms.unpaired or any(any(trial.key) for trial in everything)):
        notes.append("No pairs: nothing says which trials had equal initial conditions, as a column episode would.")
    notes += cell.notes
    baseline = terms.baseline if terms.baseline in trainings else None
    limits = all_trials.time_limits
    limit = terms.max_steps or limits.get(cell.task) or max(limits.values(), default=None)
    longest = max((trial.steps or 0 for trial in everything), default=0)
    if limit is not None and longest > limit:
        raise ConfigurationError(f"an episode has {longest} steps, more than the largest number, {limit}")
    if terms.any_number and not cell.paired:
        raise ConfigurationError(
            f"{cell.name}: a verdict at any number of trials, as a log has, needs pairs, and there are none"
        )
    if terms.any_number and groups:
        raise ConfigurationError(
            f"{cell.name}: a verdict at any number of trials, as a log has, is for one training of each policy, and "
            f"there are several of {' and '.join(policy for policy, seeds in trainings.items() if len(seeds) > 1)}"
        )
    planned = max(map(len, cell.members.values()))
    facts = Facts(
        env_options={}, policy_seed=0, planned=planned,
        policies={names[member]: _policy_facts(member[0], all_trials, terms) for member in cell.members},
        return_bounds=_bounds(terms, all_trials, unknown), time_limit=None if "steps" in unknown else limit,
        control_period=None, versions={}, machine={}, notes=notes, failures={},
        baseline=f"{baseline}[*]" if f"{baseline}[*]" in groups else baseline,
        margin=terms.margin, real_time=None, groups=groups, disqualified=[], interrupted=False, resumed=0,
        paired=cell.paired,
        sources=all_trials.sources, unknown=unknown,
        at_most=planned if terms.any_number else None,
    )  # fmt: skip
    table = table_of(cell.name, {names[member]: trials for member, trials in cell.members.items()}, unknown)
    identity = {"env": cell.name, "seed": 0, "policies": list(names.values())}
    comparison = concluded(identity, {}, facts, table, [])
    comparison.doubts = cell.doubts
    return comparison


def _bounds(terms: Terms, all_trials: Trials, unknown: Sequence[str]) -> Bounds | None:
    if "return" in unknown:
        return None
    if terms.return_bounds is None and terms.time_limit is not None:
        return -terms.time_limit, 0.0
    return terms.return_bounds or all_trials.return_bounds


def _policy_facts(policy: str, all_trials: Trials, terms: Terms) -> PolicyFacts:
    steps = all_trials.training_steps.get(policy, 0)
    learned = steps > 0 or policy in all_trials.learned or policy in terms.learned
    kind = "learned" if learned else "classical" if terms.learned else UNDECLARED
    return PolicyFacts(UNDECLARED, TrainingCost(steps), None, (), kind=kind)
