"""A good arm of three joints as a URDF, of whose parts some may be replaced."""

from armctl.kinematics import ArmModel
from armctl.robot_description import load_arm
from armctl.robots import build_arm_world

BOX, CYLINDER, SPHERE = '<box size=".1 .1 .3"/>', '<cylinder radius=".05" length=".3"/>', '<sphere radius=".05"/>'


LIMIT = '<limit lower="-2" upper="2" velocity="3" effort="50"/>'


def link(name, shape, mass=1, moment=0.01, origin=""):
    inertia = f'<inertia ixx="0.01" iyy="0.01" izz="{moment}" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><mass value="{mass}"/><origin xyz="0 0 .1"/>{inertia}</inertial>'
    return f'<link name="{name}">{inertial}<collision>{origin}<geometry>{shape}</geometry></collision></link>'


def joint(name, parent, child, kind="revolute", limit=LIMIT, axis="0 1 0"):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 .4"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def continuous(limit):
    return {"j1": joint("j1", "base", "l1", "continuous", limit)}


def limited(**numbers):
    """The good arm's second joint with other limits; None leaves one out."""
    numbers = {"lower": -2, "upper": 2, "velocity": 3, "effort": 50} | numbers
    attributes = " ".join(f'{name}="{number}"' for name, number in numbers.items() if number is not None)
    return {"j2": joint("j2", "l1", "l2", limit=f"<limit {attributes}/>")}


GOOD = {
    "base": link("base", CYLINDER),
    "l1": link("l1", BOX),
    "l2": link("l2", CYLINDER),
    "l3": link("l3", SPHERE),
    "j1": joint("j1", "base", "l1", axis="0 0 1"),
    "j2": joint("j2", "l1", "l2"),
    "j3": joint("j3", "l2", "l3"),
}


def chain_of(axes, kind="revolute", length=0.4):
    """A straight arm along z with joints about these axes, and a tip without a shape behind them."""
    names = ["base", *(f"l{i}" for i in range(1, len(axes) + 1))]
    short = f'<cylinder radius=".03" length="{length * 0.6:g}"/>'
    parts = [link(name, short) for name in names]
    for i, axis in enumerate(axes):
        parts.append(joint(f"j{i + 1}", names[i], names[i + 1], kind, axis=axis))
    parts += ['<link name="tool"/>', joint("to_tool", names[-1], "tool", "fixed", limit="")]
    return f'<robot name="chain">{"".join(parts)}</robot>'.replace("0 0 .4", f"0 0 {length:g}")


FINGER = {"finger": link("finger", BOX), "slide": joint("slide", "l2", "finger", "prismatic")}


def everywhere(path, **options):
    """All that armctl makes of a URDF: description, Pinocchio's model and MuJoCo's."""
    description = load_arm(path, **options)
    return description, ArmModel(description), build_arm_world(description, "position")
