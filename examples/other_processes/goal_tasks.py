"""Reach and push of Gymnasium-Robotics (Fetch) and panda-gym (Panda).

Another Python plays them, with scripted experts, and SAC agents with hindsight
that this file has trained by the settings of RL Zoo for FetchReach.

    python goal_tasks.py FetchReach    # trains FetchReach.zip

Success is `info["is_success"]` at the end of an episode of 50 control steps.
"""

import argparse
from functools import partial

import gymnasium
import numpy as np

IDS = {
    "FetchReach": ("gymnasium_robotics", "FetchReach-v4"),
    "FetchPush": ("gymnasium_robotics", "FetchPush-v4"),
    "PandaReach": ("panda_gym", "PandaReach-v3"),
    "PandaPush": ("panda_gym", "PandaPush-v3"),
}
"""Module and id of each task."""
TRAINING = {"Reach": 20_000, "Push": 200_000}
"""Control steps of a training."""
STEP = 0.05
"""m that the hand moves in a control step for an action of 1, in all."""
HALF = {"Fetch": 0.025, "Panda": 0.02}
"""Half of the edge of the pushed cube, m."""
UP = np.array([0.0, 0.0, 1.0])
ABOVE, BESIDE = 0.1, 0.02
"""m: hand over the cube on its way round it, and room between both."""


class Task(gymnasium.Wrapper):
    """A task whose episodes have 50 control steps."""

    max_episode_steps = 50

    def __init__(self, name, render_mode=None):
        module, env = IDS[name]
        gymnasium.register_envs(__import__(module))
        made = gymnasium.make(
            env, max_episode_steps=-1, render_mode=render_mode
        )
        super().__init__(made)

    def reset(self, *, seed=None, options=None):
        """Begin an episode."""
        self.steps = 0
        return self.env.reset(seed=seed, options=options)

    def step(self, action):
        """Make a control step."""
        observation, reward, terminated, _, info = self.env.step(action)
        self.steps += 1
        return (
            observation,
            float(reward),
            bool(terminated),
            self.steps >= self.max_episode_steps,
            info,
        )


fetch_reach, fetch_push = (partial(Task, f"Fetch{t}") for t in TRAINING)
panda_reach, panda_push = (partial(Task, f"Panda{t}") for t in TRAINING)


def towards(point, hand, size):
    """Return the action that moves the hand to a point."""
    action = np.zeros(size)
    action[:3] = (point - hand) / STEP
    return action.clip(-1, 1)


class FetchReachExpert:
    """Moves straight to the goal."""

    size = 4

    def act(self, observation):
        """Return the action for an observation."""
        hand = observation["achieved_goal"]
        return towards(observation["desired_goal"], hand, self.size)


class FetchPushExpert:
    """Goes round the cube, comes down behind it, and pushes it."""

    size, half = 4, HALF["Fetch"]

    def act(self, observation):
        """Return the action for an observation."""
        hand = observation["observation"][:3]
        cube, goal = observation["achieved_goal"], observation["desired_goal"]
        way = (goal - cube)[:2]
        distance = np.linalg.norm(way)
        if distance < self.half / 5:
            return towards(hand, hand, self.size)
        way = np.append(way / distance, 0.0)
        offset = hand - cube
        along = offset @ way
        aside = np.linalg.norm((offset - along * way)[:2])
        room = self.half + BESIDE
        is_behind = along < 0 and aside < self.half
        if is_behind and offset[2] < self.half:
            ahead = min(distance, STEP / 2)
            point = (
                cube + (ahead - self.half) * way - 0.5 * (offset - along * way)
            )
            return towards(point, hand, self.size)
        behind = cube - 1.5 * room * way
        at_place = np.linalg.norm((hand - behind)[:2]) < self.half
        height = 0.0 if at_place else ABOVE
        if not at_place and offset[2] < ABOVE / 2:
            return towards(hand + ABOVE * UP, hand, self.size)
        return towards(behind + height * UP, hand, self.size)


class PandaReachExpert(FetchReachExpert):
    """The same for Panda."""

    size = 3


class PandaPushExpert(FetchPushExpert):
    """The same for Panda."""

    size, half = 3, HALF["Panda"]


class Agent:
    """The agent that this file has trained."""

    kind = "learned"
    name = "FetchReach"

    def __init__(self):
        from stable_baselines3 import SAC

        env = Task(self.name)
        self.model = SAC.load(f"{self.name}.zip", env, device="cpu")
        self.training_steps = int(self.model.num_timesteps)

    def act(self, observation):
        """Return the action for an observation."""
        return self.model.predict(observation, deterministic=True)[0]


class FetchReachAgent(Agent):
    """That of FetchReach."""


class FetchPushAgent(Agent):
    """That of FetchPush."""

    name = "FetchPush"


class PandaReachAgent(Agent):
    """That of PandaReach."""

    name = "PandaReach"


class PandaPushAgent(Agent):
    """That of PandaPush."""

    name = "PandaPush"


def train(name, steps, seed):
    """Train an agent on one core, and save it."""
    import torch
    from stable_baselines3 import SAC, HerReplayBuffer
    from stable_baselines3.common.monitor import Monitor

    torch.set_num_threads(1)
    env = Monitor(Task(name), info_keywords=("is_success",))
    model = SAC(
        "MultiInputPolicy",
        env,
        buffer_size=1_000_000,
        batch_size=256,
        gamma=0.95,
        learning_rate=1e-3,
        learning_starts=1_000,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={
            "goal_selection_strategy": "future",
            "n_sampled_goal": 4,
        },
        policy_kwargs={"net_arch": [64, 64] if "Reach" in name else [128, 128]},
        seed=seed,
        device="cpu",
        verbose=1,
    )
    model.learn(steps, log_interval=20)
    model.save(f"{name}.zip")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("name", choices=IDS)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    kind = given.name.removeprefix("Fetch").removeprefix("Panda")
    train(given.name, given.steps or TRAINING[kind], given.seed)
