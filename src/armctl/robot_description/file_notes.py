"""Notes about the text of a URDF: what is not read of it, and numbers that can hardly be meant."""

import math
from collections.abc import Iterable, Iterator

from armctl.robot_description.xml_file import Element, short

MAX_TURNS = 4
"""Turns to one side beyond which a joint's limit is suspected to be in degrees."""
FASTEST = 20.0
"""rad/s: velocity limit above which it is suspected to be in degrees per second; fast arms have 10."""
MAX_NAMED = 12
"""Joints, elements or attributes that one note names."""

_INERTIA = {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"}
ATTRIBUTES = {
    "robot": {"version"}, "link": {"type"}, "joint": {"type"}, "parent": {"link"}, "child": {"link"},
    "origin": {"xyz", "rpy"}, "axis": {"xyz"}, "limit": {"lower", "upper", "velocity", "effort"},
    "mesh": {"filename", "scale"}, "box": {"size"}, "cylinder": {"radius", "length"}, "sphere": {"radius"},
    "mass": {"value"}, "inertia": _INERTIA,
}  # fmt: skip
"""Attributes that are read, besides names, by element."""
CHILDREN = {
    "robot": {"link", "joint", "material", "transmission", "ros2_control"},
    "link": {"inertial", "visual", "collision"},
    "joint": {"origin", "parent", "child", "axis", "limit", "mimic", "dynamics", "safety_controller", "calibration"},
}
"""Elements that are read, have notes of their own, or are about nothing that is simulated, by parent."""


def notes_on_file(robot: Element, chain: list[Element]) -> list[str]:
    """Return notes about a URDF's root element, whose movable joints from root to tip are `chain`."""
    return [
        *_not_read(robot),
        *_fixed_joints(robot, chain),
        *_not_simulated(chain),
        *_axes(chain),
        *_units(robot, chain),
    ]


def _not_read(robot: Element) -> Iterator[str]:
    parts = [robot, *robot.findall("link"), *robot.findall("joint")]
    elements = (child.tag for part in parts for child in part if child.tag not in CHILDREN[part.tag])
    inside = [robot, *(element for part in parts[1:] for element in part.iter())]
    attributes = (
        f"{name}={short(value)} of <{element.tag}>"
        for element in inside
        for name, value in element.items()
        if name not in {"name", *ATTRIBUTES.get(element.tag, element.keys())}
    )
    if texts := list(dict.fromkeys([*(f"<{short(tag)[1:-1]}>" for tag in elements), *attributes])):
        yield f"Not read: {_some(texts)}."


def _fixed_joints(robot: Element, chain: list[Element]) -> Iterator[str]:
    fixed = [joint for joint in robot.findall("joint") if joint.get("type") != "fixed" and joint not in chain]
    if fixed:
        yield f"Joints beside the chain from root to tip are fixed at zero: {_names(fixed)}."
    if beyond := [joint for joint in fixed if not _limit(joint, "lower", 0) <= 0 <= _limit(joint, "upper", 0)]:
        yield f"Zero is out of the range of these: {_names(beyond)}."


def _not_simulated(chain: list[Element]) -> Iterator[str]:
    resisting = [
        joint
        for joint in chain
        if any(_number(element.get(name), 0) for element in joint.iter("dynamics") for name in ("damping", "friction"))
    ]
    if resisting:
        yield f"Damping and friction of joints are not simulated: {_names(resisting)}."
    soft = [
        joint
        for joint in chain
        for limits in joint.iter("safety_controller")
        if _number(limits.get("soft_lower_limit"), -math.inf) > _limit(joint, "lower", -math.inf)
        or _number(limits.get("soft_upper_limit"), math.inf) < _limit(joint, "upper", math.inf)
    ]
    if soft:
        yield f"Soft limits of joints, which are narrower than their limits, are not kept: {_names(soft)}."


def _axes(chain: list[Element]) -> Iterator[str]:
    if bare := [joint for joint in chain if joint.find("axis") is None]:
        yield f"Joints without an <axis> turn about x, as URDF has it: {_names(bare)}."
    if endless := [joint for joint in chain if joint.get("type") == "continuous"]:
        yield f"Continuous joints turn by one turn to each side of zero: {_names(endless)}."


def _units(robot: Element, chain: list[Element]) -> Iterator[str]:
    limited = [joint for joint in chain if joint.get("type") != "continuous"]
    bounds = {joint: max(abs(_limit(joint, name, 0)) for name in ("lower", "upper")) for joint in limited}
    if wide := [joint for joint in limited if bounds[joint] > MAX_TURNS * 2 * math.pi]:
        yield (
            f"Joint {short(wide[0].get('name', ''))} turns up to {bounds[wide[0]]:g} rad, "
            f"{bounds[wide[0]] / (2 * math.pi):.0f} turns{_and_others(wide)}: is that in degrees? URDFs are in radians."
        )
    if fast := [joint for joint in chain if _limit(joint, "velocity", 0) > FASTEST]:
        yield (
            f"Joint {short(fast[0].get('name', ''))} turns at up to {_limit(fast[0], 'velocity', 0):g} rad/s"
            f"{_and_others(fast)}: is that in degrees per second? URDFs are in rad/s."
        )
    angles = (abs(_number(word, 0)) for origin in robot.iter("origin") for word in origin.get("rpy", "").split())
    if (largest := max(angles, default=0)) > 2 * math.pi + 1e-6:
        yield f"An origin is turned by {largest:g} rad: is that in degrees? URDFs are in radians."


def _limit(joint: Element, name: str, default: float) -> float:
    limit = joint.find("limit")
    return default if limit is None else _number(limit.get(name), default)


def _number(word: str | None, default: float) -> float:
    try:
        return default if word is None else float(word)
    except ValueError:
        return default


def _names(joints: Iterable[Element]) -> str:
    return _some([short(joint.get("name", "")) for joint in joints])


def _some(texts: list[str]) -> str:
    more = f" and {len(texts) - MAX_NAMED} more" if len(texts) > MAX_NAMED else ""
    return ", ".join(texts[:MAX_NAMED]) + more


def _and_others(joints: list[Element]) -> str:
    return f" ({len(joints) - 1} more like it)" if len(joints) > 1 else ""
