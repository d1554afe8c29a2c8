"""Proximal policy optimisation (Schulman et al. 2017), by Stable-Baselines3, on hundreds of batched worlds.

`armctl train ppo --env armctl/ArmReach-v0` comes here. The trained agent is an ONNX graph and a JSON card.
"""

import dataclasses
import json
import logging
import time
import warnings
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from armctl.rl import bridge, reach
from armctl.rl.recipe import PpoOptions, Recipe
from armctl.rl.vector import StableBaselinesVectorEnv, tensors
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.torch_layers import CombinedExtractor, FlattenExtractor

from armctl.agents import INPUT, OUTPUT, AgentCard, Evaluation, inputs, sha256, shapes
from armctl.envs import TaskVectorEnv
from armctl.errors import ConfigurationError, unknown_name
from armctl.evaluation import evaluate
from armctl.evaluation.report import versions
from armctl.evaluation.statistics import success_rate

TRAINING_SEEDS = 10**9
"""Training seed k plays the seeds from (k + 1) * 10^9 on: whatever is evaluated on smaller seeds is held out."""
RECIPES = {
    "armctl/ArmReach-v0": reach.RECIPE,
    "armctl/BridgeCross-v0": bridge.RECIPE,
    "armctl/BridgeCrossMoving-v0": bridge.RECIPE,
}


def train(
    env: str = "armctl/ArmReach-v0",
    *,
    out: Path,
    steps: int | None = None,
    seed: int = 0,
    resume: bool = False,
    env_options: Mapping[str, Any] | None = None,
    options: PpoOptions | None = None,
    progress: bool = True,
) -> AgentCard:
    """Train an agent, and write `out/agent.onnx` and `out/agent.json`, with logs and checkpoints beside them.

    An interrupt (Ctrl-C) leaves a checkpoint; `resume=True` goes on from the newest one in `out`, which must be of your
    own making: unlike agents, Stable-Baselines3's checkpoints are pickles.

    Raises `ConfigurationError` for an environment without a recipe, or a folder that another training has used.
    """
    if env not in RECIPES:
        raise unknown_name("environment with a PPO recipe", env, RECIPES)
    if not 0 <= seed < 2**32:
        raise ConfigurationError(f"a training seed is a whole number from 0 to {2**32 - 1}, not {seed}")
    recipe = RECIPES[env]
    options = options or recipe.options
    if steps is not None:
        options = dataclasses.replace(options, steps=steps)
    shaped = recipe.shaped if options.shaped else {}
    worlds = gymnasium.make_vec(
        env, num_envs=options.worlds, autoreset_mode="same_step", **{**shaped, **(env_options or {})}
    )
    assert isinstance(worlds, TaskVectorEnv)
    settings: dict[str, Any] = {
        "env": env,
        "env_options": {name: str(value) for name, value in (env_options or {}).items()},
        "seed": seed,
        "options": dataclasses.asdict(options),
    }
    _prepare(out, settings, resume)
    scale = recipe.action_scale(worlds, options)
    venv = StableBaselinesVectorEnv(worlds, scale, options.reward_scale)
    resumed = _newest_checkpoint(out, venv) if resume else None
    model = resumed or _new_model(venv, recipe, options, seed)
    checkpoints = Checkpoints(out, options.checkpoint_every)
    # A resumed run plays on in other episodes than those it has seen.
    venv.seed((seed + 1) * TRAINING_SEEDS + model.num_timesteps)
    model.set_logger(configure(str(out / "tensorboard"), ["tensorboard"]))
    try:
        remaining = options.steps - model.num_timesteps
        if remaining > 0:
            model.learn(remaining, callback=checkpoints, reset_num_timesteps=False, progress_bar=progress)
    finally:
        checkpoints.save(model)
        venv.close()
    export(model, scale, out / "agent.onnx")
    card = AgentCard(
        name=out.name,
        learner="ppo",
        env=env,
        env_options=settings["env_options"],
        interface=worlds.task.interface,
        observation_shape=shapes(worlds.single_observation_space),
        action_shape=list(worlds.single_action_space.shape or ()),
        training_steps=model.num_timesteps,
        training_minutes=round(checkpoints.seconds / 60, 2),
        training_seed=seed,
        learner_options=settings["options"],
        versions=versions() | {name: version(name) for name in ("stable-baselines3", "torch", "onnx")},
        sha256=sha256(out / "agent.onnx"),
    )
    _write(card, out)
    card.evaluation = _evaluation(out / "agent.json", env, env_options, options.evaluation_episodes)
    _write(card, out)
    return card


class Checkpoints(BaseCallback):
    """Saves the model and the seconds spent on it, so that neither is lost however the training ends."""

    def __init__(self, out: Path, every: int) -> None:
        super().__init__()
        self._folder, self._clock, self._every = out / "checkpoints", out / "clock.json", every
        self._before = json.loads(self._clock.read_text())["seconds"] if self._clock.exists() else 0.0
        self._start = time.perf_counter()
        self._last = 0

    @property
    def seconds(self) -> float:
        """Since training began, over all resumptions."""
        return float(self._before + time.perf_counter() - self._start)

    def save(self, model: PPO) -> None:
        """Write a checkpoint, which is whole or not there."""
        unfinished = self._folder / "unfinished.zip"
        model.save(unfinished)
        unfinished.replace(self._folder / f"ppo_{model.num_timesteps}_steps.zip")
        self._clock.write_text(json.dumps({"seconds": self.seconds}))

    def _on_training_start(self) -> None:
        self._last = self.num_timesteps

    def _on_rollout_start(self) -> None:
        if self.num_timesteps - self._last >= self._every:
            self._last = self.num_timesteps
            self.save(self.model)

    def _on_step(self) -> bool:
        return True


class _Deterministic(torch.nn.Module):
    """What is exported: features, network and action scale in one graph, with an input for each observed array."""

    def __init__(self, model: PPO, scale: torch.nn.Module, names: list[str]) -> None:
        super().__init__()
        self.policy, self.scale, self.names = model.policy, scale, names

    def forward(self, *inputs: torch.Tensor) -> torch.Tensor:
        observation: Any = inputs[0] if self.names == [INPUT] else dict(zip(self.names, inputs, strict=True))
        features = self.policy.extract_features(observation, self.policy.pi_features_extractor)
        actions = self.policy.action_net(self.policy.mlp_extractor.forward_actor(features))
        return self.scale(observation, actions)


def export(model: PPO, scale: torch.nn.Module, path: Path) -> None:
    """Write the policy's mean action as an ONNX graph."""
    observed = model.observation_space
    example = tensors(
        {name: np.zeros((2, *(space.shape or ())), space.dtype) for name, space in inputs(observed).items()}
    )
    module = _Deterministic(model, scale, list(example)).eval()
    batch = torch.export.Dim("worlds", min=1)
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it warns of a torchvision that nobody needs
    with warnings.catch_warnings(action="ignore"):
        program = torch.onnx.export(
            module,
            tuple(example.values()),
            input_names=list(example),
            output_names=[OUTPUT],
            dynamic_shapes=(tuple({0: batch} for _ in example),),
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    graph = program.model_proto
    for node in (*graph.graph.node, *(node for function in graph.functions for node in function.node)):
        node.ClearField("metadata_props")  # stack traces, with the paths of whoever trained it
        node.ClearField("doc_string")
    path.write_bytes(graph.SerializeToString())


def _new_model(venv: StableBaselinesVectorEnv, recipe: Recipe, options: PpoOptions, seed: int) -> PPO:
    several = isinstance(venv.observation_space, gymnasium.spaces.Dict)
    bare = CombinedExtractor if several else FlattenExtractor
    return PPO(
        "MultiInputPolicy" if several else "MlpPolicy",
        venv,
        n_steps=options.rollout_length,
        batch_size=options.batch_size,
        n_epochs=options.epochs,
        learning_rate=_falling(options.learning_rate),
        gamma=options.gamma,
        gae_lambda=options.gae_lambda,
        clip_range=options.clip_range,
        ent_coef=options.entropy,
        policy_kwargs={
            "features_extractor_class": recipe.features if options.features else bare,
            "net_arch": [options.hidden_units] * 2,
            "activation_fn": torch.nn.ELU,
            "log_std_init": options.initial_log_std,
        },
        seed=seed,
        device="cpu",
    )


def _falling(initial: float) -> Any:
    def rate(progress_remaining: float) -> float:
        return initial * max(progress_remaining, 0.05)

    return rate


def _prepare(out: Path, settings: dict[str, Any], resume: bool) -> None:
    """Make the folder, or check that the training in it is the one to go on with; more steps are welcome."""
    record = out / "settings.json"
    if not resume:
        if record.exists():
            raise ConfigurationError(f"{out} holds a training already: resume it (--resume), or choose another folder")
        try:
            (out / "checkpoints").mkdir(parents=True, exist_ok=True)
            record.write_text(json.dumps(settings, indent=2))
        except OSError as error:
            raise ConfigurationError(f"the training cannot be written to {out}: {error.strerror}") from error
        return
    if not record.exists():
        raise ConfigurationError(f"there is no training to resume in {out}")
    before = _flat(json.loads(record.read_text()))
    for key, value in _flat(settings).items():
        if before.get(key) != value and key != "steps":
            raise ConfigurationError(f"the training in {out} was started with {key} {before.get(key)!r}, not {value!r}")
    record.write_text(json.dumps(settings, indent=2))


def _flat(settings: dict[str, Any]) -> dict[str, Any]:
    return {**settings, **settings["options"], "options": None}


def _newest_checkpoint(out: Path, venv: StableBaselinesVectorEnv) -> PPO | None:
    found = (out / "checkpoints").glob("ppo_*_steps.zip")
    newest = max(found, key=lambda path: int(path.stem.split("_")[1]), default=None)
    return None if newest is None else PPO.load(newest, env=venv, device="cpu")


def _evaluation(card: Path, env: str, env_options: Mapping[str, Any] | None, episodes: int) -> Evaluation:
    results = evaluate(str(card), env, episodes=episodes, seed=0, worlds=64, env_options=env_options)
    rate = success_rate(results.success.to_numpy(bool))
    assert rate is not None
    assert rate.low is not None
    assert rate.high is not None
    steps = results.length[results.success]
    return Evaluation(
        episodes=episodes,
        seed=0,
        success_rate=rate.value,
        success_interval=(rate.low, rate.high),
        mean_return=float(results["return"].mean()),
        mean_steps_to_goal=float(steps.mean()) if len(steps) else None,
    )


def _write(card: AgentCard, out: Path) -> None:
    (out / "agent.json").write_text(card.model_dump_json(indent=2) + "\n")
