"""The features of a LeRobot dataset: keys, types, shapes and names of its numbers and images."""

from typing import Any

import gymnasium
import numpy as np

from armctl.datasets.pictures import is_image
from armctl.envs import EpisodeVectorEnv

COUNTED = {"timestamp": "float32"} | dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")
"""Features of every LeRobot dataset, with their types."""
ENDINGS = {"next.done": "bool", "next.truncated": "bool", "next.success": "bool"}
"""True at most in an episode's last frame. `next.done`: it is the last."""


def observed_parts(space: gymnasium.Space[Any]) -> dict[str, tuple[str | None, Any]]:
    """LeRobot's keys for the parts of an observation, with the part's name in it, None for a whole, and its space.

    Where there is one vector, it is the state, which LeRobot's policies look for.
    """
    parts: dict[str | None, Any] = {None: space}
    if isinstance(space, gymnasium.spaces.Dict):
        parts = dict(space.spaces.items())
    vectors = [name for name, part in parts.items() if not is_image(part)]
    keys = {}
    for name, part in parts.items():
        label = (name or "camera").replace("/", ".")
        if is_image(part):
            keys[f"observation.images.{label}"] = name, part
        else:
            keys["observation.state" if vectors == [name] else f"observation.{label}"] = name, part
    return keys


def features_of(worlds: EpisodeVectorEnv, fps: float) -> dict[str, Any]:
    """LeRobot's description of each feature, by key, as JSON values."""
    features = {}
    for key, (name, space) in observed_parts(worlds.single_observation_space).items():
        if is_image(space):
            height, width = (side + side % 2 for side in space.shape[:2])
            features[key] = _video(height, width, fps)
        else:
            features[key] = _vector(space, _names_of_observation(worlds, name, int(np.prod(space.shape or (1,)))))
    taken = worlds.single_action_space
    joints = getattr(worlds.task.robot, "joints", ())
    size = int(np.prod(taken.shape or (1,)))
    features["action"] = _vector(taken, list(joints) if len(joints) == size else _numbered("action", size))
    for key, dtype in ({"next.reward": "float32"} | ENDINGS | COUNTED).items():
        features[key] = {"dtype": dtype, "shape": [1], "names": None}
    return features


def _vector(space: gymnasium.Space[Any], names: list[str]) -> dict[str, Any]:
    kind = np.dtype(space.dtype).kind
    dtype = {"f": "float32", "b": "bool"}.get(kind, "int64")
    return {"dtype": dtype, "shape": [len(names)], "names": names}


def _video(height: int, width: int, fps: float) -> dict[str, Any]:
    stream = {"height": height, "width": width, "codec": "av1", "pix_fmt": "yuv420p", "fps": fps, "channels": 3}
    return {
        "dtype": "video",
        "shape": [height, width, 3],
        "names": ["height", "width", "channels"],
        "info": {f"video.{name}": value for name, value in stream.items()}
        | {"video.is_depth_map": False, "has_audio": False},
    }


def _names_of_observation(worlds: EpisodeVectorEnv, part: str | None, size: int) -> list[str]:
    """Return a name for each number of a part of the observation: those of the task's parts, if they make it up."""
    parts = {name: values[0].size for name, values in worlds.task.observation_parts().items()}
    joints = getattr(worlds.task.robot, "joints", ())
    if sum(parts.values()) != size:
        return _numbered(part or "state", size)
    names = []
    for name, count in parts.items():
        of_joints = "joint" in name and count == len(joints)
        names += [f"{name}.{joint}" for joint in joints] if of_joints else _numbered(name, count)
    return names


def _numbered(name: str, size: int) -> list[str]:
    return [name] if size == 1 else [f"{name}.{i}" for i in range(size)]
