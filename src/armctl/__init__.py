"""armctl: planners and controllers against learned agents, on the same robot episodes.

Importing it registers the environments with Gymnasium, as soon as that is imported too: controllers of a robot load
without it. The library's functions load on first use.
"""

import contextlib
import ctypes
import functools
import importlib
import importlib.abc
import importlib.metadata
import importlib.util
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

__version__ = "0.1.0"

DISTRIBUTION = "armctl-suite"
"""The name on the package index. `armctl` there is another project, with the same import name and command."""

DEFAULT_ENV = "armctl/ArmReach-v0"

_HOMES = {
    "load_arm": "armctl.robot_description",
    "ArmModel": "armctl.kinematics",
    "Ik": "armctl.kinematics",
    "Task": "armctl.tasks",
    "register": "armctl.core.registration",
    "make_policy": "armctl.policies",
    "Policy": "armctl.policies",
    "sees": "armctl.policies",
    "interface": "armctl.policies",
    "evaluate": "armctl.rollout",
    "compare": "armctl.study",
    "sweep": "armctl.study",
    "suite": "armctl.study",
    "worst_case": "armctl.study",
    "judge": "armctl.judging",
}
__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'armctl' has no attribute {name!r}; it has {', '.join(_HOMES)}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def _choose_graphics() -> None:
    """Choose EGL on a machine without a screen. MuJoCo reads the choice once, when it is imported."""
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform != "linux" or screen or "MUJOCO_GL" in os.environ:
        return
    if _is_installed("libEGL.so.1") and (_is_installed("libOpenGL.so.0") or _is_installed("libGL.so.1")):
        os.environ["MUJOCO_GL"] = "egl"  # without these libraries, MuJoCo could then not be imported


def _is_installed(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _warn_of_namesake() -> None:
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        namesake = importlib.metadata.version("armctl")
        warnings.warn(
            f"the distribution armctl {namesake}, another project with the same import name, is installed beside "
            f"{DISTRIBUTION}: pip uninstall armctl, then install {DISTRIBUTION} again",
            stacklevel=2,
        )


def _register() -> None:
    importlib.import_module("armctl.core.registration").register_installed()


class _AfterGymnasium(importlib.abc.MetaPathFinder):
    """Registers the environments right after Gymnasium has been imported."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Return Gymnasium's spec with a loader that registers, too; None for any other module."""
        if name != "gymnasium":
            return None
        others = (finder for finder in sys.meta_path if finder is not self)
        spec = next(filter(None, (finder.find_spec(name, path, target) for finder in others)), None)
        if spec is not None and spec.loader is not None:
            spec.loader.exec_module = functools.partial(self._load, spec.loader.exec_module)  # type: ignore[method-assign]
        return spec

    def _load(self, load: Callable[[ModuleType], None], module: ModuleType) -> None:
        load(module)
        if self in sys.meta_path:
            sys.meta_path.remove(self)
            _register()


_choose_graphics()
_warn_of_namesake()
if "gymnasium" in sys.modules:
    _register()
else:
    sys.meta_path.insert(0, _AfterGymnasium())
