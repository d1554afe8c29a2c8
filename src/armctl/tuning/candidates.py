"""Candidates for tuning: a recipe, by trainings, and an installed policy with options, by playing."""

import contextlib
import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from armctl.core.errors import ConfigurationError, unknown_name
from armctl.core.files import read_toml
from armctl.core.search_space import Range, SearchSpace, search_space, value_at, with_values
from armctl.core.seeds import VALIDATION_SEED
from armctl.envs import full_id, new_policy_seed, task_of
from armctl.episodes.failures import unless_failed
from armctl.policies import (
    SUFFIX,
    PolicyConfiguration,
    WorldsByInterface,
    configurations,
    read_configuration,
)
from armctl.rollout.construction import build_policy
from armctl.rollout.loop import rollouts
from armctl.runtime.identity import checksums_of_code
from armctl.study.curves import CURVE, read_curve
from armctl.training.learners import Recipe, load_recipe
from armctl.training.run import code_of, finished, for_sending, train_here
from armctl.tuning.names import check_tunable

RECIPE_KEYS = ("options", "shaping_scale", "reward_weights", "training_options")
POLICY_KEYS = ("options",)
"""Keys of files that can be tuned."""
Score = Literal["return", "success"]
SCORES: tuple[Score, ...] = ("return", "success")
FIRST_TRAINING_SEED = 1000
"""Tuning trains with other seeds than a recipe's own: its published figures are of seeds that it was not tuned on."""
BLOCK = 25
"""Episodes of an expert between two reports."""
WORLDS = 5
"""An expert plays in, so that batches save time and no block waits long for its last episode."""
MAX_EVALUATIONS = 1000
"""Limit of a training's evaluations: the steps of its trial's next training begin so much higher."""

Report = Callable[[int, float], None]
"""Told the score so far after each of a trial's steps; it raises `Pruned` when the trial is not worth more time."""


class Pruned(BaseException):
    """A trial is ended early, since it is worse than most others were at this point.

    Like `KeyboardInterrupt` it is no `Exception`: nothing on the way should take it for a failure.
    """


@dataclass(frozen=True)
class Candidate(ABC):
    """Something with a search space, whose score can be measured with other values."""

    name: str
    space: SearchSpace
    score: Score

    resumes: bool = field(default=False, kw_only=True)
    """True if trainings of a lost trial continue from their checkpoints, which can run code."""

    @property
    @abstractmethod
    def content(self) -> dict[str, Any]:
        """The content of its file."""

    @property
    def present(self) -> dict[str, Any]:
        """Present values by path."""
        return {path: value_at(self.content, path) for path in self.space}

    @abstractmethod
    def measure(self, values: Mapping[str, Any], folder: Path, report: Report) -> list[float]:
        """Scores with these values, of whose median a trial is judged. `folder` is for what it writes."""

    @property
    @abstractmethod
    def judged_by(self) -> str:
        """Criterion by which a trial is judged, in words."""

    @property
    def env(self) -> str:
        """Id of the environment."""
        return str(self.content["env"])

    @property
    def learner(self) -> str:
        """Name of the learner; empty if nothing learns."""
        return str(self.content.get("learner", ""))

    @property
    @abstractmethod
    def code(self) -> dict[str, str]:
        """Checksums of the code that is measured, by file name."""

    def for_sending(self) -> "tuple[Candidate, list[Path]]":
        """Return the candidate as another machine can use it, and the files that it names."""
        return self, []


@dataclass(frozen=True)
class RecipeCandidate(Candidate):
    """A recipe. Its score is that of the best agent of a training, on the held-out episodes by which it is chosen."""

    recipe: Recipe
    seeds: tuple[int, ...]

    @property
    def content(self) -> dict[str, Any]:
        """The content of its file."""
        return self.recipe.model_dump(mode="json", exclude={"name", "tuned"}, exclude_none=True)

    def measure(self, values: Mapping[str, Any], folder: Path, report: Report) -> list[float]:
        """Return a score for each training seed. Each is trained, or resumed, on one core; its curve is reported."""
        recipe, scores = self.recipe.changed(**with_values(self.content, values)), list[float]()
        for i, seed in enumerate(self.seeds):
            home, steps = folder / f"seed-{seed}", itertools.count(i * MAX_EVALUATIONS)
            self._train(recipe, seed, home, lambda score, steps=steps: report(next(steps), score))  # type: ignore[misc]
            curve = read_curve(home / CURVE)
            scores.append(float(curve.sort_values(["success", "return"])[self.score].iloc[-1]))
        return scores

    def _train(self, recipe: Recipe, seed: int, home: Path, report: Callable[[float], None]) -> None:
        """Train, or resume a training, and report each score of its curve. `Pruned` ends it, unless it has finished."""
        with contextlib.suppress(Pruned) if finished(home) else contextlib.nullcontext():
            for score in read_curve(home / CURVE)[self.score].tolist() if (home / CURVE).exists() else ():
                report(score)
        if not finished(home):
            train_here(recipe, seed, home, resume=self.resumes, on_evaluation=lambda row: report(row[self.score]))

    @property
    def code(self) -> dict[str, str]:
        """Checksums of the learner's and the task's code."""
        return code_of(self.recipe)

    def for_sending(self) -> tuple[Candidate, list[Path]]:
        """Return the candidate as another machine can use it, and its teacher's files."""
        recipe, files = for_sending(self.recipe)
        return replace(self, recipe=recipe), files

    @property
    def judged_by(self) -> str:
        """Criterion by which a trial is judged, in words."""
        seeds = " and ".join(map(str, self.seeds))
        return f"the {self.score} of the best agent on held-out episodes; training seeds {seeds}, of several the median"


@dataclass(frozen=True)
class PolicyCandidate(Candidate):
    """An installed policy with options. Its score is a mean over development episodes."""

    configuration: PolicyConfiguration
    episodes: int
    policy_seed: int = field(default_factory=new_policy_seed)
    """Secret of the random numbers that the policy draws itself; all trials of a run have the same."""

    @property
    def content(self) -> dict[str, Any]:
        """The content of its file."""
        return self.configuration.model_dump(mode="json", exclude={"tuned"})

    def measure(self, values: Mapping[str, Any], folder: Path, report: Report) -> list[float]:
        """Return the mean over episodes of the validation seed, reported after each block."""
        configuration = PolicyConfiguration.model_validate(with_values(self.content, values))
        env, lower_bounds, scores = full_id(configuration.env), dict[int, float](), list[float]()
        with contextlib.closing(
            WorldsByInterface(env, min(WORLDS, self.episodes), configuration.env_options, threads=1)
        ) as interfaces:
            worlds = interfaces.of(configuration.policy)
            policy = build_policy(configuration.make(), worlds, self.name, self.policy_seed)
            for step, first in enumerate(range(0, self.episodes, BLOCK)):
                block = range(first, min(first + BLOCK, self.episodes))
                lower_bounds |= dict.fromkeys(block, float("nan"))  # not needed, and slow to compute
                results = rollouts(policy, worlds, block, VALIDATION_SEED, self.name, lower_bounds)
                for result in unless_failed(results):
                    scores.append(result.total_reward if self.score == "return" else float(bool(result.success)))
                report(step, float(np.mean(scores)))
        return [float(np.mean(scores))]

    @property
    def code(self) -> dict[str, str]:
        """Checksums of the policy's and the task's code."""
        return checksums_of_code([self.configuration.make(), task_of(self.env)])

    @property
    def judged_by(self) -> str:
        """Criterion by which a trial is judged, in words."""
        return f"the mean {self.score} of {self.episodes} development episodes"


def candidate_of(
    name: str, *, score: Score = "return", training_seeds: int = 2, episodes: int = 200, env: str | None = None
) -> Candidate:
    """Return the candidate of a name: a recipe or an installed policy, or the path of a file of one.

    A recipe is trained with so many `training_seeds` for a trial, a policy plays so many `episodes`.

    Raises `ConfigurationError` for another name, and for what has no search space.
    """
    if score not in SCORES:
        raise unknown_name("score", score, SCORES)
    for label, count in {"training seeds": training_seeds, "episodes": episodes}.items():
        if count < 1:
            raise ConfigurationError(f"a trial needs at least one of its {label}, not {count}")
    if (file := _file_of_policy(name)) is not None:
        configuration = read_configuration(file)
        if env is not None:
            configuration = configuration.model_copy(update={"env": env})
        space = _space(configuration.tune, configuration.model_dump(), file.name, POLICY_KEYS)
        return PolicyCandidate(name, space, score, configuration, episodes)
    check_tunable(name)
    recipe = load_recipe(name, env)
    space = _space(recipe.tune, recipe.model_dump(exclude={"seeds"}), f"the recipe {name}", RECIPE_KEYS)
    seeds = tuple(range(FIRST_TRAINING_SEED, FIRST_TRAINING_SEED + training_seeds))
    return RecipeCandidate(name, space, score, recipe, seeds)


def _file_of_policy(name: str) -> Path | None:
    """Return the file with the options of a policy; None for a recipe, which has a learner."""
    path = Path(name)
    if path.suffix != SUFFIX:
        return configurations().get(name)
    return path if "policy" in read_toml(path, "recipe") else None


def _space(table: Mapping[str, Any], values: Mapping[str, Any], source: str, keys: Sequence[str]) -> dict[str, Range]:
    if not table:
        raise ConfigurationError(f"{source} has no search space: add a table [tune], with ranges of its options")
    for key in table:
        if key not in keys:
            raise unknown_name(f"key of [tune] in {source}:", key, keys)
    return search_space(table, values, source)
