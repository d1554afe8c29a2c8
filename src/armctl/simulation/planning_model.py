"""The model in which a policy plans by simulation: MuJoCo's, without disturbances, and rollouts of actions in it.

A rollout makes the control steps of the environment, with the law of the robot's drives, which is no part of MuJoCo.
It begins in any state that the policy believes. All of it is a copy: nothing leads to the environment.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError, unknown_name
from armctl.simulation.history import WHOLE
from armctl.simulation.simulation import Simulation

STATE_FIELDS = ("time", "qpos", "qvel", "act", "ctrl", "qfrc_applied", "xfrc_applied", "mocap_pos", "mocap_quat")
"""Fields of MuJoCo's data that a state can be made of."""

Step = Callable[[Array], None]
"""Makes a control step in n worlds by actions (n, ...)."""
Connect = Callable[[mujoco.MjModel, int], tuple[Simulation, Step]]
"""Makes n worlds of a model, and what steps them as the environment does. It can be pickled."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Predicted motion of n worlds after each of `horizon` control steps, as MuJoCo's fields of these names."""

    qpos: Array
    """(n, horizon, nq)."""
    qvel: Array
    """(n, horizon, nv)."""
    xpos: Array
    """Positions of the bodies, (n, horizon, bodies, 3) m."""
    sensordata: Array
    """(n, horizon, k)."""
    states: Array
    """Whole states, (n, horizon, state), in each of which a rollout can begin."""
    unstable: NDArray[np.bool_]
    """(n,) worlds whose numbers became infinite: they stand still from then on."""


def rescaled(actions: Array, lowest: Array, highest: Array) -> Array:
    """Return normalized actions, clipped to -1 and 1, in the units of these bounds."""
    return np.asarray(lowest + (np.clip(actions, -1, 1) + 1) / 2 * (highest - lowest))


def motor_worlds(
    model: mujoco.MjModel,
    n: int,
    *,
    substeps: int,
    lower: ArrayLike = -np.inf,
    upper: ArrayLike = np.inf,
    dtype: str = "float64",
) -> tuple[Simulation, Step]:
    """Make n worlds whose actions, within bounds and rounded to a type, are the controls of MuJoCo's actuators."""
    simulation = Simulation(model, n, threads=1)
    ctrl = simulation.array("ctrl")

    def step(actions: Array) -> None:
        np.clip(actions.astype(dtype), lower, upper, out=ctrl)
        simulation.step(substeps)

    return simulation, step


class PlanningModel:
    """A nominal model with the environment's control period and actions.

    `connect` is None where the environment does not tell how its actions move its robot: then nothing can be rolled
    out. `units` are the actions in the task's units that -1 and 1 stand for, if actions are normalized.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        control_period: float,
        bounds: tuple[ArrayLike, ArrayLike],
        connect: Connect | None,
        units: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> None:
        self.mujoco = model
        """The model, a copy, which the policy may change: it counts from the next `rollout` on."""
        self.control_period = control_period
        """Seconds between two control steps."""
        self.lower, self.upper = (np.array(bound, dtype=float) for bound in bounds)
        """Bounds of one world's action."""
        self._connect, self._units = connect, units
        self._last: tuple[NDArray[np.uint8], int, Simulation, Step] | None = None

    def copy(self) -> "PlanningModel":
        """Return an independent copy."""
        bounds = self.lower, self.upper
        return PlanningModel(copy.copy(self.mujoco), self.control_period, bounds, self._connect, self._units)

    def state(self, base: Array | None = None, **fields: ArrayLike) -> Array:
        """Return a state (k,) with these `STATE_FIELDS`, and else that of `base`, by default that of the keyframe.

        Without a `base` or `act`, drives rest where `qpos` has their joints. Raises `ConfigurationError` for another
        name or shape.
        """
        data = mujoco.MjData(self.mujoco)
        if base is not None:
            mujoco.mj_setState(self.mujoco, data, np.asarray(base, dtype=float), WHOLE)
        elif self.mujoco.nkey:
            mujoco.mj_resetDataKeyframe(self.mujoco, data, 0)
        for name, value in fields.items():
            if name not in STATE_FIELDS:
                raise unknown_name("field of a state", name, STATE_FIELDS)
            numbers, expected = np.asarray(value, dtype=float), np.shape(getattr(data, name))
            if numbers.shape != expected:
                raise ConfigurationError(f"{name} of a state has shape {expected}, not {numbers.shape}")
            if expected:
                getattr(data, name)[:] = numbers
            else:
                setattr(data, name, float(numbers))
        if base is None and "act" not in fields:
            self._rest_drives(data)
        state = np.empty(mujoco.mj_stateSize(self.mujoco, WHOLE))
        mujoco.mj_getState(self.mujoco, data, state, WHOLE)
        return state

    def rollout(self, state: Array, actions: ArrayLike) -> Motion:
        """Return the motion of n worlds by `actions` (n, horizon, ...), from one state (k,) or one for each, (n, k).

        The same numbers as the environment's steps from this state, bit for bit, if nothing disturbs it and the robot
        touches nothing that the model lacks. Raises `ConfigurationError` if the environment's steps are unknown.
        """
        if self._connect is None:
            raise ConfigurationError(
                "this environment does not tell how its actions move its robot, so that nothing can be rolled out"
            )
        sequences = self._physical(np.asarray(actions, dtype=float))
        if sequences.ndim != self.lower.ndim + 2 or sequences.shape[2:] != self.lower.shape:
            raise ConfigurationError(f"actions have shape {('n', 'horizon', *self.lower.shape)}, not {sequences.shape}")
        simulation, step = self._worlds(len(sequences), self._connect)
        simulation.set_states(state)
        live = {name: simulation.array(name) for name in ("qpos", "qvel", "xpos", "sensordata")}
        live["states"] = simulation.live_arrays["state"]
        motion: dict[str, list[Array]] = {name: [] for name in live}
        for commands in np.moveaxis(sequences, 1, 0):
            step(commands)
            for name, values in live.items():
                motion[name].append(values.copy())
        stacked = {name: np.stack(values, axis=1) for name, values in motion.items()}
        return Motion(**stacked, unstable=simulation.unstable.copy())

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process can be sent: no worlds."""
        return {**vars(self), "_last": None}

    def _worlds(self, n: int, connect: Connect) -> tuple[Simulation, Step]:
        """Return n worlds of the model as it is now: those of the last rollout, if there are so many of the same."""
        numbers = np.empty(mujoco.mj_sizeModel(self.mujoco), dtype=np.uint8)
        mujoco.mj_saveModel(self.mujoco, None, numbers)
        if self._last is None or self._last[1] != n or not np.array_equal(self._last[0], numbers):
            self._last = numbers, n, *connect(copy.copy(self.mujoco), n)
        return self._last[2:]

    def _rest_drives(self, data: mujoco.MjData) -> None:
        """Let the positions that drives of joints command, integrated velocities, be those of the joints."""
        model = self.mujoco
        integrates = model.actuator_dyntype == int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
        drives = integrates & (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT))
        joints = model.actuator_trnid[drives, 0]
        data.act[model.actuator_actadr[drives]] = data.qpos[model.jnt_qposadr[joints]]

    def _physical(self, actions: Array) -> Array:
        """Return actions in the task's units."""
        return actions if self._units is None else rescaled(actions, *map(np.asarray, self._units))
