"""Shared by all learners: a training's folder, costs, learning curve on held-out episodes, and best agent."""

import dataclasses
import json
import logging
import math
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Self

import gymnasium
import numpy as np
import pandas as pd
import torch
from pydantic import Field
from stable_baselines3.common.logger import configure

from armctl.agents import AgentCard, Evaluation, sha256, shapes
from armctl.core.errors import ConfigurationError
from armctl.core.files import one_writer, write_atomically
from armctl.core.options import options
from armctl.envs import EpisodeVectorEnv, make_worlds
from armctl.episodes.failures import unless_failed
from armctl.rl.actor import Actor
from armctl.rl.disk import full_disk_told, save_torch
from armctl.rl.lineage import lineage_of, tuning_before
from armctl.rl.meter import COUNTS, Meter, Metered
from armctl.rl.threads import bounded_threads
from armctl.rl.view import Features, View, view_of
from armctl.rollout import evaluate
from armctl.rollout.rollouts import rollouts
from armctl.rollout.seeds import DEVELOPMENT_SEED, TRAINING_SEEDS, VALIDATION_SEED
from armctl.runtime.identity import checksums
from armctl.runtime.provenance import versions
from armctl.shaping import Shaped
from armctl.stats.intervals import success_rate
from armctl.study.curves import COSTS, CURVE, read_curve
from armctl.study.reproduce import evaluation_of
from armctl.training.learners import Callback, Recipe

LOG = logging.getLogger(__name__)

VALIDATION_WORLDS = 50
SETTINGS, CLOCK = "settings.json", "clock.json"
RECIPE_ON_CARD = (
    "learner", "env", "env_options", "training_options", "shaping", "reward_weights", "curriculum", "teacher",
)  # fmt: skip

Count = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0)]


@options
class TrainingOptions:
    """Options that all learners share."""

    steps: Count = 3_000_000
    """Environment steps, over all worlds."""
    worlds: Count = 256
    gamma: Share = 0.97
    """Discount factor."""
    learning_rate: Positive = 1e-3
    hidden_units: Count = 128
    """Per layer."""
    layers: Count = 2
    relative: bool = True
    """Position commands of an arm are relative to the observed joint positions, not absolute."""
    features: Features = "plain"
    """Input of the network: the bare observation (`none`), the task's features (`plain`), or features that are
    invariant under rotations of the scene (`invariant`) or know the robot's geometry (`model`), if the task has any."""
    evaluation_every: Count = 250_000
    """Steps between two evaluations on held-out episodes, each with a checkpoint."""
    validation_episodes: Count = 100
    """Episodes of each of these evaluations."""
    evaluation_episodes: Count = 1000
    """Development episodes of the final evaluation, which goes on the card."""


class Training:
    """One training: a recipe, trained with one seed, in one folder.

    Making one checks the recipe and the folder, and writes nothing. It is a context manager, whose beginning makes the
    folder: whatever else may be refused, such as a teacher, is checked before that. It writes `settings.json`,
    `checkpoints/`, `tensorboard/`, `curve.csv` and the best actor so far, `best.pt`, and in the end `agent.onnx` and
    `agent.json`. Checkpoints are pickles: resume only trainings that you trust.

    Raises `ConfigurationError` for a recipe that cannot be followed, or a folder that another training has used, and
    `ResultsError` at its end if the disk is full; finished checkpoints are whole. `callback` is the learner's
    `on_evaluation`.
    """

    def __init__(
        self, recipe: Recipe, options: TrainingOptions, out: Path, seed: int, resume: bool, callback: Callback = None
    ) -> None:
        if not 0 <= seed < 2**32:
            raise ConfigurationError(f"a training seed is a whole number from 0 to {2**32 - 1}, not {seed}")
        self.recipe, self.options, self.out, self.seed = recipe, options, out, seed
        self._on_evaluation = callback or (lambda row: None)
        self.held_out = make_worlds(recipe.env, min(VALIDATION_WORLDS, options.validation_episodes), recipe.env_options)
        with ExitStack() as opened:
            stages = [opened.enter_context(closing(self._make_worlds(stage, 1))) for stage in recipe.stages]
            self.view = view_of(self.held_out, features=options.features, relative=options.relative)
            for worlds in stages:
                _check_alike(worlds, self.held_out, self.view)
            if getattr(options, "privileged_critic", False):
                _check_states(stages)
        self._lineage = lineage_of(recipe, options, self.held_out)
        self._check_folder(resume)
        newest = self.newest_checkpoint()
        self.meter = Meter(out / CLOCK, resumed=newest is not None)
        self.stage = self._stage_at(int(newest.stem) if newest else 0)
        """The recipe as it is at present."""
        self.worlds = Metered(self._make_worlds(self.stage, options.worlds), self.meter)
        """Those to train in at present. They are others in another stage of the curriculum: see `enter_stage`."""
        curve = self.curve()
        self._evaluated = curve[-1]["steps"] if curve else -math.inf

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            opened.enter_context(full_disk_told(self.out))
            opened.callback(lambda: self.worlds.close())
            opened.callback(self.held_out.close)
            opened.enter_context(bounded_threads())
            opened.enter_context(one_writer(self.out))
            try:
                (self.out / "checkpoints").mkdir(parents=True, exist_ok=True)
                write_atomically(self.out / SETTINGS, json.dumps(self._settings(), indent=2))
                self.logger = configure(str(self.out / "tensorboard"), ["tensorboard"])
            except OSError as error:
                raise ConfigurationError(f"the training cannot be written to {self.out}: {error.strerror}") from error
            opened.callback(self.logger.close)
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._opened.__exit__(*error)

    def first_seed(self, steps: int = 0) -> int:
        """Seed of the first world after so many steps: a resumed training plays episodes that are new to it."""
        return (self.seed + 1) * TRAINING_SEEDS + steps

    def enter_stage(self, steps: int) -> bool:
        """Whether a stage of the curriculum has begun since the last call, so that `worlds` are others."""
        before, self.stage = self.stage, self._stage_at(steps)
        if self.stage == before:
            return False
        self.worlds.close()
        self.worlds = Metered(self._make_worlds(self.stage, self.options.worlds), self.meter)
        return True

    def curve(self) -> list[dict[Any, Any]]:
        """Evaluations on held-out episodes so far, with `armctl.study.curves.CURVE_COLUMNS`."""
        file = self.out / CURVE
        return read_curve(file).to_dict("records") if file.exists() else []

    def newest_checkpoint(self) -> Path | None:
        """The checkpoint with the most steps."""
        found = (path for path in (self.out / "checkpoints").glob("*.zip") if path.stem.isdecimal())
        return max(found, key=lambda path: int(path.stem), default=None)

    def checkpoint(self, steps: int, save: Callable[[Path], Any]) -> None:
        """Write a checkpoint, by a function that writes it to a path, and what the training has spent."""
        write_atomically(self.out / "checkpoints" / f"{steps}.zip", save)
        write_atomically(self.out / CLOCK, json.dumps(self.meter.read()))

    def due(self, steps: int) -> bool:
        """Whether a checkpoint and an evaluation are due."""
        return steps - self._evaluated >= self.options.evaluation_every

    def evaluate(self, actor: Actor, steps: int) -> None:
        """Evaluate the actor on held-out episodes, add the result to the curve, and save the actor if it is best."""
        if steps == self._evaluated:
            return
        self._evaluated = steps
        episodes = self.options.validation_episodes
        unknown = dict.fromkeys(range(episodes), math.nan)  # least lengths take longer than the episodes
        results = list(unless_failed(rollouts(actor, self.held_out, episodes, VALIDATION_SEED, "agent", unknown)))
        rate = success_rate(np.array([result.success for result in results], dtype=bool))
        assert rate is not None
        mean_return = float(np.mean([result.total_reward for result in results]))
        row = {
            "steps": steps,
            "minutes": round(self.meter.seconds / 60, 3),
            "success": rate.value,
            "low": rate.low,
            "high": rate.high,
            "return": mean_return,
            **{name: self.meter.read()[name] for name in COSTS},
        }
        best = self._best()
        if best is None or (rate.value, mean_return) > (best["success"], best["return"]):
            write_atomically(self.out / "best.pt", lambda path: save_torch({**row, "actor": actor.state_dict()}, path))
        curve = pd.DataFrame([*self.curve(), row]).astype({"steps": int, "decisions": "Int64"})
        write_atomically(self.out / CURVE, curve.to_csv(index=False))
        LOG.info("%s steps: success %.1f%% of %s held-out episodes", f"{steps:,}", 100 * rate.value, episodes)
        for name in ("success", "return"):
            self.logger.record(f"held-out/{name}", row[name])
        self.logger.dump(steps)
        self._on_evaluation(row)

    def finish(self, actor: Actor, steps: int) -> AgentCard:
        """Evaluate the last actor too, export the best one, and write its card with an evaluation in development."""
        self.evaluate(actor, steps)
        best = self._best()
        assert best is not None
        actor.load_state_dict(best["actor"])
        graph = self.out / "agent.onnx"
        write_atomically(graph, actor.export)
        recipe, worlds, spent, plain = self.recipe, self.held_out, self.meter.read(), _plain(self.recipe)
        card = AgentCard(
            name=self.out.name,
            recipe=recipe.name,
            shaping_scale=recipe.shaping_scale if recipe.shaping else None,
            **{name: plain[name] for name in RECIPE_ON_CARD},
            lineage=self._lineage,
            tuning=tuning_before(recipe, self.seed, self.out),
            interface=worlds.task.interface,
            observation_shape=shapes(worlds.single_observation_space),
            action_shape=list(worlds.single_action_space.shape or ()),
            memory={name: list(shape) for name, shape in actor.memory.items()},
            training_steps=steps,
            best_after=best["steps"],
            training_minutes=round(spent["seconds"] / 60, 2),
            **{name: spent[name] for name in (*COUNTS, "processor_seconds")},
            training_seed=self.seed,
            learner_options=dataclasses.asdict(self.options),
            versions=versions() | {name: version(name) for name in ("stable-baselines3", "torch", "onnx")},
            sha256=sha256(graph),
        )
        self._write(card)
        card.evaluation = self._final_evaluation()
        self._write(card)
        return card

    def _stage_at(self, steps: int) -> Recipe:
        return self.recipe.after(steps / self.options.steps)

    def _make_worlds(self, recipe: Recipe, count: int) -> gymnasium.vector.VectorEnv[Any, Any, Any]:
        options = self.options
        rewards = {"reward_scale": getattr(options, "reward_scale", 1.0), "reward_weights": recipe.reward_weights}
        env_options = recipe.options_in_training | rewards
        worlds = make_worlds(recipe.env, count, env_options, autoreset_mode="same_step")
        if recipe.shaping is None:
            return worlds
        return Shaped(worlds, recipe.shaping, gamma=options.gamma, scale=recipe.shaping_scale)

    def _settings(self) -> dict[str, Any]:
        settings = _plain(self.recipe) | {"seed": self.seed, "options": dataclasses.asdict(self.options)}
        del settings["seeds"], settings["tune"], settings["tuned"]
        return settings | checksums(self.recipe.env, self.held_out, self.recipe.env_options)

    def _check_folder(self, resume: bool) -> None:
        """Check that the folder is unused, or holds the training to resume; only `steps` may differ."""
        record = self.out / SETTINGS
        there = next(path for path in (self.out, *self.out.absolute().parents) if path.exists())
        if not (there.is_dir() and os.access(there, os.W_OK)):
            raise ConfigurationError(
                f"the training cannot be written to {self.out}: {there} is not a folder that can be written to"
            )
        if resume:
            _check_same(record, self._settings())
        elif record.exists():
            raise ConfigurationError(
                f"{self.out} holds a training already: resume it (--resume), or choose another folder"
            )

    def _best(self) -> dict[str, Any] | None:
        file = self.out / "best.pt"
        return torch.load(file, weights_only=True) if file.exists() else None

    def _final_evaluation(self) -> Evaluation:
        episodes = evaluate(
            self.out / "agent.json",
            self.recipe.env,
            episodes=self.options.evaluation_episodes,
            seed=DEVELOPMENT_SEED,
            worlds=64,
            env_options=self.recipe.env_options,
            least_lengths=False,
        )
        return evaluation_of(episodes, DEVELOPMENT_SEED)

    def _write(self, card: AgentCard) -> None:
        write_atomically(self.out / "agent.json", card.model_dump_json(indent=2) + "\n")


def check_no_curriculum(recipe: Recipe) -> None:
    """Raise `ConfigurationError` for a recipe with a curriculum: for learners whose worlds stay the same."""
    if recipe.curriculum:
        raise ConfigurationError(f"{recipe.learner} takes no curriculum: ppo, cloned_ppo, distil and distilled_ppo do")


def bar_fits(progress: bool) -> bool:
    """Whether to show a progress bar that was asked for: in a terminal only, since it would flood a log file."""
    return progress and sys.stdout.isatty() and sys.stderr.isatty()


def _check_alike(trained: Any, judged: EpisodeVectorEnv, view: View) -> None:
    """Raise `ConfigurationError` if agents see or command the robot in training otherwise than in evaluations.

    If the view prepares observations, these are what has to be alike.
    """
    first, second = (
        (
            {name: value for name, value in worlds.task.interface.items() if name != "observation" or not view.prepare},
            shapes(view.prepared(worlds.single_observation_space)),
            worlds.single_action_space,
        )
        for worlds in (trained.unwrapped, judged)
    )
    if first != second:
        raise ConfigurationError(
            "training_options must not change what the agent sees or how it acts: that belongs in env_options"
        )


def _check_states(stages: Sequence[Any]) -> None:
    """Raise `ConfigurationError` if the states that a critic sees differ between stages."""
    first, *others = (worlds.unwrapped.task.state_space for worlds in stages)
    if any(space != first for space in others):
        raise ConfigurationError("a privileged critic sees the state, whose space no stage of a curriculum may change")


def _plain(recipe: Recipe) -> dict[str, Any]:
    """The recipe as JSON values."""
    return recipe.model_dump(mode="json", fallback=str)


def _check_same(record: Path, settings: dict[str, Any]) -> None:
    if not record.exists():
        raise ConfigurationError(f"there is no training to resume in {record.parent}")
    try:
        before = _flat(json.loads(record.read_text()))
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"{record} was not written by a training: it was changed, or damaged") from error
    for key, value in _flat(settings).items():
        if before.get(key) != value and key != "steps":
            raise ConfigurationError(
                f"the training in {record.parent} was started with {key} {before.get(key)!r}, not {value!r}"
            )


def _flat(settings: dict[str, Any]) -> dict[str, Any]:
    return {**settings, **settings["options"], "options": None}
