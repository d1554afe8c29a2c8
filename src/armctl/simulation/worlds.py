"""Paths of armctl's own MJCF worlds and robots, and models that are compiled once."""

import copy
import functools
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import ParamSpec

import mujoco

P = ParamSpec("P")


def world_path(name: str) -> Path:
    """Return the path of one of armctl's own MJCF models, such as `arm_reach`."""
    return Path(str(resources.files("armctl.models") / f"{name}.xml"))


def compiled_once(build: Callable[P, mujoco.MjModel]) -> Callable[P, mujoco.MjModel]:
    """Return a function that returns copies of what `build` returns, which it calls once for the same arguments."""
    cached_build: Callable[P, mujoco.MjModel] = functools.lru_cache(maxsize=8)(build)  # type: ignore[assignment]

    @functools.wraps(build)
    def build_copy(*args: P.args, **kwargs: P.kwargs) -> mujoco.MjModel:
        return copy.copy(cached_build(*args, **kwargs))

    return build_copy
