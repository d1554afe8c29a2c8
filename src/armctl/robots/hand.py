"""The Panda's hand with fingers that slide: an arm's description holds them fast.

Each finger ends in a flat pad, a box with the measures of the file's rubber tip. A rack couples the real fingers; here
an equality does. Their motors are springs of limited force, and dampers limit their speed.
"""

from typing import Any

import mujoco
import numpy as np

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.robots.arm import HARD, PREFIX
from armctl.scene.lift_table import OPENING
from armctl.simulation import Simulation
from armctl.simulation.planning_model import Connect, Step

FINGERS = "panda_leftfinger", "panda_rightfinger"
"""Links, which slide along their y axis and against it."""
FORCE, SPEED = 30.0, 0.1
"""N and m/s, the most of each finger. Franka Emika's data sheet has 70 N continuous force, and 50 mm/s."""
STIFFNESS = 6000.0
"""N/m: 5 mm from its goal, a finger has its largest force."""
ROTOR = 1.0
"""kg: inertia of a finger's motor, as felt at the finger. With a tenth of it, a held object chatters, and slips."""
PAD = (0.0, 0.0076, 0.04525), (0.00875, 0.0076, 0.00925)
BACK = (0.0, 0.0185, 0.018), (0.011, 0.0075, 0.018)
"""Centres and half sizes (m) of a finger's two boxes in its frame: the pad, and what carries it."""


def pads() -> tuple[str, ...]:
    """Return the names of the pads' geoms."""
    return tuple(f"{finger}_pad" for finger in FINGERS)


def backs() -> tuple[str, ...]:
    """Return the names of the geoms that carry the pads."""
    return tuple(f"{finger}_back" for finger in FINGERS)


def add_fingers(spec: Any, name: str) -> None:
    """Let the fingers of the arm `name` slide, and add their boxes, which collide with nothing yet.

    Raises `ConfigurationError` for an arm without the Panda's hand.
    """
    for finger, side, pad, back in zip(FINGERS, (1, -1), pads(), backs(), strict=True):
        body = spec.body(PREFIX + finger)
        if body is None:
            raise ConfigurationError(f"{name} has no hand with the fingers {' and '.join(FINGERS)}: use robot='panda'")
        joint = body.add_joint(name=finger, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, side, 0])
        joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, [0.0, OPENING / 2]
        joint.damping[:] = FORCE / SPEED
        joint.armature = ROTOR
        joint.solref_limit, joint.solimp_limit = HARD
        for geom, ((x, y, z), half_sizes) in ((pad, PAD), (back, BACK)):
            body.add_geom(
                name=geom, type=mujoco.mjtGeom.mjGEOM_BOX, pos=[x, side * y, z], size=half_sizes, group=3,
                contype=0, conaffinity=0, mass=0,
            )  # fmt: skip
    rack = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=FINGERS[0], name2=FINGERS[1])
    rack.data[:2] = 0.0, 1.0
    rack.solref, rack.solimp = HARD


def add_finger_motors(spec: Any) -> None:
    """Add the fingers' motors, after those of the arm."""
    for finger in FINGERS:
        motor = spec.add_actuator(name=finger, target=finger, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_position(kp=STIFFNESS)
        motor.ctrlrange, motor.forcerange = [0.0, OPENING / 2], [-FORCE, FORCE]


class Hand:
    """The hands of n arms."""

    def __init__(self, simulation: Simulation) -> None:
        joint = simulation.model.joint(FINGERS[0]).qposadr[0]
        self._fingers = simulation.array("qpos")[:, joint : joint + len(FINGERS)]
        self._commands = simulation.array("ctrl")[:, -len(FINGERS) :]

    @property
    def openings(self) -> Array:
        """Distances (n, 1) between the pads, m."""
        return np.asarray(self._fingers.sum(axis=1, keepdims=True))

    def command(self, openings: Array) -> None:
        """Set the openings (n,) to move to, m: with less than an object's width, the hand grasps it."""
        self._commands[:] = (openings / 2).clip(0.0, OPENING / 2)[:, None]

    def open(self, ids: Any) -> None:
        """Open the hands of worlds `ids`, at once."""
        self._fingers[ids] = self._commands[ids] = OPENING / 2


def worlds_with_hands(model: mujoco.MjModel, n: int, *, arms: Connect) -> tuple[Simulation, Step]:
    """Make n worlds of `arms` with hands; an action has the opening last."""
    simulation, move_arms = arms(model, n)
    hand = Hand(simulation)

    def step(actions: Array) -> None:
        hand.command(actions[:, -1])
        move_arms(actions[:, :-1])

    return simulation, step
