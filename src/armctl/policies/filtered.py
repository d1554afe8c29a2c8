"""Any policy behind a safety filter, which changes actions after which a contact could no longer be avoided.

`filtered(NAME)` is such a policy. The filter knows the robot's limits and shape, and sees where it is and what is
around it (`armctl.control.arm_filter`, `armctl.control.rover_filter`); the policy behind it gets what it declares to
see. `FilteredWorlds` are worlds that filter the actions of a learner.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array, Observations
from armctl.core.errors import ConfigurationError
from armctl.core.options import changed_options
from armctl.envs import EpisodeVectorEnv, Interface, TaskVectorEnv
from armctl.estimation.delay import DelayOptions, DelayPredictor
from armctl.policies.policy import Actions, ControllersFailed, Policy
from armctl.policies.privilege import channels_read
from armctl.policies.robot_filters import ArmFilterOptions, ArmFilters, Filters, RoverFilterOptions, RoverFilters
from armctl.tasks import BridgeTask, ReachTask


class SafetyFilter:
    """The filter of n worlds, which counts what it changes, and finds out by how much actions are delayed.

    Args:
        env: worlds of armctl's tasks of reaching or of the bridge.
        name: its name in errors.
        chosen: options by name: `ArmFilterOptions` or `RoverFilterOptions`.

    Raises `ConfigurationError` for an environment without a filter, and for a wrong option.

    """

    def __init__(self, env: EpisodeVectorEnv | Interface, name: str, chosen: Mapping[str, Any]) -> None:
        self._filters = _make_filters(env, name, chosen)
        assert isinstance(env, TaskVectorEnv)
        self._shape, self._range = env.single_action_space.shape, np.ptp(env.task.action_range, axis=0)
        self.foresight, self._idle = env.task.foresight, np.array(env.task.idle_action)
        self._delays = DelayPredictor(
            self._filters.fast_law, env.num_envs, self._idle, self._filters.accuracy,
            DelayOptions(max_delay=self._filters.max_delay),
        )  # fmt: skip
        self.interventions = np.zeros(env.num_envs, dtype=np.int64)
        """(n,) number of actions that were changed in each world."""
        self.sizes = np.zeros(env.num_envs)
        """(n,) sum of these changes: the largest of an action's numbers, relative to its range."""

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`."""
        self._filters.reset(ids)
        self._delays.reset(ids)

    @property
    def delay(self) -> NDArray[np.intp]:
        """(n,) control steps by which actions are delayed, as far as robots have shown."""
        return self._delays.delay

    def __call__(self, actions: Any) -> list[Any]:
        """Return n safe actions; invalid ones stay as they are, and are told of by others."""
        states = self._filters.states()
        self._delays.read(states)
        states, sent = self._delays.predict(states, self._filters.law), np.tile(self._idle, (len(states), 1))
        safe = list(actions)
        for i, action in enumerate(actions):
            if np.shape(action) == self._shape and np.isfinite(proposal := np.array(action, dtype=float)).all():
                safe[i] = sent[i] = self._safe(i, proposal, states[i])
        self._delays.send(sent)
        return safe

    def _safe(self, world: int, action: Array, state: Array) -> Array:
        safe = self._filters.act(world, action, state, int(self.delay[world]))
        if safe is not action:
            self.interventions[world] += 1
            self.sizes[world] += (np.abs(safe - action) / self._range).max()
        return safe


def _make_filters(env: EpisodeVectorEnv | Interface, name: str, chosen: Mapping[str, Any]) -> Filters:
    if not isinstance(env, TaskVectorEnv) or not isinstance(env.task, (ReachTask, BridgeTask)):
        raise ConfigurationError(f"{name}: the safety filter is for armctl's own tasks of reaching and of the bridge")
    if env.normalized:
        raise ConfigurationError(f"{name} acts in physical units, not in worlds with actions='normalized'")
    if isinstance(env.task, ReachTask):
        return ArmFilters(env.task, changed_options(ArmFilterOptions(), chosen, f"option of {name}"))
    return RoverFilters(env, changed_options(RoverFilterOptions(), chosen, f"option of {name}"))


class Filtered:
    """A policy whose actions in n worlds pass a filter."""

    sees: Any = "state"

    def __init__(self, policy: Policy, safety_filter: SafetyFilter) -> None:
        self._policy, self._filter = policy, safety_filter
        self.foresight = tuple(dict.fromkeys((*getattr(policy, "foresight", ()), *safety_filter.foresight)))
        self.reads = tuple(dict.fromkeys((*channels_read(policy), "state")))
        self.training_steps = policy.training_steps
        for fact in ("training_minutes", "training_cost", "family", "kind"):
            if hasattr(policy, fact):
                setattr(self, fact, getattr(policy, fact))
        self.interventions, self.intervention_sizes = safety_filter.interventions, safety_filter.sizes

    @property
    def failures(self) -> Any:
        """Number of solver failures in each world, of the policy behind the filter."""
        return getattr(self._policy, "failures", 0)

    def plans(self, world: int) -> Mapping[str, Array]:
        """Return the plans of the policy behind the filter."""
        return dict(getattr(self._policy, "plans", lambda world: {})(world))

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`. Raises what the policy raises."""
        self._filter.reset(ids)
        self._policy.reset(ids)

    def act(self, observations: Observations) -> Actions:
        """Return safe actions (n, ...). Raises what the policy raises."""
        try:
            return np.array(self._filter(self._policy.act(observations)))
        except ControllersFailed as error:
            raise ControllersFailed(error.errors, self._filter(error.actions)) from error


class FilteredWorlds(gymnasium.vector.VectorWrapper[Any, Any, Any, Any, Any]):
    """Worlds that filter the actions of a learner, which so explores without contacts.

    They are made with a vector environment of armctl's, before its first reset, and the filter's options by name.
    Raises `ConfigurationError` as `SafetyFilter` does.
    """

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any], **options: Any) -> None:
        super().__init__(env)
        worlds: Any = env.unwrapped
        self._filter = SafetyFilter(worlds, "filter", options)
        self.executed: NDArray[Any] = np.zeros(env.action_space.shape or ())
        """(n, ...) last actions after the filter."""
        self.changed = np.zeros(env.num_envs, dtype=bool)
        """(n,) whether it has changed them."""
        worlds.observers.append(self)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """The environment's."""
        mode: AutoresetMode = self.env.metadata["autoreset_mode"]
        return mode

    def step(self, actions: ArrayLike) -> Any:
        """Make one control step in every world."""
        previous = self._filter.interventions.copy()
        self.executed = np.array(self._filter(actions))
        self.changed = self._filter.interventions > previous
        return self.env.step(self.executed)

    def began(self, ids: NDArray[np.int32]) -> None:
        """Take note that worlds `ids` have begun a new episode."""
        self._filter.reset(ids)

    def stepped(self, awake: NDArray[np.bool_]) -> None:
        """Take note of a control step."""
