"""Compares an exported agent with the model that it was made from, on observations of their environment."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from armctl.agents import OnnxPolicy
from armctl.core.errors import AgentFileError
from armctl.rl.export.sb3_file import in_a_line

OBSERVATIONS = 1000
NUM_ENVS = 8
RANDOM_SHARE = 0.2
"""Share of actions that are random, so that the episodes leave what the model usually sees."""
SHORTEST = 15
"""Control steps: world i begins a new episode after at most (i + 1) times these, so that memories are forgotten too."""
TOLERANCE = 1e-4
"""Share of the action's range. Rounding in single precision makes 1e-7 to 1e-5; a forgotten normalisation, a wrong
scale or another activation make 1e-2 or more."""
DISCRETE_TOLERANCE = 1e-3
"""Share of observations: rounding decides between two discrete actions that are as good as equal."""


def largest_difference(model: BaseAlgorithm, normalisation: VecNormalize | None, agent: OnnxPolicy, envs: Any) -> float:
    """Return the largest difference between the actions of a model and an agent, on `OBSERVATIONS` observations.

    Of continuous actions, as a share of their range, which Stable-Baselines3 wants to be finite; of discrete ones, the
    share of observations on which they differ. The model plays the episodes, with some random actions.
    """
    n, rng = envs.num_envs, np.random.default_rng(0)
    action_space = envs.single_action_space
    action_space.seed(0)
    episodes, age, limits = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), SHORTEST * (1 + np.arange(n))
    began, state = np.ones(n, dtype=bool), None
    observations, _ = envs.reset(seed=[0] * n, options={"episode": episodes})
    differences: list[NDArray[np.float64]] = []
    for _ in range(-(-OBSERVATIONS // n)):
        agent.reset(np.flatnonzero(began).astype(np.int32))
        normalised = observations if normalisation is None else normalisation.normalize_obs(observations)
        try:
            expected, state = model.predict(normalised, state, began, deterministic=True)
        except Exception as error:  # what a network of somebody's own may raise, or one whose weights are NaN
            raise AgentFileError(f"the model cannot act in this environment: {in_a_line(error)}") from error
        differences.append(_difference(action_space, expected, agent.act(observations)))
        random = rng.random(n) < RANDOM_SHARE
        actions = np.array([action_space.sample() if random[i] else expected[i] for i in range(n)])
        observations, _, terminated, truncated, _ = envs.step(actions)
        age += 1
        began = terminated | truncated | (age >= limits)
        if began.any():
            episodes[began] += 1
            age[began] = 0
            observations, _ = envs.reset(options={"reset_mask": began, "episode": episodes})
    difference = np.concatenate(differences)
    return float(difference.max() if isinstance(action_space, spaces.Box) else difference.mean())


def raise_if_different(difference: float, space: gymnasium.Space[Any]) -> None:
    """Raise `AgentFileError` if a difference is more than rounding."""
    tolerance = TOLERANCE if isinstance(space, spaces.Box) else DISCRETE_TOLERANCE
    if not difference <= tolerance:
        raise AgentFileError(
            f"the exported agent does not act as the model does: their actions differ by {difference:.2g} of "
            f"{'the range' if isinstance(space, spaces.Box) else 'all observations'}, at most {tolerance:g} is rounding"
        )


def _difference(space: gymnasium.Space[Any], expected: NDArray[Any], actual: NDArray[Any]) -> NDArray[np.float64]:
    """Return the largest difference (n,) in each world's action; 1 for another discrete action."""
    n = len(expected)
    if expected.shape != actual.shape:
        raise AgentFileError(f"the exported agent's actions have shape {actual.shape}, the model's {expected.shape}")
    if not isinstance(space, spaces.Box):
        return np.asarray((expected != actual).reshape(n, -1).any(axis=1), dtype=np.float64)
    span = space.high.astype(np.float64) - space.low
    differences = np.abs(expected - actual.astype(np.float64)) / np.where(span > 0, span, 1.0)
    return np.asarray(differences.reshape(n, -1).max(axis=1), dtype=np.float64)
