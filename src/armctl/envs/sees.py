"""Privileges: what a policy may see of its environment."""

from collections.abc import Mapping
from typing import Literal

Sees = Literal["observation", "model", "map", "state"]
SEES: Mapping[str, str] = {
    "observation": "observation",
    "model": "observation + robot model",
    "map": "map",
    "state": "true state",
}
"""Privileges that a policy can declare, from the least to the most, and their text in tables.
Each includes those before it."""
