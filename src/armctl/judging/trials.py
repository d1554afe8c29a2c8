"""Trials: the rows of all files, as one list of episodes with all that the files say of each."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from armctl.core.errors import ConfigurationError
from armctl.judging.columns import SCORES, columns_of, require, used_in_words
from armctl.judging.reshape import one_column_per_policy, with_counts
from armctl.judging.rows import Rows
from armctl.judging.typed import NAMES, typed_columns
from armctl.stats.intervals import Bounds
from armctl.verdict.summary_tables import listed_files

MAX_TRIALS = 5_000_000


class Trial(NamedTuple):
    """One episode of one policy."""

    policy: str
    task: str
    condition: str
    training_seed: str
    seed: str
    episode: str
    success: bool | None
    episode_return: float | None
    time: float | None
    steps: int | None
    decision_ms: float | None
    source: str
    place: str
    """Line of the file, in words."""
    number: int
    """Place in the order of appearance in all files."""

    @property
    def key(self) -> tuple[str, str]:
        """Identity of the episode among those of a policy in a cell."""
        return self.seed, self.episode

    @property
    def where(self) -> str:
        """File and line."""
        return f"{self.source}, {self.place}"


@dataclass
class Trials:
    """All trials, and what holds for all of a policy's."""

    trials: list[Trial] = field(default_factory=list)
    sources: list[str] = field(default_factory=list)
    notes: dict[str, list[str]] = field(default_factory=dict)
    """Assumptions, each with the files that it is about, if it is not about all."""
    training_steps: dict[str, int] = field(default_factory=dict)
    learned: set[str] = field(default_factory=set)
    time_limits: dict[str, int] = field(default_factory=dict)
    """Largest number of steps of an episode by task, if the files say so."""
    setups: dict[tuple[str, str, str], tuple[str, str]] = field(default_factory=dict)
    """Value that has to be equal in a task and condition, by its name, and the first file that has it."""
    return_bounds: Bounds | None = None
    """Possible returns of all tasks together, if the files say so."""
    any_number: bool = False
    """True if a file is a log, whose verdict has to hold at any number of trials."""

    def note(self, text: str, source: str | None = None) -> None:
        """Keep an assumption."""
        self.notes.setdefault(text, []).extend([] if source is None else [source])

    @property
    def remarks(self) -> list[str]:
        """Assumptions, each once."""
        return [
            f"{listed_files(list(dict.fromkeys(sources)))}: {text}" if sources else text
            for text, sources in self.notes.items()
        ]


def trials_of(
    parts: Sequence[Rows],
    chosen: Mapping[str, str],
    default_policies: Mapping[str, str],
    policies_in_columns: bool = False,
) -> Trials:
    """Return the trials of all rows. `default_policies` are names by file, for files that name no policy.

    Raises `ConfigurationError` with file, line and reason for everything that is not clear.
    """
    result = Trials()
    parts = [rows if rows.is_known_format else _laid_out(rows, chosen, policies_in_columns) for rows in parts]
    columns = [columns_of(rows, chosen) for rows in parts]
    for rows, places in zip(parts, columns, strict=True):
        require(rows, places)
        if not rows.values:
            raise ConfigurationError(f"{rows.source} has no episode: nothing follows the names of its columns")
    scores = [name for name in SCORES if all(name in places for places in columns)]
    if not scores:
        scores_by_file = [
            f"{rows.source}: {', '.join(set(SCORES) & set(at))}" for rows, at in zip(parts, columns, strict=True)
        ]
        raise ConfigurationError(f"the files share neither success, nor return, nor time: {'; '.join(scores_by_file)}")
    for rows, places in zip(parts, columns, strict=True):
        left_out = [name for name in SCORES if name in places and name not in scores]
        if left_out:
            result.note(f"{' and '.join(left_out)} not used, as not all files have it.", rows.source)
        kept = {name: place for name, place in places.items() if name not in left_out}
        values, notes = typed_columns(rows, kept, default_policies.get(rows.source, rows.source))
        usage = "" if rows.is_known_format else used_in_words(rows, kept)
        for note in (*rows.notes, *([f"{usage}."] if usage else []), *notes):
            result.note(note, rows.source)
        _add(result, rows, values)
    _merge_spellings(result)
    return result


def _laid_out(rows: Rows, chosen: Mapping[str, str], policies_in_columns: bool) -> Rows:
    """Return rows with columns of policy and success, if they can be told from another layout."""
    columns = columns_of(rows, chosen)
    if set(SCORES).isdisjoint(columns):
        rows = with_counts(rows)
        if policies_in_columns and "policy" not in columns and rows.values:
            return one_column_per_policy(rows, set(columns.values()))
    return rows


def _add(result: Trials, rows: Rows, values: Mapping[str, Sequence[Any]]) -> None:
    """Add the trials of one file."""
    if rows.source not in result.sources:
        result.sources.append(rows.source)
    none = [None] * len(rows.values)
    names = zip(*(values.get(name, [""] * len(none)) for name in NAMES), strict=True)
    measures = zip(*(values.get(name, none) for name in ("return", "time", "steps", "decision_ms")), strict=True)
    successes = values.get("success", [(None,)] * len(none))
    feasible = values.get("feasible", [True] * len(none))
    if infeasible := feasible.count(False):
        result.note(f"{infeasible} episodes that are labelled infeasible are left out.", rows.source)
    for name, success, measured, place, counts in zip(names, successes, measures, rows.places, feasible, strict=True):
        for won in success if counts else ():
            where = rows.source, f"{rows.unit} {place}", len(result.trials)
            result.trials.append(Trial._make((*name, won, *measured, *where)))
    for policy, steps in zip(values["policy"], values.get("training_steps", none), strict=True):
        if steps:
            result.training_steps[policy] = steps
    if rows.constants.get("kind") == "learned":
        result.learned |= set(values["policy"])
    if len(result.trials) > MAX_TRIALS:
        raise ConfigurationError(f"{rows.source}: there are more than {MAX_TRIALS:,} episodes")
    result.any_number |= rows.any_number
    if rows.return_bounds is not None:
        low, high = zip(rows.return_bounds, result.return_bounds or rows.return_bounds, strict=True)
        result.return_bounds = min(low), max(high)
    _check_setup(result, rows)


def _check_setup(result: Trials, rows: Rows) -> None:
    """Raise `ConfigurationError` if episodes of one task and condition were played under others' terms."""
    task, condition = (str(rows.constants.get(name, "")) for name in ("task", "condition"))
    setup = dict(rows.setup)
    if rows.time_limit is not None:
        setup["time limit"] = f"{rows.time_limit} steps"
        result.time_limits[task] = rows.time_limit
    if rows.return_bounds is not None:
        setup["possible returns"] = "{:g} to {:g}".format(*rows.return_bounds)
    for name, value in setup.items():
        present, source = result.setups.setdefault((task, condition, name), (value, rows.source))
        if value != present:
            where = " of " * bool(task) + ", ".join(filter(None, (task, condition)))
            raise ConfigurationError(
                f"{rows.source} and {source} differ in the {name}{where}: {value} and {present}; their episodes are no "
                "episodes of one task"
            )


def _merge_spellings(result: Trials) -> None:
    """Take names that differ in capitals only for one, and say so."""
    for name in ("policy", "task", "condition"):
        spellings: dict[str, Counter[str]] = {}
        for text, count in Counter(getattr(trial, name) for trial in result.trials).items():
            spellings.setdefault(text.casefold(), Counter())[text] = count
        merged: dict[str, str] = {}
        for variants in spellings.values():
            if len(variants) > 1:
                best = min(variants, key=lambda text: (-variants[text], text))
                merged |= dict.fromkeys(variants, best)
                listed = " and ".join(map(repr, sorted(variants)))
                result.note(f"{listed} count as one {name}, {best!r}.")
        if merged:
            result.trials = [
                trial._replace(**{name: merged.get(getattr(trial, name), getattr(trial, name))})
                for trial in result.trials
            ]
            if name == "policy":
                result.learned = {merged.get(policy, policy) for policy in result.learned}
                result.training_steps = {merged.get(p, p): steps for p, steps in result.training_steps.items()}
