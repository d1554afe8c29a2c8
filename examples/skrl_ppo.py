"""PPO of skrl on 16 worlds of the reach task that are stepped at once.

Library: skrl, by `wrap_env`, which takes armctl's vector environments as they are.
Autoreset: `same_step`. skrl learns from every step, so with `next_step` it would learn from those that only reset.
It bootstraps truncated episodes from the first observation of the next one, which `Agent` corrects.
Options: normalized actions, relative to the current joint positions; features; rewards scaled to the order of one.
`Shaped` adds the minimum time to the target, by the joints' speed limits, as a potential.

EXPECTED: 100.0% of 200 episodes after 150,000 steps, in 2 minutes of one core

`python examples/skrl_ppo.py`
"""

import gymnasium
import torch
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed
from torch import nn

from armctl.shaping import Shaped
from held_out import arguments, report

ID = "armctl:armctl/ArmReach-v0"
OPTIONS = {
    "actions": "normalized",
    "control": "relative",
    "observation": "features",
}
WORLDS, ROLLOUT, GAMMA = 16, 128, 0.99


def layer(inputs, outputs, gain=2**0.5):
    """A linear layer, orthogonal at first, as is usual for PPO."""
    made = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.zeros_(made.bias)
    return made


def network(inputs, outputs, gain):
    """Two hidden layers."""
    return nn.Sequential(
        layer(inputs, 128),
        nn.Tanh(),
        layer(128, 128),
        nn.Tanh(),
        layer(128, outputs, gain),
    )


class Actor(GaussianMixin, Model):
    """Mean and logarithm of the standard deviation of the actions."""

    def __init__(self, env):
        Model.__init__(
            self,
            observation_space=env.observation_space,
            action_space=env.action_space,
            device=env.device,
        )
        GaussianMixin.__init__(self)
        self.net = network(self.num_observations, self.num_actions, gain=0.01)
        self.log_std = nn.Parameter(torch.full((self.num_actions,), -0.5))

    def compute(self, inputs, role=""):  # noqa: D102
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Critic(DeterministicMixin, Model):
    """The value of an observation."""

    def __init__(self, env):
        Model.__init__(
            self,
            observation_space=env.observation_space,
            action_space=env.action_space,
            device=env.device,
        )
        DeterministicMixin.__init__(self)
        self.net = network(self.num_observations, 1, gain=1)

    def compute(self, inputs, role=""):  # noqa: D102
        return self.net(inputs["observations"]), {}


class Agent(PPO):
    """Goes by the last observation of an episode where that was truncated."""

    def record_transition(self, *, next_observations, infos, **transition):  # noqa: D102
        last = (
            torch.as_tensor(infos["final_obs"])
            if "final_obs" in infos
            else next_observations
        )
        super().record_transition(
            next_observations=last, infos=infos, **transition
        )


given = arguments(__doc__, steps=150_000)
set_seed(given.seed)
worlds = gymnasium.make_vec(
    ID,
    num_envs=WORLDS,
    autoreset_mode="same_step",
    reward_scale=0.02,
    **OPTIONS,
)
env = wrap_env(
    Shaped(worlds, "ik", gamma=GAMMA, scale=150)
)  # per second nearer to the target
settings = PPO_CFG(
    rollouts=ROLLOUT, learning_epochs=8, mini_batches=8, discount_factor=GAMMA, learning_rate=5e-4,
    value_clip=0, value_loss_scale=0.5, time_limit_bootstrap=True,
)  # fmt: skip
settings.experiment.write_interval = settings.experiment.checkpoint_interval = 0
actor, spaces = (
    Actor(env),
    {
        "observation_space": env.observation_space,
        "action_space": env.action_space,
    },
)
agent = Agent(
    models={"policy": actor, "value": Critic(env)}, memory=RandomMemory(memory_size=ROLLOUT, num_envs=WORLDS),
    device=env.device, cfg=settings, **spaces,
)  # fmt: skip
timesteps = max(1, given.steps // WORLDS)
SequentialTrainer(
    env=env, agents=agent, cfg={"timesteps": timesteps, "headless": True}
).train()


def policy(observation):
    """The mean action."""
    with torch.no_grad():
        return (
            actor.net(torch.as_tensor(observation, device=env.device))
            .clamp(-1, 1)
            .cpu()
            .numpy()
        )


report(policy, ID, given.episodes, **OPTIONS)
