"""Protocols of policies: a policy acts in n worlds at once, or consists of one controller for each."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Observations
from armctl.core.errors import FAILURES, ArmctlError, Disqualified, described
from armctl.envs import Sees, one_of

Actions = NDArray[np.floating[Any]]


@runtime_checkable
class Policy(Protocol):
    """Acts in n worlds at once.

    Four attributes are optional, and go into the results: `failures` (n,), the number of times that its solver has
    failed in each world, `training_minutes`, `training_cost`, an `armctl.agents.costs.TrainingCost`, and `family`, the
    kind of method by which a suite ranks policies of several tasks together, such as `MPC`. A fifth, `reads`, names
    which of `observation` and `state` its actions depend on, if that is not what it declares to see: a disturbance of
    what it does not read spares it.
    """

    sees: Sees
    """Privilege (see `armctl.sees`). The policy's maker has to declare it beforehand."""
    training_steps: int
    """Environment steps of its training; 0 for a policy that was not trained."""

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`."""

    def act(self, observations: Observations) -> Actions:
        """Return actions (n, ...) for the observations (n, ...) of all worlds."""


@runtime_checkable
class Plans(Protocol):
    """A policy that can show its plans."""

    def plans(self, world: int) -> Mapping[str, NDArray[np.float64]]:
        """Return polylines by name, (m, 3) m: the `path` it follows, the `horizon` it predicts; none without a plan."""


@dataclass(frozen=True)
class Code:
    """Identity of code that only another process has imported: see `armctl.runtime.identity`."""

    objects: str
    code: dict[str, str] = field(default_factory=dict)
    loaded: dict[str, str] = field(default_factory=dict)


@runtime_checkable
class PlaysApart(Protocol):
    """A policy that plays in another process: it has no world here."""

    code: Code | None
    """Identity of code that only that process has imported; None: all of it is known here."""
    patience: float
    """Time that the process may take for an answer, s."""
    seconds: float
    """Duration of the last call, as measured in that process."""

    def close(self) -> None:
        """End the process, or the connection to it."""


class Controller(Protocol):
    """Acts in one world."""

    def reset(self) -> None:
        """Begin a new episode."""

    def act(self, observation: Any) -> Actions:
        """Return the action for one world's observation."""


class ControllersFailed(ArmctlError):
    """Controllers of some worlds have raised errors. The controllers of all other worlds have worked."""

    def __init__(self, errors: Mapping[int, BaseException], actions: Sequence[Any] = ()) -> None:
        self.first = next(iter(errors.values()))
        super().__init__(described(self.first))
        self.errors = dict(errors)
        """By world."""
        self.actions = actions
        """(n, ...), None in the worlds with errors."""


PolicyFactory = Callable[[Any], Policy]
"""Makes a policy from what it may know of an environment: see `armctl.sees`."""


class PerWorld:
    """A policy that consists of one controller for each world.

    `prepared` ones identify the robot by their own commands: they label no states into which others steer.
    """

    training_steps = 0

    def __init__(
        self, controllers: Sequence[Controller], sees: Sees = "observation", *, prepared: bool = False
    ) -> None:
        self.controllers = controllers
        self.sees = sees
        self.prepared = prepared
        self._actions: Sequence[Any] = [None] * len(controllers)
        self._idle: set[int] = set()

    @property
    def num_acting(self) -> int:
        """Number of worlds whose controllers decide."""
        return len(self.controllers) - len(self._idle)

    @property
    def failures(self) -> NDArray[np.int64]:
        """(n,) number of solver failures of each controller; 0 for controllers that do not count them."""
        return np.array([getattr(controller, "failures", 0) for controller in self.controllers])

    def plans(self, world: int) -> Mapping[str, NDArray[np.float64]]:
        """Return the plans of the world's controller; none if it does not have the method `plans`."""
        return dict(getattr(self.controllers[world], "plans", dict)())

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`. Raises `ControllersFailed`."""
        self._idle.difference_update(ids.tolist())
        self._each(ids.tolist(), self._reset_one)

    def idle(self, ids: NDArray[np.integer[Any]]) -> None:
        """Let worlds `ids`, whose episodes are over, repeat their last actions until their `reset`."""
        self._idle.update(i for i in ids.tolist() if self._actions[i] is not None)

    def act(self, observations: Observations) -> Actions:
        """Return each controller's action for its own observation. Raises `ControllersFailed`."""

        def act_or_repeat(world: int) -> Any:
            return self._actions[world] if world in self._idle else self._act_one(world, observations)

        try:
            actions = self._each(range(len(self.controllers)), act_or_repeat)
        except ControllersFailed as failure:
            self._keep(failure.actions)
            raise
        self._keep(actions)
        return self._batch(actions)

    def _keep(self, actions: Sequence[Any]) -> None:
        """Keep the last action of each world that has had one."""
        self._actions = [old if new is None else new for new, old in zip(actions, self._actions, strict=True)]

    def _reset_one(self, world: int) -> None:
        self.controllers[world].reset()

    def _act_one(self, world: int, observations: Observations) -> Any:
        return self.controllers[world].act(one_of(observations, world))

    def _batch(self, actions: list[Any]) -> Actions:
        """Return actions of all worlds, (n, ...)."""
        return np.array(actions)

    @staticmethod
    def _each(worlds: Iterable[int], do: Callable[[int], Any]) -> list[Any]:
        """Return what `do` returns for each of the worlds. An error in one of them does not concern the others."""
        results, errors = [], dict[int, BaseException]()
        for i in worlds:
            try:
                results.append(do(i))
            except Disqualified:
                raise
            except FAILURES as error:
                results.append(None)
                errors[i] = error
        if errors:
            raise ControllersFailed(errors, results) from next(iter(errors.values()))
        return results
