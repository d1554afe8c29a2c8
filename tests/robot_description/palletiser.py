"""An arm whose wrist follows its elbow, as a URDF: rear arm and forearm, and a tool that turns at the end."""

JOINT = (
    '<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 {height}"/>'
    '<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" velocity="2" effort="60"/>{more}</joint>'
)
LINK = (
    '<link name="{name}"><inertial><origin xyz="0 0 {half}"/><mass value="{mass}"/><inertia ixx="0.01" ixy="0" '
    'ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial><collision><origin xyz="0 0 {half}"/><geometry>'
    '<cylinder radius="{radius}" length="{length}"/></geometry></collision></link>'
)
LINKS = (("turret", 2, 0.2, 0.05), ("rear", 1.5, 0.3, 0.03), ("fore", 1, 0.3, 0.03), ("wrist", 0.4, 0.1, 0.02))
FOLLOWS = '<mimic joint="elbow" multiplier="-1" offset="0.2"/>'


def palletiser(mimic=FOLLOWS, wrist=(-2.0, 2.1), elbow=(-2.5, 2.5), wrist_kind="revolute", elbow_mimic=""):
    """Motors are yaw, shoulder, elbow and roll; the wrist is at minus the elbow, plus 0.2 rad."""
    links = [*LINKS, ("tool", 0.2, 0.1, 0.02)]
    joints = [
        ("yaw", "base", "turret", 0.02, "0 0 1", -2.5, 2.5, ""),
        ("shoulder", "turret", "rear", 0.2, "0 1 0", -1.2, 1.2, ""),
        ("elbow", "rear", "fore", 0.3, "0 1 0", *elbow, elbow_mimic),
        ("wrist", "fore", "wrist", 0.3, "0 1 0", *wrist, mimic),
        ("roll", "wrist", "tool", 0.1, "0 0 1", -2.5, 2.5, ""),
    ]
    names = ("name", "parent", "child", "height", "axis", "lower", "upper", "more")
    texts = [
        *(
            LINK.format(name=name, mass=mass, length=length, half=length / 2, radius=radius)
            for name, mass, length, radius in links
        ),
        *(
            JOINT.format(kind=wrist_kind if joint[0] == "wrist" else "revolute", **dict(zip(names, joint, strict=True)))
            for joint in joints
        ),
    ]
    tip = (
        '<link name="tip"/><joint name="at_tip" type="fixed"><parent link="tool"/><child link="tip"/>'
        '<origin xyz="0.03 0 0.1"/></joint>'
    )
    return f'<robot name="palletiser"><link name="base"/>{"".join(texts)}{tip}</robot>'
