"""The result of a study: tasks, and the cells of each."""

import functools
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from armctl.core.arrays import Array
from armctl.core.registration import bare_id
from armctl.episodes.stored import UNDISTURBED
from armctl.stats.across_tasks import League, leagues, rank
from armctl.study.comparison import Comparison
from armctl.study.names import COMPARISON, SUITE, SWEEP, WORST_CASE, cell_name
from armctl.study.suite_headline import suite_headline
from armctl.study.suite_map import lead_table
from armctl.study.suite_tables import rank_table, task_table
from armctl.study.task_results import Sweep
from armctl.study.task_verdict import TaskVerdict, holm_corrected, task_verdict
from armctl.verdict.notebook import Displayed
from armctl.verdict.tables import Document, Remark, Table

if TYPE_CHECKING:
    from armctl.study.plan import Plan


@dataclass(repr=False)
class Study(Displayed):
    """The result of a study. After an interrupt or a failure, it covers the finished episodes."""

    kind: Annotated[str, Field(pattern=f"^({COMPARISON}|{SWEEP}|{SUITE}|{WORST_CASE})$")]
    seed: int
    episodes: int
    """Number of episodes of each policy in each cell, as requested."""
    envs: list[str]
    """All environments that were requested."""
    quick: bool
    tasks: dict[str, Sweep]
    """Results of the tasks, by environment."""
    failures: dict[str, str]
    """Error messages: by environment, or under `results` if results could not be written.

    A task that was played without a damaged agent is in both."""
    interrupted: bool
    misfits: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """Reasons why requested policies did not play, by environment and policy."""
    undisturbed_episodes: int | None = None
    """The number of episodes of undisturbed cells; None: that of others."""

    @classmethod
    def of(cls, plan: "Plan") -> "Study":
        """Return a study without any episode."""
        tasks = {
            task.env: Sweep(
                task.env, plan.seed, task.levels, task.units, task.recorded, {}, {}, False, task.grids, task.axes
            )
            for task in plan.tasks
        }
        requested = plan.kind, plan.seed, plan.episodes, [*plan.envs], plan.quick
        return cls(*requested, tasks, dict(plan.failures), False, plan.misfits, plan.undisturbed_episodes)

    @property
    def cells(self) -> dict[str, Comparison]:
        """All comparisons, by the names of their cells."""
        return {
            cell_name(self.kind, env, setting): comparison
            for env, swept in self.tasks.items()
            for setting, comparison in swept.comparisons.items()
        }

    @property
    def result(self) -> "Comparison | Sweep | Study":
        """Result that was requested: the one comparison, the one task, or the whole study."""
        if self.kind == SUITE:
            return self
        (swept,) = self.tasks.values()
        return swept.comparisons[UNDISTURBED] if self.kind == COMPARISON else swept

    @property
    def stops_early(self) -> bool:
        """True if cells stop when they are decided, and `episodes` is the largest number."""
        return any(swept.any_number for swept in self.tasks.values())

    @property
    def extent(self) -> str:
        """Number of episodes in each setting, in words."""
        limit = "at most " * self.stops_early
        if self.undisturbed_episodes is not None:
            return f"{limit}{self.undisturbed_episodes} episodes undisturbed, {self.episodes} in each disturbed setting"
        return f"{limit}{self.episodes} episode{'s' * (self.episodes != 1)} in each setting"

    @property
    def storage_failures(self) -> dict[str, str]:
        """The failures of what was asked for."""
        return self.result.failures

    @functools.cached_property
    def verdicts(self) -> list[TaskVerdict]:
        """Verdicts on the tasks, after Holm's correction for all. For a finished study: they are computed once."""
        return holm_corrected([task_verdict(sweep) for sweep in self.tasks.values()])

    @functools.cached_property
    def leagues(self) -> list[League]:
        """The ranks of families in the tasks that they share (see `across_tasks.rank` and `leagues`)."""
        ranks_by_family: dict[str, dict[str, Array]] = {}
        for verdict in self.verdicts:
            members: dict[str, list[str]] = {}
            for policy in verdict.policies:
                members.setdefault(policy.family, []).append(policy.policy)
            for name, policies in members.items():
                if len(ranks := rank(verdict.cells, policies)):
                    ranks_by_family.setdefault(name, {})[verdict.task] = ranks
        return leagues(ranks_by_family)

    @property
    def problems(self) -> list[str]:
        """Messages of everything that failed."""
        messages = [f"{bare_id(env)}: {why}" for env, why in self.failures.items()]
        for env, swept in self.tasks.items():
            messages += [f"{bare_id(env)}, {name}: {why}" for name, why in swept.failures.items()]
        return messages

    @property
    def notes(self) -> list[str]:
        """Remarks on policies that did not play."""
        return [
            f"{policy} does not play in {bare_id(env)}: {why}"
            for env, reasons in self.misfits.items()
            for policy, why in reasons.items()
        ]

    def document(self) -> Document:
        """Return the headline, the verdict on each task, a table of the tasks, and the ranks of families."""
        parts: list[Table | Remark] = []
        if self.verdicts:
            parts += [Remark(f"{part}.", "verdict") for part in suite_headline(self.verdicts) if part]
            levels = {env: swept.levels for env, swept in self.tasks.items()}
            parts.append(task_table(self.verdicts, self.extent, self.seed, self.quick))
            parts.append(lead_table(self.verdicts, levels))
            for verdict in self.verdicts:
                parts.append(Remark(f"{verdict.task}: {verdict.verdict}.", "verdict"))
                parts += [Remark(verdict.context)] if verdict.context else []
        parts += [rank_table(league) for league in self.leagues]
        parts += [Remark(note, "note") for note in self.notes]
        parts += [Remark(problem, "problem") for problem in self.problems]
        if self.interrupted:
            parts.append(Remark("Interrupted.", "note"))
        return Document(parts, {"seed": self.seed, "episodes": self.episodes})

    def record(self) -> dict[str, Any]:
        """Return the JSON values that are stored besides the cells."""
        task_fields = "levels", "units", "recorded", "failures", "interrupted"
        tasks = {
            env: {name: getattr(swept, name) for name in task_fields}
            | {name: [asdict(part) for part in getattr(swept, name)] for name in ("grids", "axes")}
            for env, swept in self.tasks.items()
        }
        return {field.name: getattr(self, field.name) for field in fields(self)} | {"tasks": tasks}

    def __repr__(self) -> str:
        return f"<Study of {', '.join(map(bare_id, self.tasks)) or 'no task'}, seed {self.seed}>"
