"""The result of a study: tasks, and the cells of each."""

import functools
from dataclasses import dataclass, field
from typing import Any

from armctl.core.arrays import Array
from armctl.core.registration import bare_id
from armctl.episodes.stored import UNDISTURBED
from armctl.stats.across_tasks import League, leagues, rank
from armctl.study.answers import Answer, answer, corrected
from armctl.study.comparison import Comparison
from armctl.study.plan import SUITE, SWEEP, Plan, task_name
from armctl.study.suite_tables import rank_table, task_table
from armctl.study.task_results import Sweep
from armctl.verdict.notebook import Displayed
from armctl.verdict.tables import Document, Remark, Table


@dataclass(repr=False)
class Study(Displayed):
    """The result of a study. After an interrupt or a failure, it covers the finished episodes."""

    kind: str
    """`comparison`, `sweep` or `suite`."""
    seed: int
    episodes: int
    """Of each policy in each cell, as asked for."""
    envs: list[str] = field(default_factory=list)
    """All environments that were asked for."""
    quick: bool = False
    tasks: dict[str, Sweep] = field(default_factory=dict)
    """By environment."""
    failures: dict[str, str] = field(default_factory=dict)
    """Error messages: by environment, or under `results` if results could not be written.

    A task that was played without a damaged agent is in both."""
    interrupted: bool = False

    @classmethod
    def of(cls, plan: Plan) -> "Study":
        """A study of which nothing has been played."""
        tasks = {one.env: Sweep(one.env, plan.seed, one.levels, one.units, one.recorded) for one in plan.tasks}
        return cls(plan.kind, plan.seed, plan.episodes, [*plan.envs], plan.quick, tasks, dict(plan.failures))

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
        """What was asked for: the one comparison, the one task, or the whole."""
        if self.kind == SUITE:
            return self
        (swept,) = self.tasks.values()
        return swept if self.kind == SWEEP else swept.comparisons[UNDISTURBED]

    @property
    def storage_failures(self) -> dict[str, str]:
        """The failures of what was asked for."""
        return self.result.failures

    @functools.cached_property
    def answers(self) -> list[Answer]:
        """The answer for each task, after Holm's correction for all. For a finished study: it is worked out once."""
        return corrected([answer(swept) for swept in self.tasks.values()])

    @functools.cached_property
    def leagues(self) -> list[League]:
        """The ranks of families in the tasks that they share (see `across_tasks.rank` and `leagues`)."""
        found: dict[str, dict[str, Array]] = {}
        for one in self.answers:
            members: dict[str, list[str]] = {}
            for policy in one.policies:
                members.setdefault(policy.family, []).append(policy.policy)
            for name, policies in members.items():
                if len(its := rank(one.cells, policies)):
                    found.setdefault(name, {})[one.task] = its
        return leagues(found)

    @property
    def problems(self) -> list[str]:
        """All that failed, in words."""
        said = [f"{bare_id(env)}: {why}" for env, why in self.failures.items()]
        for env, swept in self.tasks.items():
            said += [f"{bare_id(env)}, {what}: {why}" for what, why in swept.failures.items()]
        return said

    def document(self) -> Document:
        """A table of the tasks, the answer for each, and the ranks of families."""
        parts: list[Table | Remark] = []
        if self.answers:
            parts.append(task_table(self.answers, self.episodes, self.seed))
            parts += [Remark(one.sentence, "verdict") for one in self.answers]
        parts += [rank_table(league) for league in self.leagues]
        parts += [Remark(problem, "problem") for problem in self.problems]
        if self.interrupted:
            parts.append(Remark("Interrupted.", "note"))
        return Document(parts, {"seed": self.seed, "episodes": self.episodes})

    def record(self) -> dict[str, Any]:
        """What is stored besides the cells."""
        tasks = {
            env: {name: getattr(swept, name) for name in ("levels", "units", "recorded", "failures", "interrupted")}
            for env, swept in self.tasks.items()
        }
        about = {name: getattr(self, name) for name in ("kind", "seed", "episodes", "envs", "quick", "failures")}
        return {**about, "interrupted": self.interrupted, "tasks": tasks}

    def __repr__(self) -> str:
        return f"<Study of {', '.join(map(bare_id, self.tasks)) or 'no task'}, seed {self.seed}>"


def cell_name(kind: str, env: str, setting: str) -> str:
    """The name of a cell. Raises `ConfigurationError` for an id that no file should be called by."""
    return f"{task_name(env)}/{setting}" if kind == SUITE else setting
