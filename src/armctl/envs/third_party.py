"""Environments of others: n ordinary Gymnasium environments, played by armctl's rules for episodes.

Episode k of seed s starts with `reset(seed=episode_seed(s, k))`. Success is read by a `SuccessRule`; where an episode
does not tell of it, it is unknown.
"""

import contextlib
import inspect
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any, ClassVar

import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.core.errors import FAILURES, ConfigurationError, EnvironmentFailed, InvalidAction, defined_at, described
from armctl.core.foresight import check_declared
from armctl.disturbances import GENERIC, DisturbanceSpec, disturb, episode_entropy
from armctl.envs import foreign_values
from armctl.envs.environment_options import LARGEST_REWARD
from armctl.envs.episodes import EpisodeVectorEnv, Infos
from armctl.envs.imagined import Imagined, planning_model
from armctl.envs.observations import stacked
from armctl.envs.success import UNSTATED, SuccessReader, SuccessRule
from armctl.kernels.step_end import RUNNING
from armctl.simulation.planning_model import PlanningModel
from armctl.tasks import MotionSample, Observations
from armctl.tasks.task import TaskFacts

LARGEST_SEED = 2**31
"""Bound of the seeds that environments of others are given."""
RENDER_FPS = 25
"""Frames per second of environments that do not say."""
ENDLESS = 100_000
"""Steps after which an episode without a limit is taken for endless."""


def episode_seed(seed: int, episode: int) -> int:
    """Return the seed that starts an episode in an environment of others: of 31 bits, as simulators in C take them."""
    return int(np.random.SeedSequence(episode_entropy(seed, episode)).generate_state(1)[0]) % LARGEST_SEED


class ThirdPartyTask(TaskFacts):
    """Stand-in for a task in an environment of others: what it does not tell is NaN or None."""

    disturbances: ClassVar[Mapping[str, DisturbanceSpec]] = GENERIC
    default_policies: ClassVar[tuple[str, ...]] = ("random",)
    interface: ClassVar[dict[str, str]] = {}
    joints = None

    def __init__(self, env: gymnasium.Env[Any, Any], n: int) -> None:
        self.n = n
        for name in ("observation_space", "action_space"):
            if not isinstance(getattr(env, name, None), spaces.Space):
                raise ConfigurationError(f"{type(env.unwrapped).__name__} has no {name}{defined_at(env.unwrapped)}")
        self.observation_space, self.action_space = env.observation_space, env.action_space
        period = getattr(env.unwrapped, "dt", None)
        self.control_period = float(period) if isinstance(period, (int, float)) and period > 0 else None
        """Seconds between two control steps; None if the environment has no attribute `dt`."""
        self.observations: list[Any] = [_zero(env.observation_space)] * n

    @property
    def idle_action(self) -> Array:
        """The action 0, or what is nearest to it."""
        assert isinstance(self.action_space, spaces.Box)
        return np.clip(np.zeros(self.action_space.shape), self.action_space.low, self.action_space.high)

    def observe(self) -> Observations:
        """Return observations of all worlds, without disturbances."""
        return stacked(self.observations)

    def motion(self) -> MotionSample:
        """Return an unknown motion."""
        return MotionSample(np.full((self.n, 3), np.nan), np.full((self.n, 1), np.nan), None)


class ThirdPartyVectorEnv(EpisodeVectorEnv):
    """n environments of others, stepped one after the other. After an episode, a world stands still until its reset.

    `make` makes one environment. `success` says how success is read from an episode.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "autoreset_mode": AutoresetMode.DISABLED}
    autoreset_mode = AutoresetMode.DISABLED
    outcomes = ("truncated", "terminated", "success", "running")

    def __init__(
        self,
        make: Callable[[], gymnasium.Env[Any, Any]],
        num_envs: int,
        *,
        success: SuccessRule = UNSTATED,
        disturbances: Mapping[str, float | Sequence[float]] = MappingProxyType({}),
    ) -> None:
        super().__init__(num_envs)
        self.worlds = [make() for _ in range(num_envs)]
        first = self.worlds[0]
        self.metadata = self.metadata | {"render_fps": first.metadata.get("render_fps") or RENDER_FPS}
        self.spec, self.render_mode = first.spec, first.render_mode
        limit = getattr(first.unwrapped, "max_episode_steps", None)  # of an environment in another process
        self.max_episode_steps = (first.spec.max_episode_steps if first.spec else None) or limit
        self.task = ThirdPartyTask(first, num_envs)
        self.single_observation_space, self.single_action_space = first.observation_space, first.action_space
        self.disturbances = disturb(self.task, self.task.disturbances, disturbances)
        self.success = success
        self._successes = SuccessReader(success, num_envs, self._name, self.remarks)
        self._is_finite = True
        """False once an observation had a number that is not finite."""
        _check_reset(first.unwrapped)

    def step(self, actions: ArrayLike) -> tuple[Observations, Array, NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Make one step in every world. If an action is invalid, raises `InvalidAction` and steps nothing.

        Raises `EnvironmentFailed` if an environment fails.
        """
        self._check_seeded()
        commands: Any = self._disturbed_commands(self._checked(actions))
        n = self.num_envs
        rewards, outcome = np.zeros(n), np.full(n, RUNNING)
        terminated, truncated = np.zeros((2, n), dtype=bool)
        success: NDArray[np.object_] = np.full(n, None)
        terms: dict[str, Array] = {}
        for i in np.flatnonzero(~self._finished):
            action = commands[i]
            if isinstance(self.single_action_space, spaces.Box):
                action = action.astype(self.single_action_space.dtype)
            with self._wrap_errors(int(i)):
                world = self.worlds[i]
                stepped = foreign_values.parts(world.step(action), foreign_values.STEP, "step", world.unwrapped)
                observed, reward, is_terminated, is_truncated, info = stepped
                rewards[i] = foreign_values.number(reward, "the reward")
                terminated[i] = foreign_values.flag(is_terminated, "terminated")
                truncated[i] = foreign_values.flag(is_truncated, "truncated")
                self._take(int(i), observed)
                for name, value in foreign_values.reward_terms(info).items():
                    terms.setdefault(name, np.zeros(n))[i] = value
            self._steps[i] += 1
            self._check_step(int(i), rewards[i], bool(terminated[i] or truncated[i]))
            self._successes.step(int(i), rewards[i], info)
            if terminated[i] or truncated[i]:
                success[i] = self._successes.success(int(i), info)
                ending = "success" if success[i] else "terminated" if terminated[i] else "truncated"
                outcome[i] = self.outcomes.index(ending)
        self.clock[:] = self._steps
        self._finished |= terminated | truncated
        infos: Infos = {"is_success": success, "outcome_id": outcome, "reward_terms": terms}
        return self._observe(), rewards, terminated, truncated, infos

    def _infos(self) -> Infos:
        n = self.num_envs
        return {"is_success": np.full(n, None), "outcome_id": np.full(n, RUNNING), "reward_terms": {}}

    def render(self) -> tuple[NDArray[np.uint8], ...]:
        """Return images (height, width, 3) of all worlds. Raises `EnvironmentFailed`."""
        frames = []
        for i, world in enumerate(self.worlds):
            with self._wrap_errors(i):
                frames.append(foreign_values.picture(world.render(), world.unwrapped))
        return tuple(frames)

    def limit_answers(self, seconds: float) -> bool:
        """Limit the time of each answer of worlds in other processes; return whether these are in others."""
        remote: list[Any] = [world.unwrapped for world in self.worlds if hasattr(world.unwrapped, "patience")]
        for world in remote:
            world.patience = seconds
        return bool(remote)

    def close_extras(self, **kwargs: Any) -> None:
        """Close all environments."""
        for world in self.worlds:
            try:
                world.close()
            except FAILURES as error:
                warnings.warn(f"{self._name} could not be closed: {described(error)}", stacklevel=2)

    def _begin(self, ids: NDArray[np.int32]) -> None:
        self._successes.begin(ids)
        for i in ids:
            seed = episode_seed(int(self._seeds[i]), int(self._episodes[i]))
            with self._wrap_errors(int(i)):
                world = self.worlds[i]
                start = foreign_values.parts(world.reset(seed=seed), foreign_values.RESET, "reset", world.unwrapped)
                self._take(int(i), start[0])

    def _take(self, i: int, observed: Any) -> None:
        """Take over a copy of a world's observation, with a remark if it has numbers that are not finite."""
        self.task.observations[i] = foreign_values.observation(observed, self.single_observation_space)
        if not self._is_finite or foreign_values.is_finite(self.task.observations[i]):
            return
        self._is_finite = False
        self.remarks[
            f"Some observations of {self._name} are not finite (NaN or infinite): policies get them as they are."
        ] = None

    def _observe(self) -> Observations:
        return self._disturbed_observations(self.task.observe())

    def _checked(self, actions: Any) -> Any:
        """Return actions that are in the action space; boxes only by shape, since many environments clip."""
        space, n = self.single_action_space, self.num_envs
        if isinstance(space, spaces.Box):
            return self._checked_numbers(actions)
        if isinstance(space, spaces.Discrete):
            actions = [_whole(action) for action in actions]
        if len(actions) != n:
            raise InvalidAction(f"{len(actions)} actions, {list(actions)!r}, are not {n} of {space}")
        if outside := {
            i: f"its action {action!r} is not of {space}" for i, action in enumerate(actions) if action not in space
        }:
            raise InvalidAction(f"actions {list(actions)!r} are not {n} of {space}", outside)
        return actions

    def _check_step(self, i: int, reward: float, finished: bool) -> None:
        if not abs(reward) <= LARGEST_REWARD:
            raise EnvironmentFailed(
                f"{self._name} returned the reward {reward} in step {self._steps[i]} of episode {self._episodes[i]}"
            )
        if not finished and self.max_episode_steps is None and self._steps[i] >= ENDLESS:
            raise EnvironmentFailed(
                f"episode {self._episodes[i]} of {self._name} has not ended after {ENDLESS:,} steps: limit them, "
                "such as by --set max_episode_steps=1000"
            )

    def imagined(self, world: int) -> Imagined:
        """Return a copy of a world's environment, with its present state, to plan in.

        Raises `ConfigurationError` if it cannot be copied, and for a policy that does not declare the foresight
        `simulator`.
        """
        if self.task.granted is not None:
            check_declared("simulator", "state", self.task.granted)
        return Imagined(self.worlds[world].unwrapped)

    def _nominal_model(self) -> mujoco.MjModel | None:
        model = None
        with contextlib.suppress(*FAILURES):  # whatever an environment of others calls its model
            model = self.worlds[0].unwrapped.model  # type: ignore[attr-defined]
        return model if isinstance(model, mujoco.MjModel) else None

    def _planning_model(self) -> PlanningModel:
        world, space = self.worlds[0].unwrapped, self.single_action_space
        return planning_model(world, space, self.control_period, self._nominal_model())

    @property
    def _name(self) -> str:
        return self.spec.id if self.spec else type(self.worlds[0].unwrapped).__name__

    @contextmanager
    def _wrap_errors(self, i: int) -> Iterator[None]:
        where = f"{self._name} failed in episode {self._episodes[i]}"
        try:
            yield
        except EnvironmentFailed as error:
            raise EnvironmentFailed(f"{where}: {error}") from error
        except FAILURES as error:
            raise EnvironmentFailed(f"{where}: {described(error)}") from error


def _check_reset(env: Any) -> None:
    """Raise `ConfigurationError` if an environment cannot be told the seed of an episode."""
    try:
        parameters = inspect.signature(env.reset).parameters
    except (TypeError, ValueError):
        return
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    if "seed" not in parameters and not takes_any:
        raise ConfigurationError(
            f"{type(env).__name__}.reset takes no seed, so that no episode could be repeated: it has to take the "
            f"keyword arguments seed and options{defined_at(env)}"
        )


def _whole(action: Any) -> Any:
    """Return a discrete action as an int, even if it came as a float array."""
    array = np.asarray(action)
    number = array.item() if array.size == 1 else action
    return int(number) if isinstance(number, float) and number.is_integer() else number


def _zero(space: spaces.Space[Any]) -> Any:
    """Return an observation of the right shape, for before the first reset."""
    if isinstance(space, spaces.Dict):
        return {name: _zero(part) for name, part in space.spaces.items()}
    if isinstance(space, (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)):
        return np.zeros(space.shape or (), dtype=space.dtype)
    return None
