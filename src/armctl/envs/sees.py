"""Privileges: what a policy may see of its environment."""

from collections.abc import Mapping, Sequence
from typing import Literal

from armctl.core.foresight import FORESIGHT

Sees = Literal["observation", "model", "map", "state"]
SEES: Mapping[str, str] = {
    "observation": "observation",
    "model": "observation + robot model",
    "map": "map",
    "state": "true state",
}
"""Privileges that a policy can declare, from the least to the most, and their text in tables.
Each includes those before it."""


def privilege_in_words(sees: str, foresight: Sequence[str] = ()) -> str:
    """Return what a policy sees and foresees, as tables write it; of an unknown privilege, its name."""
    return " + ".join([SEES.get(sees, sees), *(FORESIGHT.get(name, name) for name in foresight)])


def privileges(by_name: Mapping[str, str]) -> str:
    """Return a sentence about privileges, from `privilege_in_words` by policy; empty if they are all the same."""
    if len(set(by_name.values())) < 2:
        return ""
    parts = (f"{name} ({privilege})" for name, privilege in by_name.items())
    return f"Their privileges differ: {', '.join(parts)}."


def interfaces_in_words(by_name: Mapping[str, Mapping[str, str]]) -> str:
    """Return a sentence about interfaces, from the values of options by policy; empty if they do not differ.

    Where nobody has told a policy's, nothing is said.
    """
    names = dict.fromkeys(name for values in by_name.values() for name in values)
    differing = [name for name in names if len({values.get(name) for values in by_name.values()}) > 1]
    if not differing or not all(by_name.values()):
        return ""
    texts = (
        f"{policy} ({', '.join(f'{name} {values[name]}' for name in differing if name in values)})"
        for policy, values in by_name.items()
    )
    return f"Their interfaces differ: {', '.join(texts)}."


def isolation(by_name: Mapping[str, bool]) -> str:
    """Return a sentence about which policies were isolated; empty if none was."""
    apart, others = ([name for name, is_apart in by_name.items() if is_apart == side] for side in (True, False))
    if not apart:
        return ""
    but = f", and not {', '.join(others)}" if others else ""
    return f"Isolated, each in a process of its own that got observations only: {', '.join(apart)}{but}."
