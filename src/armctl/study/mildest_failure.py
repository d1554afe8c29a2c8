"""The mildest disturbance with which a policy fails half of the time: searched on some episodes, judged on others."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from armctl import DEFAULT_ENV
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError, ResultsError, os_errors_as
from armctl.core.files import write_atomically
from armctl.core.seeds import TEST_SEED, Seed, evaluation_seed
from armctl.episodes.record import EpisodeResult
from armctl.stats.failure_line import line_through
from armctl.stats.failure_surface import ROUND_WIDTHS, FailureSurface, fitted_surface, round_box, round_sizes
from armctl.study.axis import Axis
from armctl.study.comparison import Comparison
from armctl.study.contenders import success_table
from armctl.study.levels import Disturbances, disturbance_specs
from armctl.study.names import WORST_CASE
from armctl.study.options import TaskOptions, WorstCaseOptions, checked_options
from armctl.study.output import WORST_CASES, csv_of
from armctl.study.plan import Cell, Plan, TaskPlan, extent, undisturbed_cell
from armctl.study.results import read_study
from armctl.study.run import play
from armctl.study.search_box import levels_at, levels_between, point_at, points_of, search_axes
from armctl.study.study import Study
from armctl.study.worst_case_results import Case, JudgedPoint, WorstCases

MIN_BUDGET = 50
"""Least number of episodes of a search: ten in each round."""
SEARCH = "search-{}"
"""Folder of a round's results."""
NO_SUCCESS_SIGNAL = (
    "{env} does not say what a success is, so that no failure can be searched: use --success-key or --success-return"
)


@dataclass
class Search:
    """The search of one policy's mildest failure."""

    axes: Sequence[Axis]
    points: Array
    """(n, d) points of the episodes so far."""
    success: NDArray[np.bool_]
    spared: tuple[str, ...] = ()
    """Disturbances that do not reach the policy."""

    @classmethod
    def over(cls, axes: Sequence[Axis]) -> "Search":
        """Return a search without any episode."""
        return cls(axes, np.empty((0, len(axes))), np.empty(0, dtype=bool))

    @property
    def reached(self) -> list[int]:
        """Indices of the axes whose disturbances reach the policy."""
        return [i for i, axis in enumerate(self.axes) if axis.name not in self.spared]

    def add(self, comparison: Comparison) -> None:
        """Add the episodes of a round. Raise `ConfigurationError` if success is unknown."""
        table = success_table(comparison, with_spared=True)
        if table is None:
            raise ConfigurationError(NO_SUCCESS_SIGNAL.format(env=comparison.env))
        (summary,) = comparison.policies
        success = table[summary.policy].dropna()
        disturbances = comparison.env_options.get("disturbances", {})
        points = points_of(self.axes, disturbances, comparison.seed, [int(k) for k in success.index])
        self.points = np.vstack([self.points, points])
        self.success = np.concatenate([self.success, success.to_numpy() == 1])
        self.spared = tuple(dict.fromkeys((*self.spared, *summary.spared)))

    def mildest(self) -> Array | None:
        """Return the mildest point of failure; None if none is in the box."""
        if not self.reached:
            return None
        whole = {i: self.axes[k].whole_shares for i, k in enumerate(self.reached) if self.axes[k].whole}
        surface = self.surface()
        point = surface.mildest(whole)
        return None if point is None else self._whole(point)

    def surface(self) -> FailureSurface:
        """Return the response surface over the axes that reach the policy."""
        return fitted_surface(self.points[:, self.reached], self.success)

    def _whole(self, point: Array) -> Array:
        """Return a point of all axes from one of those that reach the policy."""
        whole = np.zeros(len(self.axes))
        whole[self.reached] = point
        return whole

    @property
    def corner(self) -> Array:
        """The ends of all ranges that reach the policy."""
        return self._whole(np.ones(len(self.reached)))

    def next_levels(self, number: int) -> dict[str, tuple[float, float]]:
        """Return the levels of the disturbances in a round."""
        if number == 0:
            return levels_between(self.axes, np.zeros(len(self.axes)), np.ones(len(self.axes)))
        mildest = self.mildest()
        low, high = round_box(self.corner if mildest is None else mildest, number)
        chosen = [self.axes[i] for i in self.reached]
        return levels_between(chosen, low[self.reached], high[self.reached])


def worst_case(
    policies: Any = None,
    env: str = DEFAULT_ENV,
    *,
    disturbances: Disturbances = None,
    seed: Seed = 0,
    out: str | Path | None = None,
    progress: Callable[[str, EpisodeResult], None] | None = None,
    **options: Unpack[WorstCaseOptions],
) -> WorstCases:
    """Search the mildest disturbance with which each policy fails half of the time.

    `disturbances` are names, or by name the end of each range, by default the strongest of a sweep's levels. The
    distance of a disturbance is the Euclidean norm of its levels, in units of their ranges. All policies have the same
    `budget` of episodes, in rounds; round k (from 0 on) plays seed `seed` + k, in which each episode has levels of its
    own. Then `episodes` of another seed, `judge_seed`, at each of up to seven points judge the line through the
    result: the search fits its own episodes too well.

    With `out`, the results of the rounds are in `out/search-1` and so on, those of the judgement in `out`, and a row
    for each policy in `out/worst_case.csv`. After an interrupt, the same call resumes. `progress` is called with the
    name of the part, such as `search 2/5`, and every finished episode.

    Raises `ConfigurationError`, `AgentFileError`, and `ResultsError` as `compare` does.
    """
    checked_options(options, WorstCaseOptions)
    search_seed = evaluation_seed(seed)
    study_options: TaskOptions = {name: value for name, value in options.items() if name not in SEARCH_OPTIONS}  # type: ignore[assignment]
    cell = undisturbed_cell(policies, env, study_options)
    if cell.groups:
        raise ConfigurationError(f"{', '.join(cell.groups)}: a worst case is one of a single training")
    budget, episodes = options.get("budget", 300), options.get("episodes", 100)
    judge_seed = evaluation_seed(options.get("judge_seed", search_seed + len(ROUND_WIDTHS)))
    _check(budget, search_seed, judge_seed)
    axes = search_axes(disturbance_specs(cell.env, cell.env_options), disturbances)
    folder = None if out is None else Path(out)
    parts = [(SEARCH.format(number + 1), size, search_seed + number) for number, size in enumerate(round_sizes(budget))]
    searches, studies = {name: Search.over(axes) for name in cell.players}, list[Study]()
    for number, (name, size, seed_of_round) in enumerate(parts):
        boxes = {policy: [search.next_levels(number)] for policy, search in searches.items()}
        plan = _plan(cell, axes, boxes, extent(size, seed_of_round, study_options))
        label = f"search {number + 1}/{len(parts)}"
        studies.append(_play(plan, folder and folder / name, study_options, label, progress))
        if studies[-1].interrupted:
            return _concluded(axes, studies, None)
        _add(searches, studies[-1])
    lines = {name: _line(axes, search) for name, search in searches.items()}
    plan = _plan(cell, axes, lines, extent(episodes, judge_seed, study_options))
    judged = _play(plan, folder, study_options, "judging", progress)
    result = _concluded(axes, studies, judged)
    if folder is not None and result.cases and not judged.storage_failures.get("results"):
        with os_errors_as(f"tables could not be written to {folder}"):
            write_atomically(folder / WORST_CASES, csv_of(result.records))
    return result


SEARCH_OPTIONS = ("budget", "episodes", "judge_seed")
"""Options of a search that no other study has."""


def read_worst_cases(folder: Path) -> WorstCases:
    """Read the folder of a finished search. Raise `ResultsError` if it is unfinished, or anything in it is damaged."""
    judged = read_study(folder)
    rounds = [read_study(folder / SEARCH.format(number + 1)) for number in range(len(ROUND_WIDTHS))]
    axes = [swept.axes for study in (judged, *rounds) for swept in study.tasks.values()]
    if judged.kind != WORST_CASE or any(other != axes[0] or not other for other in axes):
        raise ResultsError(f"{folder} holds no search for worst cases, or rounds of another one")
    try:
        return _concluded(axes[0], rounds, judged)
    except (ValueError, TypeError, LookupError, ConfigurationError) as error:
        raise ResultsError(f"{folder} cannot be read as results of a search for worst cases: {error}") from error


def _check(budget: int, search_seed: int, judge_seed: int) -> None:
    if budget < MIN_BUDGET:
        raise ConfigurationError(f"the budget of a search is at least {MIN_BUDGET} episodes, not {budget}")
    seeds = range(search_seed, search_seed + len(ROUND_WIDTHS))
    if TEST_SEED in seeds:
        raise ConfigurationError("the sealed test is not for a search: --seed is one of development, --judge-seed test")
    if judge_seed in seeds:
        raise ConfigurationError(
            f"seeds {seeds[0]} to {seeds[-1]} are for the search, which fits their episodes too well: judge by another"
        )


def _plan(
    cell: Cell, axes: Sequence[Axis], levels: Mapping[str, Sequence[Mapping[str, Any]]], shared: dict[str, Any]
) -> Plan:
    """Return the plan of a cell for each policy and each of its levels of disturbances."""
    options = dict(cell.env_options)
    constant = dict(options.pop("disturbances", {}))
    cells = [
        replace(
            cell,
            name=_cell_name(i, name) + (f"-{k + 1}" if k else ""),
            policies={name: cell.policies[name]},
            env_options=options | ({"disturbances": constant | dict(at)} if constant or at else {}),
        )
        for i, name in enumerate(cell.policies)
        for k, at in enumerate(levels.get(name, ()))
    ]
    return Plan(WORST_CASE, [TaskPlan(cell.env, cells, axes=axes)], **shared, envs=[cell.env])


def _cell_name(number: int, policy: str) -> str:
    """Return the name of a policy's cell, from which its place in the line-up is read too: files have any name."""
    return f"{number + 1}-{re.sub(r'[^A-Za-z0-9_.()-]+', '_', policy)[-60:]}"


def _play(
    plan: Plan,
    folder: Path | None,
    options: TaskOptions,
    label: str,
    progress: Callable[[str, EpisodeResult], None] | None,
) -> Study:
    return play(plan, folder, options, lambda cell, result: progress(label, result) if progress else None)


def _add(searches: dict[str, Search], study: Study) -> None:
    """Add a round to the searches; those of policies that have played no episode of it end."""
    by_policy = _by_policy(study)
    for name in [*searches]:
        if name in by_policy:
            searches[name].add(by_policy[name][0])
        else:
            del searches[name]


def _by_policy(study: Study) -> dict[str, list[Comparison]]:
    by_policy: dict[str, list[Comparison]] = {}
    for swept in study.tasks.values():
        for comparison in swept.comparisons.values():
            if comparison.policies:
                by_policy.setdefault(comparison.names[0], []).append(comparison)
    return by_policy


def _judged_point(search: Search) -> Array:
    mildest = search.mildest()
    return search.corner if mildest is None else mildest


def _line(axes: Sequence[Axis], search: Search) -> list[dict[str, float]]:
    """Return the levels of the points that judge a search, each once."""
    levels = [levels_at(axes, point) for point in line_through(_judged_point(search))]
    return [at for i, at in enumerate(levels) if at not in levels[:i]]


def _concluded(axes: Sequence[Axis], rounds: Sequence[Study], judged: Study | None) -> WorstCases:
    """Return the result of a search from all of its studies."""
    searches = {name: Search.over(axes) for name in _by_policy(rounds[0])}
    for study in rounds if judged else ():
        _add(searches, study)
    comparisons = {} if judged is None else _by_policy(judged)
    cases = []
    for name, search in searches.items():
        levels, judgements = _line(axes, search), comparisons.get(name, [])
        if len(judgements) < len(levels):
            continue
        line = [
            JudgedPoint(at, float(np.linalg.norm(point_at(axes, at))), comparison)
            for at, comparison in zip(levels, judgements, strict=True)
        ]
        cases.append(Case(name, levels_at(axes, _judged_point(search)), len(search.success), search.spared, line))
    problems = [problem for study in (*rounds, *([judged] if judged else [])) for problem in study.problems]
    first, last = rounds[0], judged or rounds[-1]
    return WorstCases(
        env=next(iter(first.tasks)),
        axes=axes,
        budget=sum(study.episodes for study in rounds),
        seeds=(first.seed, first.seed + len(ROUND_WIDTHS) - 1),
        judge_seed=judged.seed if judged else None,
        cases=sorted(cases, key=lambda case: (-case.distance.value, -case.line[-1].distance)),
        problems=problems,
        interrupted=last.interrupted,
    )
