"""The suite: all tasks with all their policies, undisturbed and under the main disturbances, in one folder.

Each task is a sweep in a folder of its own; `suite.json` says which there are.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from pathlib import Path

from armctl.agents import read_card
from armctl.core.errors import ArmctlError, ConfigurationError, ResultsError
from armctl.core.files import bounded_text, checked_name, inside, one_writer, sealed, unsealed, write_atomically
from armctl.core.registration import bare_id, environment_names
from armctl.envs import full_id
from armctl.episodes.record import EpisodeResult
from armctl.policies import WorldsByInterface, agent_cards, make_policy, policy_names
from armctl.rollout.rollouts import check_counts
from armctl.rollout.seeds import Seed, evaluation_seed
from armctl.runtime.engines import Engine
from armctl.stats.across_tasks import League, family, leagues, rank
from armctl.stats.intervals import Array
from armctl.study.answers import Answer, answer, corrected
from armctl.study.compare import default_policies
from armctl.study.suite_tables import rank_table, task_table
from armctl.study.sweep import Sweep, sweep, sweep_levels
from armctl.verdict.notebook import Displayed
from armctl.verdict.tables import Document, Remark, Table

SUITE = "suite.json"
ALL = "all"
"""As an environment: those of all installed packages."""
UNSKILLED = {"random"}
"""Policies that are left out unless a task has no others."""
HOME = "armctl/"
"""The namespace that is left out of the names of folders."""


@dataclass(frozen=True)
class Size:
    """How much a suite plays."""

    episodes: int
    """Of each policy in each setting."""
    disturbances: tuple[str, ...]
    """Those that a task has of these, or all of its own if it has none of these."""
    levels: tuple[float, ...]
    """Which of a disturbance's default levels: 0 is the one without effect, 1 the strongest."""


FULL = Size(50, ("noise", "noise_on_state", "delay", "payload", "friction", "pushes", "mismatch"), (0.5, 1.0))
"""Two levels of each: on two cores, less than an hour."""
QUICK = Size(20, ("delay", "mismatch"), (0.75,))
"""On two cores, about five minutes."""


@dataclass(frozen=True)
class Plan:
    """What a suite plays in one task."""

    env: str
    policies: tuple[str, ...]
    disturbances: Mapping[str, Sequence[float]]
    unusable: Mapping[str, str] = field(default_factory=dict)
    """Why agents made for the task cannot play, by name."""

    @property
    def runs(self) -> int:
        """Number of policies in all settings."""
        return len(self.policies) * (1 + sum(map(len, self.disturbances.values())))


@dataclass(repr=False)
class Suite(Displayed):
    """The result of a suite. After an interrupt or a failure, it covers the finished episodes."""

    seed: int
    episodes: int
    envs: list[str] = field(default_factory=list)
    """All environments that were asked for."""
    quick: bool = False
    tasks: dict[str, Sweep] = field(default_factory=dict)
    """By environment."""
    failures: dict[str, str] = field(default_factory=dict)
    """Error messages: by environment, or under `results` if `suite.json` could not be written.

    A task that was played without a damaged agent is in both."""
    interrupted: bool = False

    @functools.cached_property
    def answers(self) -> list[Answer]:
        """The answer for each task, after Holm's correction for all. For a finished suite: it is worked out once."""
        return corrected([answer(swept) for swept in self.tasks.values()])

    @functools.cached_property
    def leagues(self) -> list[League]:
        """The ranks of families in the tasks that they share (see `across_tasks.rank` and `leagues`)."""
        found: dict[str, dict[str, Array]] = {}
        for one in self.answers:
            members: dict[str, list[str]] = {}
            for policy in one.policies:
                members.setdefault(family(policy.policy), []).append(policy.policy)
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

    def __repr__(self) -> str:
        return f"<Suite of {', '.join(map(bare_id, self.tasks)) or 'no task'}, seed {self.seed}>"


def suite(
    envs: Sequence[str] = (ALL,),
    *,
    quick: bool = False,
    episodes: int | None = None,
    seed: Seed = 0,
    out: str | Path | None = None,
    overwrite: bool = False,
    worlds: int = 1,
    workers: int | Engine = 1,
    policy_seed: int | None = None,
    progress: Callable[[str, int], None] | None = None,
) -> Suite:
    """Let all policies of all tasks play, undisturbed and under the main disturbances.

    `envs` are environments; `all`, the default, stands for those of all installed packages. Of each, the task's default
    line-up plays, every installed expert that fits, and every installed agent whose card names the environment; random
    actions play only where there is nothing else. `quick` plays less (`QUICK` instead of `FULL`); `episodes` is the
    number of episodes in each setting.

    `out` gets `suite.json` and a sweep's folder for each task. After an interrupt, the same call resumes. A task that
    cannot be played is in `failures`, and keeps none of the others from being played; so is an agent whose files are
    damaged. The other arguments are those of `compare`. `progress` is called for each episode, with the setting and the
    number of all episodes.

    Raises `ConfigurationError` for unusable arguments, and `ResultsError` if `out` cannot be written to, or holds a
    suite of another seed or of further tasks (unless `overwrite`).
    """
    size = QUICK if quick else FULL
    episodes = size.episodes if episodes is None else episodes
    check_counts(episodes=episodes, worlds=worlds, **({"workers": workers} if isinstance(workers, int) else {}))
    seed = evaluation_seed(seed)
    names = [name for env in envs for name in (environment_names() if env == ALL else [env])]
    wanted = {folder_of(name): name for name in dict.fromkeys(map(full_id, names))}
    if not wanted or len(wanted) < len(set(map(full_id, names))):
        raise ConfigurationError(f"a suite needs environments of different names, not {', '.join(names) or 'none'}")
    found = Suite(seed, episodes, list(wanted.values()), quick)
    folder = None if out is None else Path(out)
    with nullcontext() if folder is None else one_writer(folder):
        if folder is not None and not overwrite:
            _check_continues(folder, seed, found.envs)
        plans: dict[str, Plan] = {}
        _write(folder, found)
        try:
            for name, env in wanted.items():
                try:
                    plans[name] = plan_task(env, size)
                except ArmctlError as error:
                    found.failures[env] = str(error)
                    continue
                if plans[name].unusable:
                    found.failures[env] = "; ".join(
                        f"{agent} was left out: {why}" for agent, why in plans[name].unusable.items()
                    )
            total = episodes * sum(plan.runs for plan in plans.values())
            for name, plan in plans.items():
                try:
                    swept = sweep(
                        plan.policies, plan.env, disturbances=plan.disturbances, episodes=episodes, seed=seed,
                        out=folder and inside(folder, name), overwrite=overwrite, worlds=worlds, workers=workers,
                        policy_seed=policy_seed, progress=functools.partial(_told, progress, name, total),
                    )  # fmt: skip
                except ArmctlError as error:
                    found.failures[plan.env] = "; ".join(filter(None, (found.failures.get(plan.env), str(error))))
                    continue
                found.tasks[plan.env] = swept
                if swept.interrupted:
                    found.interrupted = True
                    break
        except KeyboardInterrupt:  # between two sweeps
            found.interrupted = True
        _write(folder, found)
    return found


def _told(progress: Callable[[str, int], None] | None, task: str, total: int, setting: str, _: EpisodeResult) -> None:
    if progress is not None:
        progress(f"{task} {setting}", total)


def plan_task(env: str, size: Size) -> Plan:
    """Who plays in a task, and under which disturbances. Raises `ConfigurationError`."""
    possible = sweep_levels(env)
    main = {name: levels for name, levels in possible.items() if name in size.disturbances} or possible
    if "noise_on_state" in main:  # the same noise, which spares nobody
        main.pop("noise", None)
    levels = {name: sorted({_level(levels, share) for share in size.levels}) for name, levels in main.items()}
    return Plan(env, line_up(env), levels, unusable_agents(env))


def _level(levels: Sequence[float], share: float) -> float:
    """The level at a share of the way from the first, which has no effect, to the last; never the first."""
    return levels[max(1, round(share * (len(levels) - 1)))]


def line_up(env: str) -> tuple[str, ...]:
    """The policies of a task's suite: its default ones, experts that fit, and agents made for it.

    Raises `ConfigurationError`.
    """
    with closing(WorldsByInterface(env, 1)) as worlds:
        names = dict.fromkeys((*default_policies(env), *(name for name in policy_names() if _fits(name, env, worlds))))
    return tuple(name for name in names if name not in UNSKILLED) or tuple(names)


def _fits(name: str, env: str, worlds: WorldsByInterface) -> bool:
    """Whether an installed policy can act in an environment and, if it is an agent, was made for it."""
    try:
        card = getattr(make_policy(name, worlds.of(name)), "card", None)
    except ArmctlError:
        return False
    return card is None or bare_id(card.env) == bare_id(env)


def unusable_agents(env: str) -> dict[str, str]:
    """Why installed agents cannot play the task that they were made for, by name; also those of unreadable cards."""
    told = {}
    with closing(WorldsByInterface(env, 1)) as worlds:
        for name, card in agent_cards().items():
            try:
                if bare_id(read_card(card).env) == bare_id(env):
                    make_policy(name, worlds.of(name))
            except ArmctlError as error:
                told[name] = str(error)
    return told


def folder_of(env: str) -> str:
    """The folder of a task's sweep. Raises `ConfigurationError` for an id that no folder should be called by."""
    return checked_name("task's folder", bare_id(env).removeprefix(HOME).replace("/", "_"))


def _check_continues(folder: Path, seed: int, envs: Sequence[str]) -> None:
    """A folder is resumed with its own seed, and with all its tasks: `suite.json` would forget those left out."""
    if not (folder / SUITE).exists():
        return
    try:
        told = unsealed(bounded_text(folder / SUITE))
    except (OSError, ValueError) as error:
        raise ResultsError(f"{folder / SUITE} cannot be read: {error}; overwrite all (--overwrite)") from error
    there, tasks = told.get("seed"), told.get("envs")
    if there != seed:
        raise ResultsError(
            f"{folder} holds a suite of another seed ({there} there, {seed} here): choose another folder, or overwrite "
            "it (--overwrite)"
        )
    if further := [str(env) for env in (tasks if isinstance(tasks, list) else []) if env not in envs]:
        raise ResultsError(
            f"{folder} holds a suite of further tasks ({', '.join(further)}): name these too, choose another folder, "
            "or overwrite it (--overwrite)"
        )


def _write(folder: Path | None, found: Suite) -> None:
    if folder is None:
        return
    told = {
        "seed": found.seed, "episodes": found.episodes, "envs": found.envs, "quick": found.quick,
        "failures": found.failures, "interrupted": found.interrupted,
    }  # fmt: skip
    try:
        write_atomically(folder / SUITE, sealed(told))
    except OSError as error:
        found.failures["results"] = f"{folder / SUITE} could not be written: {error.strerror}"
