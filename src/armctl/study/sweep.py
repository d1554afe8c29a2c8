"""Robustness of policies: one comparison without disturbances, and one for each level of each disturbance."""

import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd

from armctl import DEFAULT_ENV
from armctl.core.errors import ConfigurationError, ResultsError, unknown_name
from armctl.core.files import digest, inside, one_writer, sealed, write_atomically
from armctl.core.registration import bare_id
from armctl.disturbances import DisturbanceSpec, available
from armctl.envs import chosen_policy_seed, full_id, make_worlds
from armctl.episodes.record import EpisodeResult
from armctl.episodes.store import stored_policy_seed
from armctl.policies import expanded, learners, named_policies
from armctl.rollout.real_time import (
    SLOW_DOWN,
    SLOWER,
    RealTime,
    check_measurable,
    check_real_time,
    check_recorded,
    read_recording,
    recorded_times,
)
from armctl.rollout.seeding import seed_notes
from armctl.rollout.seeds import Seed, evaluation_seed
from armctl.runtime.engines import Engine, engine_of
from armctl.stats.degradation import change_between, change_of_group
from armctl.stats.intervals import Bounds, Estimate
from armctl.stats.paired import PairedDifference
from armctl.stats.robustness import NEUTRAL, Pair, PairTest
from armctl.study.compare import compare, default_policies, with_return_bounds
from armctl.study.comparison import Comparison
from armctl.study.curves import COMPARISONS, LOOKS, PAIRS, POINTS, RECORDED, SWEEP, comparison_in
from armctl.verdict.notebook import Displayed
from armctl.verdict.scores import counted_rows
from armctl.verdict.summary import PolicySummary
from armctl.verdict.summary_tables import sweep_parts
from armctl.verdict.tables import Document, Remark

COLUMNS = (
    "disturbance", "level", "policy", "episodes", "success", "low", "high", "return", "return_low", "return_high",
    "steps_to_goal", "steps_low", "steps_high", "p", "change", "unit", "sees",
    "spared",
)  # fmt: skip
"""Of `sweep.csv`: one row per disturbance, level and policy, with 95 % intervals. `p` is McNemar's p-value for equal
success in the same episodes without the disturbance, or the sign test's for equal return if success is unknown; for a
group of trainings, that of random weights of trainings and of episodes. `change` is what it tests: success minus
that without the disturbance, or the share of episodes with a higher return minus the share with a lower one.
`spared` is True where the disturbance does not reach the policy, which is in no test then: `p` and `change` are NaN."""
UNDISTURBED = "none"
Asked = Mapping[str, Sequence[float] | None] | Sequence[str] | None


@dataclass(repr=False)
class Sweep(Displayed):
    """The result of a sweep. After an interrupt or a failure, it covers the finished comparisons."""

    env: str
    seed: int
    levels: Mapping[str, Sequence[float]]
    """The levels of each disturbance, beginning with the one that changes nothing."""
    comparisons: dict[str, Comparison] = field(default_factory=dict)
    """By the names of their folders: `none`, `payload-2.0` and so on."""
    points: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(COLUMNS)))
    """The rows of `sweep.csv`."""
    failures: dict[str, str] = field(default_factory=dict)
    """Error messages: by comparison and policy, or under `results` if results could not be written."""
    recorded: str = ""
    """Where the decision times of the slow-down levels come from; empty without such levels."""
    interrupted: bool = False

    def document(self) -> Document:
        """A table for each disturbance, and from which level each policy gets worse."""
        parts = sweep_parts(self.points, self.pairs, self.looks)
        waiting = (comparison for comparison in self.comparisons.values() if comparison.real_time is None)
        notes = itertools.chain.from_iterable(comparison.notes for comparison in waiting)
        parts += [Remark(note, "note") for note in dict.fromkeys(notes)]
        if self.recorded:
            times = f"with the decision times of {self.recorded}"
            parts.append(Remark(f"{SLOWER}: in real time, {times}; at 0 the world waits."))
        parts += [Remark(f"{what}: {why}", "problem") for what, why in self.failures.items()]
        if self.interrupted:
            parts.append(Remark("Interrupted.", "note"))
        return Document(parts, {"env": self.env, "seed": self.seed})

    @property
    def pairs(self) -> dict[Pair, PairTest]:
        """The test of each two policies in the same episodes: for equal success, or the sign test if it is unknown."""
        where = {folder_name(name, level): (name, level) for name, levels in self.levels.items() for level in levels}
        where[UNDISTURBED] = NEUTRAL
        return {
            (*where[name], frozenset((pair.a, pair.b))): _test_of(pair)
            for name, comparison in self.comparisons.items()
            for pair in comparison.paired
        }

    @property
    def looks(self) -> list[int]:
        """The numbers of episodes after which earlier runs of any comparison told a verdict."""
        return sorted({look for comparison in self.comparisons.values() for look in comparison.looks})

    def __repr__(self) -> str:
        names = ", ".join(dict.fromkeys(self.points.policy)) or "no policy"
        swept = ", ".join(f"{name} at {len(levels)} levels" for name, levels in self.levels.items())
        return f"<Sweep of {names} in {self.env}, seed {self.seed}: {swept}>"


def sweep(
    policies: Any = None,
    env: str = DEFAULT_ENV,
    *,
    disturbances: Asked = None,
    episodes: int = 100,
    seed: Seed = 0,
    out: str | Path | None = None,
    overwrite: bool = False,
    worlds: int = 1,
    workers: int | Engine = 1,
    env_options: Mapping[str, Any] | None = None,
    real_time: str | Path | None = None,
    return_bounds: Bounds | None = None,
    policy_seed: int | None = None,
    progress: Callable[[str, EpisodeResult], None] | None = None,
) -> Sweep:
    """Compare policies on the same episodes, undisturbed and at each level of each disturbance.

    `disturbances` are names, or levels by name; None as levels means the disturbance's default levels. By default, all
    disturbances of the environment are swept. `slow-down` stands for a slower computer in real time (see `compare`):
    its levels are by how much decisions take longer; at 0 the world waits. All levels repeat the same decision times,
    those in the results folder `real_time`, or else those of the undisturbed comparison, which then needs one world and
    one worker.

    The other arguments are those of `compare`; all comparisons have one `policy_seed`. `out` gets `sweep.csv` and a
    comparison's folder for each level, `out/none` for that without disturbance. The same call resumes an interrupted
    sweep, and a call with more levels extends it. `progress` is called with the comparison's name and the episode.

    Raises `ConfigurationError`, `AgentFileError`, and `ResultsError` as `compare` does.
    """
    env, env_options = full_id(env), with_return_bounds(env_options, return_bounds)
    options = dict(env_options)
    seed = evaluation_seed(seed)
    specs = _specs(env, options)
    levels = _levels(specs, disturbances)
    by_name = named_policies(default_policies(env) if policies is None else policies)
    players, groups = expanded(by_name)
    found = Sweep(env, seed, levels)
    recorded = None if real_time is None else read_recording(Path(real_time), 1.0, env, seed)
    if SLOWER in levels:
        with closing(make_worlds(env, 1, options)) as made:
            check_real_time(bare_id(env), made)
        if recorded is None:
            check_measurable(worlds, engine_of(workers).workers)
            found.recorded = "the undisturbed comparison"
        else:
            check_recorded(recorded, players, episodes)
            found.recorded = recorded.latency
    elif recorded is not None:
        raise ConfigurationError(f"real_time is for the levels of {SLOWER}, of which none is asked for (--slow-down)")
    folder = None if out is None else Path(out)
    stored = None if folder is None or overwrite else stored_policy_seed(folder / UNDISTURBED)
    secret = chosen_policy_seed(policy_seed, stored)
    constant = dict(options.pop("disturbances", {}))
    least: dict[int, float] = {}
    seeding = seed_notes(env, env_options)
    settings: dict[str, dict[str, float]] = {UNDISTURBED: {}}
    settings |= {folder_name(name, level): {name: level} for name in levels for level in levels[name][1:]}
    undisturbed: list[EpisodeResult] = []

    def told(name: str, result: EpisodeResult) -> None:
        if name == UNDISTURBED:
            undisturbed.append(result)
        if progress is not None:
            progress(name, result)

    with nullcontext() if folder is None else one_writer(folder):
        for name, added in settings.items():
            slower = added.pop(SLOWER, None)
            playing, late = by_name, None
            if slower is not None:
                late = recorded or RealTime(latency=found.recorded, recorded=recorded_times(undisturbed))
                late = replace(late, slow_down=slower)
                lacking = late.lacking(players, episodes)
                without = learners(list(lacking), groups)
                playing = {policy: given for policy, given in by_name.items() if policy not in without}
                found.failures |= {
                    f"{name}: {policy}": f"no decision times of episode {k}" for policy, k in lacking.items()
                }
                if not playing:
                    continue
            disturbing = {"disturbances": constant | added} if constant | added else {}
            try:
                comparison = compare(
                    playing, env, episodes=episodes, seed=seed, out=folder and inside(folder, name),
                    overwrite=overwrite, worlds=worlds, workers=workers, env_options=options | disturbing,
                    least_lengths=least, seeding=seeding, real_time=late,
                    policy_seed=secret, progress=functools.partial(told, name),
                )  # fmt: skip
            except ResultsError as error:
                if name == UNDISTURBED:
                    raise
                found.failures["results"] = str(error)
                break
            except KeyboardInterrupt:  # between two comparisons
                found.interrupted = True
                break
            found.comparisons[name] = comparison
            found.failures |= {
                what if what == "results" else f"{name}: {what}": why for what, why in comparison.failures.items()
            }
            found.interrupted = comparison.interrupted
            if found.interrupted or "results" in comparison.failures:
                break
        found.points = _points(found, specs)
        if folder is not None:
            asked = {
                "env_options": {name: str(value) for name, value in (env_options or {}).items()},
                "episodes": episodes, "policies": list(by_name), RECORDED: real_time and str(real_time),
            }  # fmt: skip
            _write(folder, found, asked)
    return found


def _write(folder: Path, found: Sweep, asked: Mapping[str, Any]) -> None:
    points = found.points.to_csv(index=False)
    try:
        told = {
            "env": found.env, "seed": found.seed, **asked, "disturbances": found.levels,
            "interrupted": found.interrupted, "failures": found.failures, POINTS: digest(points),
            LOOKS: found.looks, PAIRS: [(*where, *sorted(both), *test) for (*where, both), test in found.pairs.items()],
            COMPARISONS: {name: comparison_in(folder / name) for name in found.comparisons},
        }  # fmt: skip
        write_atomically(folder / POINTS, points)
        write_atomically(folder / SWEEP, sealed(told))
    except OSError as error:
        found.failures["results"] = f"{folder / POINTS} could not be written: {error.strerror}"
    except ResultsError as error:
        found.failures["results"] = str(error)


def sweep_levels(
    env: str, disturbances: Asked = None, env_options: Mapping[str, Any] | None = None
) -> dict[str, list[float]]:
    """The levels of a sweep's disturbances without repeats, ordered by their distance from the one without effect.

    Raises `ConfigurationError`.
    """
    return _levels(_specs(env, env_options or {}), disturbances)


def folder_name(disturbance: str, level: float) -> str:
    """The folder of the comparison at a level."""
    return f"{disturbance}-{level}"


def _specs(env: str, options: Mapping[str, Any]) -> dict[str, DisturbanceSpec]:
    made = make_worlds(env, 1, options)
    made.close()
    constant = options.get("disturbances", {})
    specs = available(made.task.disturbances, made.task)
    return {name: spec for name, spec in specs.items() if name not in constant} | {SLOWER: SLOW_DOWN}


def _levels(specs: Mapping[str, DisturbanceSpec], disturbances: Asked) -> dict[str, list[float]]:
    if disturbances is None:
        disturbances = [name for name in specs if name != SLOWER]
    given = [disturbances] if isinstance(disturbances, str) else disturbances
    asked: Mapping[str, Any] = given if isinstance(given, Mapping) else dict.fromkeys(given)
    levels = {}
    for name, wanted in asked.items():
        if name not in specs:
            raise unknown_name("disturbance to sweep here", name, specs)
        spec = specs[name]
        wanted = spec.levels if wanted is None else wanted
        if isinstance(wanted, str) or not isinstance(wanted, Sequence):
            raise ConfigurationError(f"the levels of {name} are numbers, such as {list(spec.levels)}, not {wanted!r}")
        others = {spec.checked(name, level) for level in wanted} - {spec.neutral}
        if not others:
            raise ConfigurationError(f"{name} needs a level besides {spec.neutral:g}, which changes nothing")
        levels[name] = [spec.neutral, *sorted(others, key=functools.partial(_away, spec.neutral))]
    return levels


def _away(neutral: float, level: float) -> tuple[float, float]:
    return abs(level - neutral), level


def _points(found: Sweep, specs: Mapping[str, DisturbanceSpec]) -> pd.DataFrame:
    rows = []
    for name, levels in found.levels.items():
        for i, level in enumerate(levels):
            comparison = found.comparisons.get(folder_name(name, level) if i else UNDISTURBED)
            for policy in comparison.policies if comparison else []:
                values = (
                    name, level, policy.policy, policy.episodes, *_numbers(policy.success),
                    *_numbers(policy.episode_return), *_numbers(policy.steps_to_goal),
                    *(_against_undisturbed(found, comparison, policy) if i else (1.0, 0.0)), specs[name].unit,
                    policy.sees, bool(policy.spared),
                )  # fmt: skip
                rows.append(dict(zip(COLUMNS, values, strict=True)))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _numbers(estimate: Estimate | None) -> tuple[float, float, float]:
    """Value and bounds; NaN where unknown."""
    if estimate is None:
        return math.nan, math.nan, math.nan
    low, high = (math.nan if bound is None else bound for bound in (estimate.low, estimate.high))
    return estimate.value, low, high


def _test_of(pair: PairedDifference) -> PairTest:
    success = pair.success_difference
    if pair.mcnemar_p is None or success is None:
        p, lead = pair.superiority.p, 2 * pair.superiority.probability.value - 1
    else:
        p, lead = pair.mcnemar_p, success.value
    return PairTest(p, lead if pair.a < pair.b else -lead)


def _against_undisturbed(found: Sweep, comparison: Comparison | None, policy: PolicySummary) -> tuple[float, float]:
    """The p-value for no change in the same episodes, and the change: see `COLUMNS`."""
    if policy.spared:
        return math.nan, math.nan
    played = [counted_rows(one.episodes) for one in (found.comparisons[UNDISTURBED], comparison) if one is not None]
    before, after = (rows[rows.policy.isin(policy.trainings or [policy.policy])] for rows in played)
    score = "return" if policy.success is None else "success"
    return (change_of_group if policy.trainings else change_between)(before, after, score)
