"""Remarks about a comparison's episodes: doubtful certificates, and policies that may be stuck."""

import numpy as np

from armctl.envs import ERROR
from armctl.episodes.table import EpisodeTable

STUCK_PATH, STUCK_SECONDS = 0.01, 1.0
"""m and s: a policy that moves the end-effector or the rover by less than this in an episode of at least so long, and
does not win, commands next to nothing. Targets are farther than 1 cm, and even a slow motion covers that in 1 s."""


def certificate_notes(results: EpisodeTable) -> list[str]:
    """Return remarks if policies won episodes that are labelled infeasible, and if all episodes are infeasible."""
    notes = []
    if len(results) and not results.column("feasible").any():
        count = len(np.unique(results.column("episode")))
        notes.append(f"All {count} episodes are labelled infeasible: none of them counts, and nothing can be compared.")
    won = results[results.won & ~results.column("feasible")]
    if not won:
        return notes
    by = ", ".join(f"{len(table)} by {name}" for name, table in won.by_policy().items())
    episodes = len(np.unique(won.column("episode")))
    return [*notes, f"{episodes} episodes labelled infeasible were won ({by}): the certificate is too strict."]


def motion_notes(results: EpisodeTable, control_period: float | None) -> list[str]:
    """Return remarks about policies that hardly moved the robot in episodes that they did not win."""
    if control_period is None:
        return []
    length = results.column("length")
    lost = ~results.won & (results.column("outcome") != ERROR) & (length * control_period >= STUCK_SECONDS)
    stuck = results[lost & (results.column("path_length") < STUCK_PATH)]
    notes = []
    for name, episodes in results.by_policy().items():
        if count := int((stuck.column("policy") == name).sum()):
            notes.append(
                f"{name} hardly moved in {count} of {len(episodes)} episodes (a path below {100 * STUCK_PATH:g} cm in "
                f"at least {STUCK_SECONDS:g} s, and no success): it may be stuck."
            )
    return notes
