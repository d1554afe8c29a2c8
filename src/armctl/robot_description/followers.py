"""Joints that follow others, as a `<mimic>` of a URDF has it: the wrists that palletising arms keep level, say.

A follower has no motor: it is at `ratio` times the position of its leader, plus `offset`. The arm's joints are the
others, and the limits of leaders are such that those of their followers are kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armctl.core.arrays import Array
from armctl.robot_description.elements import Elements
from armctl.robot_description.joint_limits import FULL_TURN, stated_limits
from armctl.robot_description.xml_file import Element, short


@dataclass(frozen=True)
class Follower:
    """A joint that follows another."""

    joint: str
    leader: str
    ratio: float
    """rad of it for each rad of its leader (m, if both slide)."""
    offset: float
    """rad, or m."""
    place: int
    """Index among all joints from root to tip."""

    def ahead(self, positions: Array) -> Array:
        """Return positions of the leader for those of the follower."""
        return (positions - self.offset) / self.ratio


def followers_in(elements: Elements, chain: Sequence[Element]) -> tuple[Follower, ...]:
    """Return the followers among the joints from root to tip. Raises `ConfigurationError` if one has no leader there.

    A leader has to be of the same kind, and is no follower itself.
    """
    by_name = {joint.get("name", ""): joint for joint in chain}
    followers = []
    for place, joint in enumerate(chain):
        if (mimic := joint.find("mimic")) is None:
            continue
        name, leader = joint.get("name", ""), mimic.get("joint", "")
        owner = f"joint {short(name)} between root and tip mimics {short(leader)}"
        if leader not in by_name:
            raise elements.error(f"{owner}, which is no joint between root and tip: choose a tip before it, or fix it")
        if by_name[leader].find("mimic") is not None:
            raise elements.error(f"{owner}, which mimics another itself: let both mimic that one")
        if (joint.get("type") == "prismatic") != (by_name[leader].get("type") == "prismatic"):
            raise elements.error(f"{owner}, and only one of them slides")
        ratio, offset = (
            elements.number(mimic.get(key, default), f"mimic of joint {short(name)}, {key}")
            for key, default in (("multiplier", "1"), ("offset", "0"))
        )
        if ratio == 0:
            raise elements.error(f"{owner} with a multiplier of 0: make it fixed")
        followers.append(Follower(name, leader, ratio, offset, place))
    return tuple(followers)


def with_followers(
    elements: Elements, chain: Sequence[Element], followers: Sequence[Follower], joints: Sequence[str], limits: Array
) -> Array:
    """Return limits (4, dof) of `joints` that keep those of their followers as well, of all but effort.

    Raises `ConfigurationError` if nothing is left of a range.
    """
    limits = limits.copy()
    for follower in followers:
        element, leader = chain[follower.place], joints.index(follower.leader)
        stated = element.find("limit")
        if element.get("type") != "continuous" and stated is not None:
            lower, upper, velocity, _ = stated_limits(elements, [element])[:, 0]
            low, high = np.sort(follower.ahead(np.array([lower, upper])))
            limits[0, leader] = max(limits[0, leader], low)
            limits[1, leader] = min(limits[1, leader], high)
            if velocity > 0 and limits[2, leader] > 0:
                limits[2, leader] = min(limits[2, leader], velocity / abs(follower.ratio))
        span = limits[1, leader] - limits[0, leader]
        if not span > 0:
            raise elements.error(f"joint {short(follower.leader)} cannot move within the limits of {follower.joint!r}")
        if follower.ratio % 1 and span > FULL_TURN and element.get("type") != "prismatic":
            raise elements.error(
                f"joint {short(follower.leader)} makes more than a turn, after which {follower.joint!r}, which mimics "
                f"{follower.ratio:g} of it, is elsewhere: limit it to one turn"
            )
    return limits


def notes_on_followers(followers: Sequence[Follower]) -> list[str]:
    """Return notes about joints without a motor."""
    return [
        f"Joint {follower.joint!r} has no motor: it is at {follower.ratio:g} times {follower.leader!r} plus "
        f"{follower.offset:g}, and the limits of that are such that its own are kept, except that of effort."
        for follower in followers
    ]
