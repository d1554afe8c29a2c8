"""Remarks about a comparison's episodes: doubtful certificates, successes that are not clean, stuck policies."""

from collections.abc import Mapping

import numpy as np

from armctl.envs import ERROR
from armctl.episodes.table import EpisodeTable
from armctl.verdict.scores import WITHIN_RANGE, WITHIN_SPEED, clean

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


def first_step_notes(counted: Mapping[str, EpisodeTable]) -> list[str]:
    """Return a remark if every policy wins some episodes in its first control step: they may begin with a success."""
    won = [table[table.won & (table.column("length") == 1)].column("episode") for table in counted.values() if table]
    shared = set.intersection(*map(set, won)) if won else set()
    if not shared:
        return []
    count, total = len(shared), max(map(len, counted.values()))
    return [
        f"{count} of {total} episodes {'is' if count == 1 else 'are'} won by every policy in the first control step, "
        "as if it began with a success: that tells no policy from another."
    ]


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


def unclean_notes(counted: Mapping[str, EpisodeTable], torque_control: bool) -> list[str]:
    """Return a remark on each policy with successes that are not `clean`: what they touch or exceed, and by how much.

    Without `torque_control`, the drives command no speed beyond its limit: an excess is an overshoot or an impact.
    """
    drives = "" if torque_control else ", which the drives do not command"
    notes = []
    for name, episodes in counted.items():
        won = episodes[episodes.won]
        ranges, speeds = won.column("range_use"), won.column("speed_use")
        contacts = int(sum(count > 0 for count in won.column("contacts").tolist() if count is not None))
        beyond_range, beyond_speed = ranges > WITHIN_RANGE, speeds > WITHIN_SPEED
        reasons = [f"{contacts} with a forbidden contact"] if contacts else []
        if beyond_range.any():
            largest = f"up to {np.nanmax(ranges):.2f}"
            reasons.append(f"{beyond_range.sum()} beyond {WITHIN_RANGE:g} times half a joint's range ({largest})")
        if beyond_speed.any():
            largest = f"up to {np.nanmax(speeds):.2f}{drives}"
            reasons.append(f"{beyond_speed.sum()} beyond {WITHIN_SPEED:g} times a speed limit ({largest})")
        if reasons:
            unclean = len(won) - int(clean(won).sum())
            verb = "is" if unclean == 1 else "are"
            notes.append(f"{unclean} of {len(won)} successes of {name} {verb} not clean: {', '.join(reasons)}.")
    return notes
