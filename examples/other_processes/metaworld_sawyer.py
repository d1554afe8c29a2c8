"""Meta-World 3.1's Sawyer, its scripted experts, and SAC agents, as another Python plays them.

    python metaworld_sawyer.py reach-v3    # trains reach-v3.zip with Stable-Baselines3

Meta-World's own environments ignore the seed of `reset`. Here it draws the goal, among the 50 of the benchmark MT1, on
which Meta-World trains and evaluates. Success is `info["success"]`, in any step of an episode.
"""

import argparse
from functools import partial

import gymnasium
import metaworld
import numpy as np
from metaworld.policies import SawyerPushV3Policy, SawyerReachV3Policy

STEPS = {"reach-v3": 100, "push-v3": 200}
"""Control steps of an episode; those of Meta-World have 500."""
HAND, OBJECT, GOAL = slice(0, 3), slice(4, 7), slice(36, 39)
"""Places (m) in an observation of Meta-World's."""
GRIPPER = 3
TRAINING = 10_000
"""Control steps of a training."""
METRES = 0.1
"""Unit of the agents' distances: those of a network are about one."""


class Sawyer(gymnasium.Wrapper):
    """A task of Meta-World, the goal of which is drawn by the seed."""

    def __init__(self, name, render_mode=None):
        benchmark = metaworld.MT1(name, seed=0)
        task = benchmark.train_classes[name]
        super().__init__(task(render_mode=render_mode))
        self.tasks, self.rng = benchmark.train_tasks, np.random.default_rng(0)
        self.max_episode_steps = STEPS[name]

    def reset(self, *, seed=None, options=None):
        """Begin an episode."""
        if seed is not None:
            self.rng = np.random.default_rng(seed)
        task = self.tasks[self.rng.integers(len(self.tasks))]
        self.unwrapped.set_task(task)
        self.steps = 0
        return self.env.reset(seed=seed)

    def step(self, action):
        """Make a control step."""
        observation, reward, terminated, _, info = self.env.step(action)
        self.steps += 1
        is_over = self.steps >= self.max_episode_steps
        return observation, reward, terminated, is_over, info


reach, push = (partial(Sawyer, name) for name in STEPS)


class Expert:
    """A scripted expert, whose actions Meta-World would clip."""

    policy = SawyerReachV3Policy

    def __init__(self):
        self.expert = self.policy()

    def act(self, observation):
        """Return the action for an observation."""
        return self.expert.get_action(observation).clip(-1, 1)


class ReachExpert(Expert):
    """That of reach."""


class PushExpert(Expert):
    """That of push."""

    policy = SawyerPushV3Policy


def features(observation):
    """Distances of hand, object and goal, and the opening of the gripper."""
    hand, thing, goal = (observation[part] for part in (HAND, OBJECT, GOAL))
    distances = np.concatenate([goal - hand, thing - hand, goal - thing])
    return np.append(distances / METRES, observation[GRIPPER]).astype(
        np.float32
    )


class Agent:
    """The agent that this file has trained."""

    name, kind = "reach-v3", "learned"
    training_steps = TRAINING

    def __init__(self):
        from stable_baselines3 import SAC

        self.model = SAC.load(f"{self.name}.zip", device="cpu")

    def act(self, observation):
        """Return the action for an observation."""
        return self.model.predict(features(observation), deterministic=True)[0]


class ReachAgent(Agent):
    """That of reach."""


class PushAgent(Agent):
    """That of push."""

    name = "push-v3"


def train(name, steps, seed):
    """Train an agent on one core, and save it."""
    import torch
    from stable_baselines3 import SAC
    from stable_baselines3.common.monitor import Monitor

    torch.set_num_threads(1)
    space = gymnasium.spaces.Box(-np.inf, np.inf, (10,), np.float32)
    env = gymnasium.wrappers.TransformObservation(Sawyer(name), features, space)
    model = SAC(
        "MlpPolicy",
        Monitor(env, info_keywords=("success",)),
        gamma=0.95,
        learning_rate=1e-3,
        learning_starts=1_000,
        policy_kwargs={"net_arch": [128, 128]},
        seed=seed,
        device="cpu",
        verbose=1,
    )
    model.learn(steps, log_interval=10)
    model.save(f"{name}.zip")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("name", choices=STEPS)
    parser.add_argument("--steps", type=int, default=TRAINING)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    train(given.name, given.steps, given.seed)
