"""What decides a result besides what was asked for: the versions of packages, and the machine."""

import os
import platform
from importlib.metadata import version
from typing import Any


def versions() -> dict[str, str]:
    """Versions of what decides a result."""
    packages = (
        "armctl",
        "mujoco",
        "pin",
        "eaik",
        "ompl",
        "gymnasium",
        "numpy",
        "scipy",
        "onnxruntime",
        "example-robot-data",
    )
    return {"python": platform.python_version()} | {package: version(package) for package in packages}


def machine() -> dict[str, Any]:
    """The machine, as far as decision times depend on it."""
    return {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()}
