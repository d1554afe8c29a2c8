"""The bridge with physics: a rover on MuJoCo's wheels, whose contacts and joints are recorded in each control step."""

import functools

import numpy as np
from numpy.typing import NDArray

from armctl.robots.rover import PARTS, Rover, driven_rovers
from armctl.simulation import ContactSensors, Simulation
from armctl.simulation.control_step import NO_PARTS
from armctl.tasks.bridge.furniture import Furniture
from armctl.tasks.bridge.layout import Layout
from armctl.tasks.bridge.options import CONTROL_PERIOD, MOVES
from armctl.tasks.bridge.world import CONTACT_CLASSES
from armctl.tasks.task import Ids


class PhysicalRover(Rover):
    """n rovers among furniture."""

    def __init__(self, simulation: Simulation, furniture: Furniture) -> None:
        super().__init__(simulation)
        self.joints = self.wheel_samples(MOVES, CONTROL_PERIOD)
        self._ticks = round(CONTROL_PERIOD / MOVES / simulation.model.opt.timestep)
        self.rollout_worlds = functools.partial(driven_rovers, ticks=MOVES, period=CONTROL_PERIOD)
        """Maker of worlds in which such rovers drive alike, with nothing else on the deck."""
        self._contacts = ContactSensors(simulation, PARTS, CONTACT_CLASSES)
        self._parts = NO_PARTS._replace(samples=self.joints.part, contacts=self._contacts.part, poses=furniture.poses)

    def place(self, ids: Ids, layouts: list[Layout]) -> None:
        """Do nothing: the furniture is in the simulation."""

    def begin(self, ids: Ids) -> None:
        """Begin episodes of rovers `ids`, which stand where the simulation has put them."""
        self._contacts.forget(ids)
        self._simulation.refresh(ids)

    def drive(self, ids: Ids | None) -> None:
        """Drive for one control step, in worlds `ids` or in all."""
        self._contacts.forget(ids)
        self._simulation.control_step(MOVES, self._ticks, ids, self._parts)

    def contacts(self) -> NDArray[np.bool_]:
        """Return contacts since the last control step, (n, `PARTS`, `CONTACT_CLASSES`)."""
        return self._contacts.since_last_step()
