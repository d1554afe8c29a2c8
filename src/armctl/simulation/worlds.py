"""Paths of armctl's own MJCF worlds and robots."""

from importlib import resources
from pathlib import Path


def world_path(name: str) -> Path:
    """Return the path of one of armctl's own MJCF models, such as `arm_reach`."""
    return Path(str(resources.files("armctl.models") / f"{name}.xml"))
