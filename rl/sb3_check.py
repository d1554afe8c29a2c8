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
from armctl.rl.sb3_file import in_a_line

OBSERVATIONS = 1000
WORLDS = 8
RANDOM_SHARE = 0.2
"""Share of actions that are random, so that the episodes leave what the model usually sees."""
SHORTEST = 15
"""World i begins a new episode after at most (i + 1) times so many steps, so that memories are forgotten too."""
TOLERANCE = 1e-4
"""Share of the action's range. Rounding in single precision makes 1e-7 to 1e-5; a forgotten normalisation, a wrong
scale or another activation make 1e-2 or more."""
DISCRETE_TOLERANCE = 1e-3
"""Share of observations: rounding decides between two discrete actions that are as good as equal."""


def largest_difference(
    model: BaseAlgorithm, normalisation: VecNormalize | None, agent: OnnxPolicy, worlds: Any
) -> float:
    """Largest difference between the actions of a model and an agent, on `OBSERVATIONS` observations.

    Of continuous actions, as a share of their range, which Stable-Baselines3 wants to be finite; of discrete ones, the
    share of observations on which they differ. The model plays the episodes, with some random actions.
    """
    n, rng = worlds.num_envs, np.random.default_rng(0)
    commanded = worlds.single_action_space
    commanded.seed(0)
    episodes, age, limits = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), SHORTEST * (1 + np.arange(n))
    began, state = np.ones(n, dtype=bool), None
    observations, _ = worlds.reset(seed=[0] * n, options={"episode": episodes})
    differences: list[NDArray[np.float64]] = []
    for _ in range(-(-OBSERVATIONS // n)):
        agent.reset(np.flatnonzero(began).astype(np.int32))
        shown = observations if normalisation is None else normalisation.normalize_obs(observations)
        try:
            wanted, state = model.predict(shown, state, began, deterministic=True)
        except Exception as error:  # what a network of somebody's own may raise, or one whose weights are NaN
            raise AgentFileError(f"the model cannot act in this environment: {in_a_line(error)}") from error
        differences.append(_difference(commanded, wanted, agent.act(observations)))
        random = rng.random(n) < RANDOM_SHARE
        played = np.array([commanded.sample() if random[i] else wanted[i] for i in range(n)])
        observations, _, terminated, truncated, _ = worlds.step(played)
        age += 1
        began = terminated | truncated | (age >= limits)
        if began.any():
            episodes[began] += 1
            age[began] = 0
            observations, _ = worlds.reset(options={"reset_mask": began, "episode": episodes})
    found = np.concatenate(differences)
    return float(found.max() if isinstance(commanded, spaces.Box) else found.mean())


def check_alike(difference: float, space: gymnasium.Space[Any]) -> None:
    """Raise `AgentFileError` if a difference is more than rounding."""
    tolerance = TOLERANCE if isinstance(space, spaces.Box) else DISCRETE_TOLERANCE
    if not difference <= tolerance:
        raise AgentFileError(
            f"the exported agent does not act as the model does: their actions differ by {difference:.2g} of "
            f"{'the range' if isinstance(space, spaces.Box) else 'all observations'}, at most {tolerance:g} is rounding"
        )


def _difference(space: gymnasium.Space[Any], wanted: NDArray[Any], found: NDArray[Any]) -> NDArray[np.float64]:
    """(n,) largest difference in each world's action; 1 for another discrete action."""
    n = len(wanted)
    if wanted.shape != found.shape:
        raise AgentFileError(f"the exported agent's actions have shape {found.shape}, the model's {wanted.shape}")
    if not isinstance(space, spaces.Box):
        return np.asarray((wanted != found).reshape(n, -1).any(axis=1), dtype=np.float64)
    span = space.high.astype(np.float64) - space.low
    differences = np.abs(wanted - found.astype(np.float64)) / np.where(span > 0, span, 1.0)
    return np.asarray(differences.reshape(n, -1).max(axis=1), dtype=np.float64)
