"""What may go wrong: noise, delay, payload, friction, weakness, lost pictures, pushes, and a robot unlike its model."""

import functools
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from armctl.disturbances.disturbance import Disturbance, Kind
from armctl.disturbances.fields import JointFriction, LinkMismatch, Payload, Slipperiness, Strength, WheelMismatch
from armctl.disturbances.signals import Delay, Dropout, Noise, Pushes
from armctl.errors import ConfigurationError, unknown_name
from armctl.tasks import BridgeTask, Task

__all__ = ["ARM", "CAMERA", "ROVER", "Disturbance", "Kind", "disturbed", "kinds", "stream"]

Share = functools.partial(Kind, highest=1.0)

ARM: dict[str, Kind] = {
    "noise": Kind(Noise, "sensor noise, standard deviation", "m, rad, m/s", (0, 0.005, 0.01, 0.02, 0.05), 1e3),
    "delay": Kind(Delay, "late actions", "decisions of 40 ms", (0, 1, 2, 4, 8), 1e3, whole=True),
    "payload": Kind(Payload, "a ball at the end-effector", "kg", (0, 2, 5, 10, 20), 1e4),
    "friction": Share(JointFriction, "dry friction of the joints", "of largest torque", (0, 0.1, 0.2, 0.4, 0.8)),
    "strength": Share(Strength, "torque of the motors", "left", (1, 0.8, 0.6, 0.4, 0.2)),
    "pushes": Kind(Pushes, "pushes at the end-effector, about one a second", "N s", (0, 5, 10, 20, 40), 1e4),
    "mismatch": Share(
        LinkMismatch, "links' masses and lengths unlike the model's, at most by", "share", (0, 0.02, 0.05, 0.1, 0.2)
    ),
}
ROVER: dict[str, Kind] = {
    "noise": Kind(Noise, "sensor noise, standard deviation", "m, m/s, rad/s", (0, 0.05, 0.1, 0.2, 0.5), 1e3),
    "delay": Kind(Delay, "late actions", "decisions of 100 ms", (0, 1, 2, 3, 5), 1e3, whole=True),
    "payload": Kind(Payload, "a ball on top", "kg", (0, 5, 10, 20, 40), 1e4),
    "friction": Share(Slipperiness, "friction of the tyres", "left", (1, 0.75, 0.5, 0.25, 0.1)),
    "strength": Share(Strength, "torque of the motors", "left", (1, 0.8, 0.6, 0.4, 0.2)),
    "pushes": Kind(Pushes, "pushes at the base, about one a second", "N s", (0, 5, 10, 20, 40), 1e4),
    "mismatch": Share(
        WheelMismatch,
        "wheels' radii and the base's mass unlike the model's, at most by",
        "share",
        (0, 0.02, 0.05, 0.1, 0.2),
    ),
}
CAMERA: dict[str, Kind] = {
    "dropout": Share(Dropout, "camera pictures that are lost", "share", (0, 0.1, 0.25, 0.5, 0.75)),
}
"""By name, for the robots, and for what has a camera besides."""


def kinds(task: Task) -> dict[str, Kind]:
    """The disturbances that there are in a task, by name."""
    if not isinstance(task, BridgeTask):
        return ARM
    return ROVER | (CAMERA if task.options.observation == "camera" else {})


def disturbed(task: Task, levels: Mapping[str, Any]) -> dict[str, Disturbance]:
    """Disturb a task, each kind at its level, for good; those at levels that change nothing are left out.

    Raises `ConfigurationError`.
    """
    if not isinstance(levels, Mapping):
        raise ConfigurationError(f"disturbances are levels by name, such as {{'payload': 2.0}}, not {levels!r}")
    there = kinds(task)
    for name in levels:
        if name not in there:
            raise unknown_name("disturbance here", name, there)
    checked = {name: kind.checked(name, levels[name]) for name, kind in there.items() if name in levels}
    return {name: there[name].make(task, level) for name, level in checked.items() if level != there[name].neutral}


def stream(name: str, seed: int, episode: int) -> np.random.Generator:
    """The chance that a disturbance has in an episode: apart from the task's, and from that of all others."""
    return np.random.default_rng(np.random.SeedSequence((seed, episode), spawn_key=(zlib.crc32(name.encode()),)))
