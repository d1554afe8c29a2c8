"""A task as a Gymnasium vector environment: n worlds, stepped at once.

Environment id, options, seed and episode number determine an episode. World i of a vector environment that was reset
with `seed` plays the episodes of a single environment that was reset with `seed + i`, bit for bit.
"""

import copy
from typing import Any, Protocol

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError, EnvironmentFailed, unknown_name
from armctl.core.options import make_options
from armctl.core.registration import load_task
from armctl.disturbances import disturb, episode_entropy
from armctl.envs.environment_options import LARGEST_REWARD, NAMES, check_at_least_one, split_options
from armctl.envs.episodes import EpisodeVectorEnv, Infos
from armctl.envs.observations import with_replaced
from armctl.envs.outcomes import ERROR, UNSTABLE
from armctl.envs.pickling import MadeAgain
from armctl.kernels.compiling import Bound, bound
from armctl.kernels.step_end import RUNNING, Episodes, Rules, StepResults, end_step
from armctl.simulation.planning_model import PlanningModel, rescaled
from armctl.simulation.rendering import Camera, Window
from armctl.tasks import Observations, RewardTerms, Task

RENDER_MODES = ("rgb_array", "human")
UNLIMITED = np.iinfo(np.int64).max
"""Control steps of an episode without a limit."""
GOAL_METHODS = ("compute_reward", "compute_terminated", "compute_truncated")
"""Methods that goal-conditioned learners ask for: functions of achieved goals, desired goals and infos."""


class Observer(Protocol):
    """Callbacks of a vector environment. They see final states too, before an autoreset replaces them."""

    def began(self, ids: NDArray[np.int32]) -> None:
        """Take note that worlds `ids` have begun a new episode."""

    def stepped(self, awake: NDArray[np.bool_]) -> None:
        """Take note of a control step of the worlds in the mask `awake` (n,); none has been reset yet."""


class TaskVectorEnv(MadeAgain, EpisodeVectorEnv, gymnasium.vector.VectorEnv[Any, Any, Any]):
    """n worlds of one task.

    An episode whose physics fails (infinite numbers, or none) terminates with the outcome `unstable`, which is no
    success and earns nothing in its last step. Its last observation is of the last good state.

    Args:
        num_envs: number of worlds.
        task: subclass of `armctl.tasks.Task`, or its `module:Class`.
        render_mode: `rgb_array` (images of all worlds), `human` (a window on the first), or None.
        autoreset_mode: after an episode, a new one starts on the next step (`next_step`), on the same step
            (`same_step`, with `infos["final_obs"]` and `infos["final_info"]`), or not at all (`disabled`: the world
            stands still until a `reset` whose `options["reset_mask"]` includes it).
        threads: threads to step the worlds on; 0 for all cores.
        **options: those of every environment (`EnvironmentOptions`), and the task's; those of `armctl/ArmReach-v0` are
            `armctl.tasks.ReachOptions`.

    """

    metadata: dict[str, Any] = {
        "render_modes": list(RENDER_MODES),
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    single_observation_space: gymnasium.spaces.Space[Any]
    single_action_space: gymnasium.spaces.Box

    def __init__(
        self,
        num_envs: int = 1,
        *,
        task: str | type[Task],
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 0,
        **options: Any,
    ) -> None:
        check_at_least_one("num_envs", num_envs)
        super().__init__(int(num_envs))
        general, task_values = split_options(options)
        self.reward_scale, self.reward_weights = general.reward_scale, dict(general.reward_weights)
        self.flat_infos, steps = general.flat_infos, general.max_episode_steps
        self.max_episode_steps = None if steps is None else int(steps)
        if render_mode not in (None, *RENDER_MODES):
            raise unknown_name("render_mode", render_mode, RENDER_MODES)
        if not isinstance(threads, int) or threads < 0:
            raise ConfigurationError(f"threads is a whole number, 0 for all cores, not {threads!r}")
        self.render_mode = render_mode
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        task_type: type[Task] = load_task(task)
        _check_complete(task_type)
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode, "render_fps": task_type.render_fps}
        make_task: Any = task_type
        task_options = make_options(task_type.options_type, task_values, others=sorted(NAMES))
        self.task = make_task(self.num_envs, task_options, threads)
        self.remarks |= dict.fromkeys(self.task.notes)
        self.outcomes = (*(outcome.label for outcome in task_type.outcomes), UNSTABLE, "running")
        self.disturbances = disturb(self.task, task_type.disturbances, general.disturbances)
        self.single_observation_space = self.task.observation_space
        self.single_action_space = self.task.action_space
        self.normalized = general.actions == "normalized"
        if self.normalized:
            self._lowest, self._highest = (np.asarray(bound, dtype=float) for bound in self.task.action_range)
            if not (np.isfinite(self._lowest).all() and np.isfinite(self._highest).all()):
                raise ConfigurationError("actions of this task cannot be normalized: they have no finite action_range")
            self.single_action_space = gymnasium.spaces.Box(-1, 1, self.task.action_space.shape, dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._viewer: Camera | Window | None = None
        self.observers: list[Observer] = []
        self._set_reward_names(tuple(self.task.reward_functions))
        if getattr(task_options, "goal", False):
            if self.reward_weights:
                raise ConfigurationError("with goal=True, the reward is the task's own: leave reward_weights out")
            for name in GOAL_METHODS:
                setattr(self, name, getattr(self.task, name))
            self.compute_reward = lambda *goals: self.reward_scale * self.task.compute_reward(*goals)

    @property
    def idle_action(self) -> Array:
        """The action that leaves the robot where it starts, or the nearest that there is."""
        idle = super().idle_action
        if not self.normalized:
            return idle
        middle, span = (self._lowest + self._highest) / 2, (self._highest - self._lowest) / 2
        return np.asarray(np.clip((idle - middle) / span, -1, 1))

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Start new episodes, as in `EpisodeVectorEnv.reset`."""
        if not self._reward_names:  # only the task's own code knows them, and it may have none before a reset
            everywhere = np.arange(self.num_envs, dtype=np.int32)
            self.task.reset(everywhere, [np.random.default_rng(0) for _ in everywhere])
            self._set_reward_names(tuple(self.task.reward_terms()))
        return super().reset(seed=seed, options=options)

    def step(self, actions: ArrayLike) -> tuple[Observations, Array, NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Make one control step in every world. If an action is invalid, raises `InvalidAction` and steps nothing."""
        self._check_seeded()
        standing = np.flatnonzero(self._finished)
        self._advance(self._checked_numbers(actions))
        results = self._results
        rewards, (terminated, truncated, successes) = results.rewards.copy(), results.ends.copy()
        infos = self._step_infos(successes, results.outcomes.copy(), results.terms.copy()) | self._task_info()
        if self.autoreset_mode is AutoresetMode.NEXT_STEP and len(standing):
            self._begin_next(standing)
            infos |= self._task_info()
        observations = self._observe()
        if self.autoreset_mode is AutoresetMode.SAME_STEP and (finished := terminated | truncated).any():
            infos |= {
                "final_obs": observations,
                "_final_obs": finished,
                "final_info": infos | {f"_{key}": finished for key in infos},
                "_final_info": finished,
            }
            ids = np.flatnonzero(finished).astype(np.int32)
            self._begin_next(ids)
            infos |= self._task_info()
            observations = with_replaced(observations, ids, self._observe(ids))
        return observations, rewards, terminated, truncated, infos

    def render(self) -> Any:
        """Return images (height, width, 3) of all worlds. The mode `human` shows the first, and returns None."""
        simulation = self.task.simulation
        if self.render_mode is None:
            raise ConfigurationError("nothing to render: make the environment with render_mode='rgb_array' or 'human'")
        if self._viewer is None:
            human = self.render_mode == "human"
            self._viewer = Window(simulation.model) if human else Camera(simulation.model, self.task.camera)
        if isinstance(self._viewer, Window):
            self._viewer.show(simulation.data(0))
            return None
        return tuple(self._viewer.picture(simulation.data(i)) for i in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window and free graphics memory."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def _advance(self, actions: Array) -> None:
        """Make a control step where an episode goes on, and write `_results`. Raises `EnvironmentFailed`."""
        awake = ~self._finished
        are_all_awake = np.count_nonzero(awake) == self.num_envs
        self.task.command(self._disturbed_commands(self._physical(actions)))
        self.task.advance(None if are_all_awake else np.flatnonzero(awake).astype(np.int32))
        terms, outcomes, results = self.task.reward_terms(), np.asarray(self.task.outcome()), self._results
        if tuple(terms) != self._reward_names or outcomes.shape != results.outcomes.shape:
            raise EnvironmentFailed(
                f"the task's reward terms are {', '.join(terms)} and its outcomes {outcomes.shape}; expected "
                f"{', '.join(self._reward_names)} and {results.outcomes.shape}"
            )
        for row, term in zip(results.terms, terms.values(), strict=True):
            row[...] = term
        results.outcomes[...] = outcomes
        if not end_step(self._bound):
            self._refuse(outcomes, dict(zip(terms, results.terms, strict=True)))
        for observer in self.observers:
            observer.stepped(awake)

    def _infos(self) -> Infos:
        terms = np.zeros((len(self._reward_names), self.num_envs))
        successes, outcomes = np.zeros(self.num_envs, dtype=bool), np.full(self.num_envs, RUNNING)
        return self._step_infos(successes, outcomes, terms) | self._task_info()

    def _step_infos(self, successes: Any, outcomes: Any, terms: Any) -> Infos:
        """Return infos of all worlds or of one: whether they end with success, their outcomes, and the terms (k,)."""
        rewards = {"reward_terms": dict(zip(self._reward_names, terms, strict=True))}
        return {
            "is_success": successes,
            "outcome_id": outcomes,
            **(_flat(rewards) if self.flat_infos else rewards),
        }

    def _task_info(self) -> Infos:
        return _flat(self.task.info()) if self.flat_infos else self.task.info()

    def _nominal_model(self) -> mujoco.MjModel:
        return self.task.simulation.nominal_model

    def _planning_model(self) -> PlanningModel:
        task, space = self.task, self.single_action_space
        units = (self._lowest, self._highest) if self.normalized else None
        return PlanningModel(
            copy.copy(self._nominal_model()), task.control_period, (space.low, space.high), task.rollout_worlds, units
        )  # fmt: skip

    def _physical(self, actions: Array) -> Array:
        """Return actions in the task's units."""
        if not self.normalized:
            return actions
        return rescaled(actions, self._lowest, self._highest)

    def _begin(self, ids: NDArray[np.int32]) -> None:
        numbers = zip(self._seeds[ids].tolist(), self._episodes[ids].tolist(), strict=True)
        rngs = [np.random.default_rng(episode_entropy(seed, episode)) for seed, episode in numbers]
        self._paid_terms[:, ids] = False
        self.task.reset(ids, rngs)
        for observer in self.observers:
            observer.began(ids)

    def _observe(self, ids: NDArray[np.int32] | None = None) -> Observations:
        return self._disturbed_observations(self.task.observe(ids), slice(None) if ids is None else ids)

    def _set_reward_names(self, names: tuple[str, ...]) -> None:
        for name in self.reward_weights if names else ():
            if name not in names:
                raise unknown_name("reward term", name, names)
        outcomes = type(self.task).outcomes
        rules = Rules(
            np.array([name in self.task.paid_once for name in names], dtype=bool),
            np.array([self.reward_weights.get(name, 1.0) for name in names], dtype=float),
            float(self.reward_scale),
            LARGEST_REWARD,
            UNLIMITED if self.max_episode_steps is None else self.max_episode_steps,
            self.outcomes.index(UNSTABLE),
            np.array([*(outcome.success for outcome in outcomes), False], dtype=bool),
        )
        n, unstable = self.num_envs, self.task.simulation.unstable
        self._reward_names, self._paid_terms = names, np.zeros((len(names), n), dtype=bool)
        self._results = StepResults(
            np.zeros((len(names), n)), np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros((3, n), dtype=bool)
        )
        episodes = Episodes(self._steps, self.clock, self._finished, unstable, self._paid_terms)
        self._bound: Bound = bound((episodes, rules, self._results))

    def _refuse(self, outcomes: NDArray[np.int64], terms: RewardTerms) -> None:
        """Raise `EnvironmentFailed` for a term that is too large or not a number, or an outcome that there is not."""
        for name, rewards in terms.items():
            if not (fine := np.abs(rewards) <= LARGEST_REWARD).all():
                i = int(np.flatnonzero(~fine)[0])
                raise EnvironmentFailed(
                    f"the reward term {name!r} is {rewards[i]} in step {self._steps[i]} of episode {self._episodes[i]}"
                )
        raise EnvironmentFailed(f"an outcome is none of {', '.join(self.outcomes[:-1])}: {outcomes.tolist()}")


def _flat(infos: Infos, prefix: str = "") -> Infos:
    """Return infos in which dicts are replaced by what they hold: `a/b` in place of `b` in `a`."""
    flat: Infos = {}
    for name, value in infos.items():
        flat |= _flat(value, f"{prefix}{name}/") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return flat


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    if isinstance(mode, AutoresetMode):
        return mode
    if mode.upper() not in AutoresetMode.__members__:
        raise unknown_name("autoreset_mode", mode, [name.lower() for name in AutoresetMode.__members__])
    return AutoresetMode[mode.upper()]


def _check_complete(task_type: type[Task]) -> None:
    if not (isinstance(task_type, type) and issubclass(task_type, Task)):
        raise ConfigurationError(f"a task is a subclass of armctl.Task, not {task_type!r}")
    if taken := {ERROR, UNSTABLE, "running"} & {outcome.label for outcome in getattr(task_type, "outcomes", ())}:
        raise ConfigurationError(f"outcomes of {task_type.__name__} need other labels: armctl uses {', '.join(taken)}")
    missing = sorted(task_type.__abstractmethods__)
    missing += [name for name in ("outcomes",) if not hasattr(task_type, name)]
    if missing:
        raise ConfigurationError(f"the task {task_type.__name__} lacks {', '.join(missing)}")
