"""The arms that come with armctl, from example-robot-data, and one on a mount of its own, from `models`."""

from dataclasses import dataclass
from importlib import resources


@dataclass(frozen=True)
class BuiltinArm:
    """Additions of armctl to the URDF of an arm, whose path is relative to example-robot-data's robots, or absolute."""

    urdf: str
    srdf: str
    tip: str
    home: tuple[float, ...]
    max_acceleration: float | tuple[float, ...]


MAX_ACCELERATION = 15.0
"""rad/s^2: default, as URDFs have no such limit; about what its effort allows a stretched-out UR5"""
PANDA_ACCELERATIONS = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
"""rad/s^2: Franka Control Interface documentation, limits for the Panda"""

_MODELS = resources.files("armctl.models")
_UR_HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)

BUILTIN_ARMS = {
    name: BuiltinArm(
        f"ur_description/urdf/{name}_robot.urdf", "ur_description/srdf/ur5.srdf", "ee_link", _UR_HOME, MAX_ACCELERATION
    )
    for name in ("ur3", "ur5", "ur10")
} | {
    "ur5_robotiq85": BuiltinArm(
        str(_MODELS / "ur5_robotiq85.urdf"),
        str(_MODELS / "ur5_robotiq85.srdf"),
        "tool",
        (1.57, -1.5707, 0.0, -1.5707, -1.57, 3.14),
        9.5,  # what the shoulder's effort allows with the gripper, stretched out
    ),
    "z1": BuiltinArm(
        "z1_description/urdf/z1.urdf",
        "z1_description/srdf/z1.srdf",
        "gripperStator",
        (0.0, 1.2, -1.2, 0.0, 0.0, 0.0),
        MAX_ACCELERATION,
    ),
    "panda": BuiltinArm(
        "panda_description/urdf/panda.urdf",
        "panda_description/srdf/panda.srdf",
        "panda_hand_tcp",
        (0.0, -0.785398, 0.0, -2.35619, 0.0, 1.5707, 0.785398),
        PANDA_ACCELERATIONS,
    ),
    "panda_open": BuiltinArm(
        str(_MODELS / "panda_open.urdf"),
        str(_MODELS / "panda_open.srdf"),
        "panda_hand_tcp",
        (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785),
        PANDA_ACCELERATIONS,
    ),
    "xarm7": BuiltinArm(
        "xarm_description/urdf/xarm7.urdf",
        "xarm_description/srdf/xarm7.srdf",
        "link_eef",
        (0.0, -0.5, 0.0, 0.9, 0.0, 1.4, 0.0),
        MAX_ACCELERATION,
    ),
}
