"""armctl: planners and controllers against learned agents, on the same robot episodes.

Importing it registers the environments with Gymnasium. The library's functions load on first use.
"""

import ctypes
import importlib
import os
import sys
from typing import Any

import gymnasium

__version__ = "0.1.0"


def _choose_graphics() -> None:
    """Let MuJoCo, which picks its OpenGL once, when it is imported, render without a screen where there is none."""
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform != "linux" or screen or "MUJOCO_GL" in os.environ:
        return
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError:
        return  # with MUJOCO_GL=egl and no such library, MuJoCo itself could not be imported
    os.environ["MUJOCO_GL"] = "egl"


_choose_graphics()

for _name, _steps in (("ArmReach", 100), ("ArmReachMoving", 300), ("ArmReachObstacles", 200)):
    gymnasium.register(
        id=f"armctl/{_name}-v0",
        entry_point=f"armctl.envs:{_name}Env",
        vector_entry_point=f"armctl.envs:{_name}VectorEnv",
        max_episode_steps=_steps,
    )
for _id, _steps, _options in (
    ("armctl/BridgeCross-v0", 300, {}),
    ("armctl/BridgeCrossMoving-v0", 600, {"blocks": 3, "walkers": 3}),
):
    gymnasium.register(
        id=_id,
        entry_point="armctl.envs:BridgeCrossEnv",
        vector_entry_point="armctl.envs:BridgeCrossVectorEnv",
        max_episode_steps=_steps,
        kwargs=_options,
    )

DEFAULT_ENV = "armctl/ArmReach-v0"
DEFAULT_POLICIES = {
    "armctl/ArmReach-v0": ("reach_ik", "reach_ppo", "random"),
    "armctl/ArmReachMoving-v0": ("reach_mpc", "reach_ik", "moving_ppo", "random"),
    "armctl/ArmReachObstacles-v0": ("reach_ompl", "reach_ik", "obstacles_dagger", "random"),
    "armctl/BridgeCross-v0": ("bridge_ompl", "bridge_ppo", "random"),
    "armctl/BridgeCrossMoving-v0": ("bridge_ompl", "bridge_mpc", "bridge_moving_ppo", "random"),
}

_HOMES = {
    "load_arm": "armctl.assets",
    "ArmModel": "armctl.kinematics",
    "Ik": "armctl.kinematics",
    "make_policy": "armctl.policies",
    "Policy": "armctl.policies",
    "evaluate": "armctl.evaluation",
    "compare": "armctl.evaluation",
    "sweep": "armctl.evaluation",
}
__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'armctl' has no attribute {name!r}; it has {', '.join(_HOMES)}")
    return getattr(importlib.import_module(_HOMES[name]), name)
