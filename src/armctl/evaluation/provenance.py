"""Provenance of results: versions of packages, and the machine."""

import os
import platform
from importlib.metadata import version
from typing import Any

from armctl import DISTRIBUTION


def versions() -> dict[str, str]:
    """Versions of Python and of the packages on which results depend."""
    packages = (
        DISTRIBUTION,
        "mujoco",
        "pin",
        "casadi",
        "eaik",
        "ompl",
        "osqp",
        "ruckig",
        "gymnasium",
        "numpy",
        "scipy",
        "onnxruntime",
        "example-robot-data",
    )
    return {"python": platform.python_version()} | {package: version(package) for package in packages}


def machine() -> dict[str, Any]:
    """Properties of the machine on which decision times depend."""
    return {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()}
