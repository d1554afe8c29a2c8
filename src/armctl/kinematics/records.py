"""An arm and boxes as arrays of records, which kernels take."""

import numpy as np
import pinocchio
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.arm import JOINT
from armctl.kernels.arm_dynamics import BODY
from armctl.kernels.capsules import BOX, LINK
from armctl.kernels.drives import DRIVE
from armctl.robot_description import ArmDescription
from armctl.robot_description.collision_pairs import link_frame
from armctl.scene import Boxes

Records = NDArray[np.void]


def joint_records(model: pinocchio.Model, axes: NDArray[np.float64], description: ArmDescription) -> Records:
    """Return the joints (m,) of an arm, whose `axes` (m, 3) are in their own frames."""
    joints = np.zeros(len(axes), JOINT)
    joints["slides"] = [name in description.sliding for name in list(model.names)[1:]]
    coupling, joints["shift"] = description.coupling
    joints["motor"] = np.abs(coupling).argmax(axis=1)
    joints["ratio"] = coupling.sum(axis=1)
    for joint, placement, axis in zip(joints, model.jointPlacements[1:], axes, strict=True):
        if joint["slides"]:
            joint["base"], joint["offset"] = placement.rotation, placement.translation
            joint["slide"] = placement.rotation @ axis
            continue
        turn = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        joint["base"], joint["offset"] = placement.rotation, placement.translation
        joint["sine"], joint["versine"] = placement.rotation @ turn, placement.rotation @ turn @ turn
    joints["axis"] = axes
    tip = model.frames[link_frame(model, description.tip)].placement
    joints["tip"], joints["tip_rotation"] = tip.translation, tip.rotation
    for name in DRIVE.fields or ():
        joints[name][: description.dof] = description.limits.drives[name]
    return joints


def body_records(model: pinocchio.Model, description: ArmDescription, stiffness: Array, damping: Array) -> Records:
    """Return what each joint (dof,) carries along, and servos with a `stiffness` and `damping` (dof,)."""
    bodies = np.zeros(description.dof, BODY)
    for body, inertia in zip(bodies, list(model.inertias)[1:], strict=True):
        body["mass"], body["centre"], body["inertia"] = inertia.mass, inertia.lever, inertia.inertia
    bodies["stiffness"], bodies["damping"], bodies["effort"] = stiffness, damping, description.limits.effort
    return bodies


def link_records(model: pinocchio.Model, description: ArmDescription) -> Records:
    """Return the links of an arm that have a shape, in the order of the description's capsules."""
    links = np.zeros(len(description.capsules), LINK)
    for link, capsule in zip(links, description.capsules, strict=True):
        frame = model.frames[link_frame(model, capsule.link)]
        link["joint"], link["radius"] = frame.parentJoint, capsule.radius
        link["start"], link["end"] = (frame.placement.act(np.array(end)) for end in (capsule.start, capsule.end))
    return links


def box_records(boxes: Boxes) -> Records:
    """Return boxes (k,) as records."""
    records = np.zeros(len(boxes), BOX)
    records["rotation"], records["centre"], records["half_size"] = boxes.rotations, boxes.centres, boxes.half_sizes
    return records
