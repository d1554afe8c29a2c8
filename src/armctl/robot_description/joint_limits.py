"""Limits of a URDF's joints: as its file states them, lowered by options, and assumed where it states none."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, TypedDict

import numpy as np
import pinocchio

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError, unknown_name
from armctl.robot_description.effort import CONFIGURATIONS, torques_of
from armctl.robot_description.elements import Elements
from armctl.robot_description.xml_file import Element

FULL_TURN = 2 * math.pi
SPEEDS = {"revolute": 2.0, "prismatic": 0.5}
"""rad/s and m/s: assumed where a file has no velocity limit."""
ASSUMED_ACCELERATION = 5.0
"""rad/s^2 and m/s^2: effort limits that are assumed give this to all joints at once, besides holding the arm."""


class OverrideOptions(TypedDict, total=False):
    """Options of `load_arm` that state what a file lacks, or lower what it has."""

    max_acceleration: float | Sequence[float] | Array | None
    max_jerk: float | Sequence[float] | Array | None
    max_velocity: float | Sequence[float] | Array | None
    max_effort: float | Sequence[float] | Array | None
    density: float | None


@dataclass(frozen=True)
class Overrides:
    """The same as hashable tuples; None: not overrides."""

    max_acceleration: tuple[float, ...] | None = None
    max_jerk: tuple[float, ...] | None = None
    max_velocity: tuple[float, ...] | None = None
    max_effort: tuple[float, ...] | None = None
    density: tuple[float, ...] | None = None

    @classmethod
    def of(cls, options: dict[str, Any]) -> "Overrides":
        """Return overrides of options by name; raises `ConfigurationError` for unknown ones, and for no numbers."""
        names = [field.name for field in fields(cls)]
        for name in options:
            if name not in names:
                raise unknown_name("option of load_arm", name, ["tip", "home", "srdf", *names])
        values = {name: as_tuple(name, value) for name, value in options.items() if value is not None}
        if "density" in values:
            _for_each("density", values["density"], 1)
        return cls(**values)

    def limit(self, name: str, dof: int) -> Array | None:
        """Return a limit for each joint, (dof,); None without one."""
        values = getattr(self, name)
        return None if values is None else _for_each(name, values, dof)


def as_tuple(name: str, values: float | Sequence[float] | Array) -> tuple[float, ...]:
    """Return one number for all joints, or one for each, as a tuple."""
    try:
        return tuple(float(value) for value in np.atleast_1d(values))
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"{name} should be a number for each joint, not {values}") from error


def _for_each(name: str, limit: tuple[float, ...], dof: int) -> Array:
    numbers = np.array(limit)
    if len(limit) not in (1, dof) or not (np.isfinite(numbers) & (numbers > 0)).all():
        several = f", or {dof} of them" if dof > 1 else ""
        raise ConfigurationError(f"{name} should be one finite number above 0{several}, not {limit}")
    return np.broadcast_to(numbers, dof)


def stated_limits(elements: Elements, chain: list[Element]) -> Array:
    """Return lower and upper position, velocity and effort limits (4, dof) of joints; 0 for a missing one.

    Raises `ConfigurationError` for joints that cannot move.
    """
    return np.array([_limits_of(elements, joint) for joint in chain]).T


def _limits_of(elements: Elements, joint: Element) -> list[float]:
    name, limit = joint.get("name"), joint.find("limit")
    limits = {} if limit is None else dict(limit.attrib)
    if joint.get("type") == "continuous":
        limits |= {"lower": str(-FULL_TURN), "upper": str(FULL_TURN)}
    if missing := [key for key in ("lower", "upper") if key not in limits]:
        raise elements.error(f"joint {name!r} has no {' and no '.join(missing)} limit")
    lower, upper, velocity, effort = (
        elements.number(limits.get(key, "0"), f"joint {name!r}, {key} limit")
        for key in ("lower", "upper", "velocity", "effort")
    )
    if not (lower < upper and velocity >= 0 and effort >= 0):
        raise elements.error(
            f"joint {name!r} cannot move: lower {lower:g} must be below upper {upper:g}, and velocity {velocity:g} "
            f"and effort {effort:g} not below 0"
        )
    return [lower, upper, velocity, effort]


def lowered(stated: Array, limit: Array | None, assumed: Array) -> Array:
    """Return what a file states (dof,), at most the limit of an option; where it states 0, that limit or `assumed`."""
    allowed = np.where(stated > 0, np.inf, assumed) if limit is None else limit
    return np.where(stated > 0, np.minimum(stated, allowed), allowed)


def assumed_efforts(urdf: str) -> Array:
    """Return efforts (dof,) that hold an arm, and give all its joints `ASSUMED_ACCELERATION`, in any configuration.

    They are the largest in random configurations, to two digits: N m, or N of joints that slide.
    """
    model = pinocchio.buildModelFromXML(urdf, mimic=True)
    efforts = np.zeros(model.nv)
    for gravity, inertia in torques_of(model, CONFIGURATIONS):
        efforts = np.maximum(efforts, gravity + ASSUMED_ACCELERATION * inertia)
    return np.array([float(f"{effort:.2g}") for effort in np.maximum(efforts, 1e-3)])


def notes_on_limits(chain: list[Element], stated: Array, limits: Array, overrides: Overrides) -> list[str]:
    """Return notes about velocities and efforts (4, dof each) that a file does not state."""
    hold = f"N m, which hold the arm and accelerate it by {ASSUMED_ACCELERATION:g} rad/s^2"
    kinds = (
        (2, "velocity", overrides.max_velocity, "rad/s, of sliding ones m/s"),
        (3, "effort", overrides.max_effort, hold),
    )
    notes = []
    for row, name, option, unit in kinds:
        missing = [(joint.get("name"), limits[row, i]) for i, joint in enumerate(chain) if not stated[row, i]]
        if missing:
            values = {value for _, value in missing}
            listed = ", ".join(f"{joint!r} {value:g}" if len(values) > 1 else repr(joint) for joint, value in missing)
            listed += f": {values.pop():g}" if len(values) == 1 else ""
            source = f"{unit}, are assumed (max_{name}= gives others)" if option is None else f"as max_{name}= says"
            notes.append(f"The file has no {name} limit of these joints: {listed} {source}.")
    return notes
