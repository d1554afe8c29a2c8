"""Shared by all learners: a training's folder, costs, learning curve on held-out episodes, and best agent."""

import dataclasses
import json
import logging
import math
import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack, closing
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import gymnasium
import numpy as np
import pandas as pd
import torch
from stable_baselines3.common.logger import configure

from armctl.agents import CARD, GRAPH, AgentCard, Evaluation, sha256, shapes
from armctl.core.errors import ConfigurationError, os_errors_as
from armctl.core.files import FORMAT, Content, check_format, one_writer, sealed, write_atomically
from armctl.core.seeds import DEVELOPMENT_SEED, TRAINING_SEEDS, VALIDATION_SEED
from armctl.envs import EpisodeVectorEnv, make_worlds
from armctl.episodes.failures import unless_failed
from armctl.policies import Policy
from armctl.policies.filtered import Filtered, FilteredWorlds, SafetyFilter
from armctl.rl.networks.actor import Actor
from armctl.rl.networks.view import View, view_of
from armctl.rl.run.disk import raise_on_full_disk, torch_bytes
from armctl.rl.run.lineage import lineage_of, tuning_before
from armctl.rl.run.meter import CLOCK_FORMAT, COUNTS, SAFETY, Meter, Metered
from armctl.rl.run.options import TrainingOptions
from armctl.rl.run.threads import bounded_threads
from armctl.rollout import evaluate
from armctl.rollout.loop import rollouts
from armctl.runtime.identity import checksums
from armctl.runtime.provenance import versions
from armctl.shaping import Shaped
from armctl.stats.intervals import success_rate
from armctl.study.curves import COSTS, CURVE, read_curve
from armctl.study.reproduce import evaluation_of
from armctl.training.learners import Callback, Recipe
from armctl.training.run import SETTINGS
from armctl.training.trials import CHECKPOINTS, CLOCK, newest_checkpoint

LOG = logging.getLogger(__name__)

VALIDATION_ENVS = 100
SETTINGS_FORMAT = 1
"""Format of `settings.json`, and of the folder that holds it."""
RECIPE_ON_CARD = (
    "learner", "env", "env_options", "training_options", "shaping", "reward_weights", "curriculum", "teacher",
)  # fmt: skip


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
        self,
        recipe: Recipe,
        options: TrainingOptions,
        out: Path,
        seed: int,
        resume: bool,
        callback: Callback = None,
        progress: bool = False,
    ) -> None:
        if not 0 <= seed < 2**32:
            raise ConfigurationError(f"a training seed is a whole number from 0 to {2**32 - 1}, not {seed}")
        self.recipe, self.options, self.out, self.seed = recipe, options, out, seed
        self._on_evaluation = callback or (lambda row: None)
        self.shows_bars = bar_fits(progress)
        """True if progress bars are shown."""
        self.held_out = make_worlds(recipe.env, min(VALIDATION_ENVS, options.validation_episodes), recipe.env_options)
        with ExitStack() as opened:
            stages = [opened.enter_context(closing(self._make_envs(stage, 1))) for stage in recipe.stages]
            self.view = view_of(self.held_out, features=options.features, relative=options.relative)
            for envs in stages:
                _check_same_interface(envs, self.held_out, self.view)
            if getattr(options, "privileged_critic", False):
                _check_states(stages)
        self._lineage = lineage_of(recipe, options, self.held_out)
        self._check_folder(resume)
        newest = self.newest_checkpoint()
        self.meter = Meter(out / CLOCK, resumed=newest is not None)
        self.stage = self._stage_at(int(newest.stem) if newest else 0)
        """Recipe as it is at present."""
        self.envs = Metered(self._make_envs(self.stage, options.worlds), self.meter)
        """Worlds to train in at present. They are others in another stage of the curriculum: see `enter_stage`."""
        curve = self.curve()
        self._evaluated = curve[-1]["steps"] if curve else -math.inf

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            opened.enter_context(raise_on_full_disk(self.out))
            opened.callback(lambda: self.envs.close())
            opened.callback(self.held_out.close)
            opened.enter_context(bounded_threads())
            opened.enter_context(one_writer(self.out))
            with os_errors_as(f"the training cannot be written to {self.out}", ConfigurationError):
                (self.out / CHECKPOINTS).mkdir(parents=True, exist_ok=True)
                write_atomically(self.out / SETTINGS, json.dumps(self._settings(), indent=2))
                self.logger = configure(str(self.out / "tensorboard"), ["tensorboard"])
            opened.callback(self.logger.close)
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._opened.__exit__(*error)

    def first_seed(self, steps: int = 0) -> int:
        """Return the seed of the first world after so many steps: a resumed training plays new episodes."""
        return (self.seed + 1) * TRAINING_SEEDS + steps

    def enter_stage(self, steps: int) -> bool:
        """Return whether a stage of the curriculum has begun since the last call, so that `envs` are others."""
        previous, self.stage = self.stage, self._stage_at(steps)
        if self.stage == previous:
            return False
        self.envs.close()
        self.envs = Metered(self._make_envs(self.stage, self.options.worlds), self.meter)
        return True

    def curve(self) -> list[dict[Any, Any]]:
        """Return the evaluations on held-out episodes so far, with `armctl.study.curves.CURVE_COLUMNS`."""
        file = self.out / CURVE
        return read_curve(file).to_dict("records") if file.exists() else []

    def newest_checkpoint(self) -> Path | None:
        """Return the checkpoint with the most steps."""
        return newest_checkpoint(self.out)

    def checkpoint(self, steps: int, content: Content) -> None:
        """Write what the training has spent, and a checkpoint."""
        write_atomically(self.out / CLOCK, sealed({FORMAT: CLOCK_FORMAT, **self.meter.read()}))
        write_atomically(self.out / CHECKPOINTS / f"{steps}.zip", content)

    def due(self, steps: int) -> bool:
        """Return whether a checkpoint and an evaluation are due."""
        return steps - self._evaluated >= self.options.evaluation_every

    def evaluate(self, actor: Actor, steps: int) -> None:
        """Evaluate the actor on held-out episodes, add the result to the curve, and save the actor if it is best."""
        if steps == self._evaluated:
            return
        self._evaluated = steps
        episodes = self.options.validation_episodes
        unknown = dict.fromkeys(range(episodes), math.nan)  # lower bounds take longer than the episodes
        policy = self._as_played(actor)
        results = list(unless_failed(rollouts(policy, self.held_out, episodes, VALIDATION_SEED, "agent", unknown)))
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
            **{name: self.meter.read()[name] for name in (*COSTS, *SAFETY)},
        }
        best = None if self.options.keeps == "last" else self._best()
        if best is None or (rate.value, mean_return) > (best["success"], best["return"]):
            write_atomically(self.out / "best.pt", torch_bytes({**row, "actor": actor.state_dict()}))
        curve = pd.DataFrame([*self.curve(), row]).astype(
            {"steps": int} | dict.fromkeys(("decisions", *SAFETY), "Int64")
        )
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
        graph = self.out / GRAPH
        write_atomically(graph, actor.export)
        recipe, envs, costs, plain = self.recipe, self.held_out, self.meter.read(), _plain(self.recipe)
        card = AgentCard(
            name=self.out.name,
            family=self.options.family,
            recipe=recipe.name,
            shaping_scale=recipe.shaping_scale if recipe.shaping else None,
            **{name: plain[name] for name in RECIPE_ON_CARD},
            filter=recipe.filter_options,
            lineage=self._lineage,
            tuning=tuning_before(recipe, self.seed, self.out),
            interface=envs.task.interface,
            observation_shape=shapes(envs.single_observation_space),
            action_shape=list(envs.single_action_space.shape or ()),
            memory={name: list(shape) for name, shape in actor.memory.items()},
            training_steps=steps,
            best_after=best["steps"],
            training_minutes=round(costs["seconds"] / 60, 2),
            **{name: costs[name] for name in (*COUNTS, *SAFETY, "processor_seconds")},
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
        return self.recipe.at_share(steps / self.options.steps)

    def _make_envs(self, recipe: Recipe, count: int) -> gymnasium.vector.VectorEnv[Any, Any, Any]:
        options = self.options
        rewards = {"reward_scale": getattr(options, "reward_scale", 1.0), "reward_weights": recipe.reward_weights}
        env_options = recipe.options_in_training | rewards
        envs: gymnasium.vector.VectorEnv[Any, Any, Any] = make_worlds(
            recipe.env, count, env_options, autoreset_mode="same_step"
        )
        if recipe.shaping is not None:
            envs = Shaped(envs, recipe.shaping, gamma=options.gamma, scale=recipe.shaping_scale)
        return envs if recipe.filter_options is None else FilteredWorlds(envs, **recipe.filter_options)

    def _as_played(self, actor: Actor) -> Policy:
        """Return the actor, behind the safety filter if it acts behind one."""
        chosen = self.recipe.filter_options
        return actor if chosen is None else Filtered(actor, SafetyFilter(self.held_out, "filter", chosen))

    def _settings(self) -> dict[str, Any]:
        settings = {FORMAT: SETTINGS_FORMAT, **_plain(self.recipe), "seed": self.seed}
        settings["options"] = dataclasses.asdict(self.options)
        del settings["seeds"], settings["tune"], settings["tuned"]
        return settings | checksums(self.recipe.env, self.held_out, self.recipe.env_options)

    def _check_folder(self, resume: bool) -> None:
        """Check that the folder is unused, or holds the training to resume; only `steps` may differ."""
        record = self.out / SETTINGS
        existing = next(path for path in (self.out, *self.out.absolute().parents) if path.exists())
        if not (existing.is_dir() and os.access(existing, os.W_OK)):
            raise ConfigurationError(
                f"the training cannot be written to {self.out}: {existing} is not a folder that can be written to"
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
            self.out / CARD,
            self.recipe.env,
            episodes=self.options.evaluation_episodes,
            seed=DEVELOPMENT_SEED,
            worlds=64,
            env_options=self.recipe.env_options,
            lower_bound_steps=False,
        )
        return evaluation_of(episodes, DEVELOPMENT_SEED)

    def _write(self, card: AgentCard) -> None:
        write_atomically(self.out / CARD, card.model_dump_json(indent=2) + "\n")


def bar_fits(progress: bool) -> bool:
    """Return whether to show a requested progress bar: in a terminal only, since it would flood a log file."""
    return progress and sys.stdout.isatty() and sys.stderr.isatty()


def _check_same_interface(trained: Any, judged: EpisodeVectorEnv, view: View) -> None:
    """Raise `ConfigurationError` if agents see or command the robot in training otherwise than in evaluations.

    If the view prepares observations, these are what has to be alike.
    """
    first, second = (
        (
            {name: value for name, value in envs.task.interface.items() if name != "observation" or not view.prepare},
            shapes(view.prepared(envs.single_observation_space)),
            envs.single_action_space,
        )
        for envs in (trained.unwrapped, judged)
    )
    if first != second:
        raise ConfigurationError(
            "training_options must not change what the agent sees or how it acts: that belongs in env_options"
        )


def _check_states(stages: Sequence[Any]) -> None:
    """Raise `ConfigurationError` if the states that a critic sees differ between stages."""
    first, *rest = (envs.unwrapped.task.state_space for envs in stages)
    if any(space != first for space in rest):
        raise ConfigurationError("a privileged critic sees the state, whose space no stage of a curriculum may change")


def _plain(recipe: Recipe) -> dict[str, Any]:
    """Return the recipe as JSON values."""
    return recipe.model_dump(mode="json", fallback=str)


def _check_same(record: Path, settings: dict[str, Any]) -> None:
    if not record.exists():
        raise ConfigurationError(f"there is no training to resume in {record.parent}")
    try:
        values = json.loads(record.read_text())
        check_format(values, SETTINGS_FORMAT)
        recorded = _flat(values)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigurationError(f"{record} cannot be read, or is damaged ({error}): choose another folder") from error
    for key, value in _flat(settings).items():
        if recorded.get(key) != value and key != "steps":
            raise ConfigurationError(
                f"the training in {record.parent} was started with {key} {recorded.get(key)!r}, not {value!r}"
            )


def _flat(settings: dict[str, Any]) -> dict[str, Any]:
    return {**settings, **settings["options"], "options": None}
