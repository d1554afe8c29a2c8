"""Copies of environments of others, in which a policy plans: never the live world.

The reward of such an environment is code that reads its own state, so what an action earns is found by a step of a
copy. A copy shares nothing with its original that could change it, and draws other random numbers: it does not foresee
chance.
"""

import copy
import functools
from typing import Any

import gymnasium
import mujoco
import numpy as np

from armctl.core.arrays import Array
from armctl.core.errors import FAILURES, ConfigurationError, described
from armctl.simulation.history import WHOLE
from armctl.simulation.planning_model import PlanningModel, motor_worlds

SHARED = (gymnasium.Space, gymnasium.envs.registration.EnvSpec)
"""Types of attributes that steps do not change."""
FIXED = (bool, int, float, complex, str, bytes, tuple, np.generic, type(None), mujoco.MjModel, mujoco.MjData, *SHARED)
"""Types of attributes that are put back by reference; MuJoCo's data have a way of their own."""
UNCOPIED = ("renderer", "viewer", "window", "screen", "clock")
"""Parts of the names of attributes that only show the environment."""


class Imagined:
    """A copy of an environment in its present state. Raises `ConfigurationError` if it cannot be copied."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        attributes = {
            name: None if any(part in name for part in UNCOPIED) else value for name, value in vars(env).items()
        }
        shared = {id(value): value for value in attributes.values() if isinstance(value, SHARED)}
        self._dtype = env.action_space.dtype
        try:
            # not by `copy.deepcopy(env)`: an `EzPickle` environment would be made anew, in another state
            self._attributes: dict[str, Any] = copy.deepcopy(attributes, shared)
            self._env: Any = object.__new__(type(env))
        except FAILURES as error:
            raise ConfigurationError(
                f"{type(env).__name__} cannot be copied, so that no policy can plan in it: {described(error)}"
            ) from error
        if "_np_random" in attributes:
            self._attributes["_np_random"] = np.random.default_rng(0)
        values = self._attributes.values()
        self._kept = [value for value in values if isinstance(value, (mujoco.MjModel, mujoco.MjData, *SHARED))]
        self._model = next((value for value in values if isinstance(value, mujoco.MjModel)), None)
        self._states = [(value, copy.copy(value)) for value in values if isinstance(value, mujoco.MjData)]

    def returns(self, actions: Array) -> Array:
        """Return the sums of rewards (n,) of action sequences (n, horizon, ...) from the present state.

        A sequence ends where the environment terminates.
        """
        sums = np.zeros(len(actions))
        for i, sequence in enumerate(actions.astype(self._dtype)):
            self._restore()
            for action in sequence:
                _, reward, terminated, _, _ = self._env.step(action)
                sums[i] += float(reward)
                if terminated:
                    break
        return sums

    def stepped(self, action: Array) -> mujoco.MjData | None:
        """Return MuJoCo's data after a step by an action (...); None if there are none, or several."""
        self._restore()
        self._env.step(action.astype(self._dtype))
        return self._states[0][0] if len(self._states) == 1 else None

    def _restore(self) -> None:
        """Return to the present state."""
        for data, saved in self._states:
            mujoco.mj_copyData(data, self._model, saved)
        changing = {name: value for name, value in self._attributes.items() if not isinstance(value, FIXED)}
        vars(self._env).clear()
        vars(self._env).update(self._attributes | copy.deepcopy(changing, {id(value): value for value in self._kept}))


def planning_model(
    env: gymnasium.Env[Any, Any], space: gymnasium.Space[Any], control_period: float | None, model: Any
) -> PlanningModel:
    """Return a copy of an environment's MuJoCo model to plan in, for actions of a box.

    It has rollouts if the environment's steps are those of MuJoCo with actions as controls, as in Gymnasium's own:
    this is tried in a copy of the environment. Raises `ConfigurationError` for other actions.
    """
    if not isinstance(space, gymnasium.spaces.Box):
        raise ConfigurationError(f"a model to plan in has actions of a box, not of {space}")
    substeps = getattr(env, "frame_skip", None)
    period = control_period or (substeps or 1) * model.opt.timestep
    bare = PlanningModel(copy.copy(model), period, (space.low, space.high), None)
    if not isinstance(substeps, int) or space != env.action_space or space.shape != (model.nu,):
        return bare
    connect = functools.partial(motor_worlds, substeps=substeps, dtype=str(space.dtype))
    with_rollouts = PlanningModel(copy.copy(model), period, (space.low, space.high), connect)
    return with_rollouts if _steps_alike(env, with_rollouts) else bare


def _steps_alike(env: gymnasium.Env[Any, Any], model: PlanningModel) -> bool:
    """Return True if a step of a copy of the environment is one of a rollout in its model."""
    data = getattr(env, "data", None)
    if not isinstance(data, mujoco.MjData):
        return False
    low, high = np.maximum(model.lower, -1), np.minimum(model.upper, 1)
    action = np.random.default_rng(0).uniform(low, high)
    start = np.empty(mujoco.mj_stateSize(model.mujoco, WHOLE))
    mujoco.mj_getState(model.mujoco, data, start, WHOLE)
    try:
        truth = Imagined(env).stepped(action)
    except FAILURES:  # whatever an environment of others raises before its first reset
        return False
    motion = model.rollout(start, action[None, None])
    return truth is not None and all(
        np.allclose(predicted[0, 0], true, rtol=1e-9, atol=1e-12)
        for predicted, true in ((motion.qpos, truth.qpos), (motion.qvel, truth.qvel))
    )
