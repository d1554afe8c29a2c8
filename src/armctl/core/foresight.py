"""Foresight: what a policy may know of the future, which is feed-forward or preview information.

Classical and learned controllers are compared fairly only if both have it or neither (Kunapuli et al., "Leveling the
Playing Field", RSS 2025, arXiv:2506.17832).
"""

from collections.abc import Container, Mapping
from typing import Literal

from armctl.core.errors import ConfigurationError, unknown_name

Foresight = Literal["target", "pedestrians", "disturbance", "simulator"]
FORESIGHT: Mapping[str, str] = {
    "target": "target's future",
    "pedestrians": "pedestrians' future",
    "disturbance": "disturbance's level",
    "simulator": "nominal simulator",
}
"""Foresight that a policy can declare, and its text in tables."""


def how_to_declare(sees: str, foresight: str = "") -> str:
    """Return how a policy says what it sees, and foresees."""
    more = f', foresight="{foresight}"' if foresight else ""
    return f'put @armctl.sees("{sees}"{more}) above its function or class, and every table will say it'


def check_known(foresight: str) -> None:
    """Raise `ConfigurationError` for what is not a key of `FORESIGHT`."""
    if foresight not in FORESIGHT:
        raise unknown_name("foresight", foresight, FORESIGHT)


def check_declared(foresight: str, sees: str, declared: Container[str]) -> None:
    """Raise `ConfigurationError` for foresight that a policy has not declared, or that there is not."""
    check_known(foresight)
    if foresight not in declared:
        raise ConfigurationError(
            f"the {FORESIGHT[foresight]} is only for a policy that declares to foresee it: "
            f"{how_to_declare(sees, foresight)}"
        )
