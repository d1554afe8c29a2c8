"""The end-effector of a file that has several candidates, by the names that files usually give it."""

import re
from collections.abc import Iterable

USUAL_NAMES = tuple(
    re.compile(f"(.*[_/])?({name})", re.IGNORECASE)
    for name in (
        "tool0|attachment_site",
        "tcp|tool_center_point",
        "ee|eef|ee_link|ee_frame|ee_site|end_effector(_link)?|grip_site",
        "tool|tool_link|tool_frame",
        "flange|flange_link",
        "ee_gripper_link|gripper_frame_link|grasp_link|pinch_site",
    )
)
"""Names of end-effectors, in order of preference."""


def usual_tips(links: Iterable[str]) -> list[str]:
    """Return those links that are called most like an end-effector: several, if they are called alike."""
    names = list(links)
    groups = ([name for name in names if usual.fullmatch(name)] for usual in USUAL_NAMES)
    return next((group for group in groups if group), [])
