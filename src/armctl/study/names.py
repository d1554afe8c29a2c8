"""Names in a study: of its kind, its tasks and its cells."""

from armctl.core.files import checked_name
from armctl.core.registration import short_name

COMPARISON, SWEEP, SUITE, WORST_CASE = "comparison", "sweep", "suite", "worst case"
"""Kinds of studies: one cell; one task's cells; the cells of several tasks; a cell for each policy."""
FROM_UNDISTURBED = "the undisturbed comparison"
"""Source of a sweep's decision times, unless a folder has them."""


def setting_name(disturbance: str, level: float) -> str:
    """Return the name, or its last part, of the cell at a level."""
    return f"{disturbance}-{level}"


def task_name(env: str) -> str:
    """Return the first part of the names of a task's cells in a suite, which is also its page's name.

    Raises `ConfigurationError` for an id that no file should be called by.
    """
    return checked_name("task", short_name(env).replace("/", "_"))


def cell_name(kind: str, env: str, setting: str) -> str:
    """Return the name of a cell. Raise `ConfigurationError` for an id that no file should be called by."""
    return f"{task_name(env)}/{setting}" if kind == SUITE else setting
