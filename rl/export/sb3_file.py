"""Reads models of Stable-Baselines3 and sb3-contrib, and the statistics of `VecNormalize`.

A model is a zip file: JSON, some of whose values are pickles, and weights. What does not need the pickles is read
without them, since a pickle can run any code; `load` and `load_normalisation` do run it.
"""

import base64
import inspect
import json
import pickle
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gymnasium import spaces
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.preprocessing import is_image_space, is_image_space_channels_first
from stable_baselines3.common.vec_env import VecNormalize, VecTransposeImage

from armctl.core.errors import AgentFileError, unknown_name
from armctl.core.files import bounded_bytes, opened_regular
from armctl.core.registration import importable_from

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {
    "a2c": A2C,
    "ddpg": DDPG,
    "dqn": DQN,
    "ppo": PPO,
    "recurrent_ppo": RecurrentPPO,
    "sac": SAC,
    "td3": TD3,
    "tqc": TQC,
}
HOMES = {
    "sb3_contrib.common.recurrent": "recurrent_ppo", "sb3_contrib.common.maskable": "maskable_ppo",
    "sb3_contrib.tqc": "tqc", "sb3_contrib.qrdqn": "qrdqn", "sb3_contrib.crossq": "crossq", "sb3_contrib.ars": "ars",
    "stable_baselines3.dqn": "dqn", "stable_baselines3.sac": "sac",
}  # fmt: skip
"""Algorithms by the module of their policies' class. Others share theirs, or have a policy of one's own."""
MARKS = {
    "cg_damping": "trpo", "n_quantiles": "qrdqn", "n_delta": "ars", "top_quantiles_to_drop_per_net": "tqc",
    "target_policy_noise": "td3", "policy_delay": "crossq", "target_entropy": "sac", "exploration_rate": "dqn",
    "clip_range": "ppo", "gae_lambda": "a2c",
}  # fmt: skip
"""Values that only one algorithm of Stable-Baselines3 and sb3-contrib has, or only those above it."""
SPACES = ("observation_space", "action_space")
VERSION = "_stable_baselines3_version"
"""Name of the file in the zip file that holds the version that wrote it."""
LARGEST_DATA, LARGEST_VERSION, LARGEST_WEIGHTS = 2**26, 2**20, 2**31
"""Bytes in the zip file, unpacked: of its JSON, of the version that wrote it, and of all of its weights."""
NOT_OPTIONS = {"self", "policy", "env", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model"}
"""Arguments of an algorithm that its training does not depend on, or that a card has elsewhere."""
FOR_TRAINING_ONLY = {
    "learning_rate": 0.0,
    "lr_schedule": lambda remaining: 0.0,
    "clip_range": 0.2,
    "clip_range_vf": None,
    "exploration_schedule": lambda remaining: 0.0,
    "action_noise": None,
    "replay_buffer_class": None,
    "replay_buffer_kwargs": {},
    "rollout_buffer_class": None,
    "rollout_buffer_kwargs": {},
    "optimize_memory_usage": False,
    "ep_info_buffer": None,
    "ep_success_buffer": None,
    "_last_obs": None,
    "_last_episode_starts": None,
    "_last_original_obs": None,
    "buffer_size": 1,
    "n_steps": 1,
    "n_envs": 1,
}
"""Replaced when a model is loaded: no gigabytes for a buffer, and fewer pickles that another version cannot read."""


@dataclass(frozen=True)
class ModelFile:
    """A model's file, without its pickles."""

    path: Path
    values: Mapping[str, Any]
    """The JSON values; pickled ones are dicts with the key `:serialized:`."""
    saved_with: str
    """Library and version that wrote it."""

    def algorithm(self) -> str:
        """Return the algorithm's name in `ALGORITHMS`, by its policy's class or the values that it saves.

        Raises `AgentFileError`, also for an algorithm that there is not.
        """
        policy = self.values["policy_class"]
        home = str(policy.get("__module__")) if isinstance(policy, dict) else ""
        by_home = (name for module, name in HOMES.items() if home.startswith(f"{module}."))
        algorithm = next(by_home, None) or next((name for mark, name in MARKS.items() if mark in self.values), None)
        if algorithm not in ALGORITHMS:
            raise AgentFileError(
                f"{self.path} is a model of {algorithm}; armctl exports those of {', '.join(sorted(ALGORITHMS))}"
                if algorithm
                else f"{self.path} does not tell its algorithm: name it, --algorithm {'|'.join(sorted(ALGORITHMS))}"
            )
        # DDPG is TD3 without noise on the target's actions.
        return "ddpg" if algorithm == "td3" and self.values.get("target_noise_clip") == 0 else algorithm

    def options(self, algorithm: str) -> dict[str, Any]:
        """Return the algorithm's options, as JSON values; of pickled ones, the text beside the pickle, if any."""
        names = inspect.signature(ALGORITHMS[algorithm].__init__).parameters
        options = {name: self.values[name] for name in names if name in self.values and name not in NOT_OPTIONS}
        return {name: readable for name, value in options.items() if (readable := _readable(value)) != {}}


def read(path: Path) -> ModelFile:
    """Read a model's file, but none of its pickles. Raises `AgentFileError`, also if much is packed in it."""
    try:
        with opened_regular(path) as file, zipfile.ZipFile(file) as archive:
            names = archive.namelist()
            values = json.loads(_unpacked(archive, "data", LARGEST_DATA)) if "data" in names else None
            version = "of unknown version"
            if VERSION in names:
                version = _unpacked(archive, VERSION, LARGEST_VERSION).decode().strip()
            weights = sum(entry.file_size for entry in archive.infolist() if entry.filename.endswith(".pth"))
            if weights > LARGEST_WEIGHTS:
                raise ValueError(
                    f"its weights have {weights:,} bytes, more than the {LARGEST_WEIGHTS:,} that armctl reads"
                )
    except OSError as error:
        raise AgentFileError(f"the model {path} cannot be read: {error.strerror}") from error
    except Exception as error:  # what a corrupt zip or JSON may raise
        raise AgentFileError(f"{path} is not a zip file of Stable-Baselines3, or is damaged: {error}") from error
    if not isinstance(values, dict) or "policy_class" not in values or "policy.pth" not in names:
        raise AgentFileError(f"{path} is not a model of Stable-Baselines3: save one with model.save({path.name!r})")
    return ModelFile(path, values, f"stable-baselines3 {version}")


def _unpacked(archive: zipfile.ZipFile, name: str, largest: int) -> bytes:
    entry = archive.getinfo(name)
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # others are unpacked as a whole
        raise ValueError(f"{name!r} in it is compressed otherwise than Stable-Baselines3 does")
    if entry.file_size > largest:
        raise ValueError(f"{name!r} in it has {entry.file_size:,} bytes, more than the {largest:,} that armctl reads")
    with archive.open(entry) as file:
        return file.read(entry.file_size)  # with a number, since without one more is unpacked than the entry claims


def load(file: ModelFile, algorithm: str, *env_spaces: spaces.Space[Any]) -> BaseAlgorithm:
    """Load the model, for acting only. Runs what is pickled in its file. Raises `AgentFileError`.

    The environment's spaces of observations and actions stand in for those that cannot be read, such as of gym.
    """
    if algorithm not in ALGORITHMS:
        raise unknown_name("algorithm", algorithm, ALGORITHMS)
    try:
        with importable_from(Path.cwd()):  # a network of one's own
            replaced = {
                name: _as_trained(space)
                for name, space in zip(SPACES, env_spaces, strict=True)
                if not _is_readable_space(file.values.get(name))
            }
            return ALGORITHMS[algorithm].load(file.path, device="cpu", custom_objects=FOR_TRAINING_ONLY | replaced)
    except Exception as error:  # what a model of another algorithm or version, or somebody else's code, may raise
        raise AgentFileError(f"{file.path} cannot be loaded as a model of {algorithm}: {in_a_line(error)}") from error


def _is_readable_space(value: Any) -> bool:
    try:
        return isinstance(pickle.loads(base64.b64decode(value[":serialized:"])), spaces.Space)
    except Exception:  # a pickle may raise anything
        return False


def _as_trained(space: spaces.Space[Any]) -> spaces.Space[Any]:
    """Return a space as Stable-Baselines3 shows it to a network: images with their channels first."""
    if isinstance(space, spaces.Dict):
        return spaces.Dict({name: _as_trained(part) for name, part in space.items()})
    if isinstance(space, spaces.Box) and is_image_space(space) and not is_image_space_channels_first(space):
        return VecTransposeImage.transpose_space(space)
    return space


def normalisation_beside(model: Path) -> Path | None:
    """Return the file of `VecNormalize`'s statistics that belongs to a model's; None: there is none.

    It lies beside the model, as `vecnormalize.pkl` or `vec_normalize.pkl`, or as Stable-Baselines3's
    `CheckpointCallback` names it; or in the folder of the model's name, as RL Zoo writes it.
    """
    checkpoint = re.sub(r"_(\d+)_steps$", r"_vecnormalize_\1_steps", model.stem)
    candidates = [model.with_name(f"{checkpoint}.pkl")] if checkpoint != model.stem else []
    for name in ("vecnormalize.pkl", "vec_normalize.pkl"):
        candidates += [model.with_name(name), model.with_suffix("") / name]
    return next((path for path in candidates if path.is_file()), None)


def load_normalisation(path: Path) -> VecNormalize:
    """Load the statistics of observations. Runs what is pickled in their file. Raises `AgentFileError`."""
    try:
        loaded = pickle.loads(bounded_bytes(path, LARGEST_WEIGHTS))
    except OSError as error:
        raise AgentFileError(f"the statistics {path} cannot be read: {error.strerror}") from error
    except Exception as error:  # a pickle may raise anything
        raise AgentFileError(f"the statistics {path} cannot be loaded: {in_a_line(error)}") from error
    if not isinstance(loaded, VecNormalize):
        raise AgentFileError(
            f"{path} holds a {type(loaded).__name__}, not a VecNormalize: write it with its save(path)"
        )
    return loaded


def _readable(value: Any) -> Any:
    if not (isinstance(value, dict) and ":serialized:" in value):
        return value
    if value[":type:"] in ("<class 'type'>", "<class 'abc.ABCMeta'>"):
        return {}
    return {name: part for name, part in value.items() if name not in (":type:", ":serialized:")}


def in_a_line(error: Exception) -> str:
    """Return an error as one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
